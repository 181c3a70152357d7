"""A camera's curve from exposures: pictures made by known curves, with noise and clipping, give them back."""

from pathlib import Path

import numpy as np
import pytest

from rhizotwin.rig.errors import RigError
from rhizotwin.rig.lens.transfer_fit import fit_transfer
from rhizotwin.rig.lens.transfer_series import read_series
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.picture_codec import encode_png
from rhizotwin.scenes.transfer import LINEAR, SRGB, Curve

TIMES = (0.002, 0.004, 0.008, 0.016, 0.032)
SHOULDER = Curve("film", tuple((np.linspace(0.0, 1.0, 513) ** 1.6 * (0.7 + 0.3 * np.linspace(0.0, 1.0, 513) ** 3)).tolist()))


def pictures(curve: Curve, times: tuple[float, ...] = TIMES) -> list[np.ndarray]:
    """Expose a ramp from dark to bright: the middle time reaches 0.8 of full scale."""
    rng = np.random.default_rng(0)
    scene = np.geomspace(0.004, 0.8, 120)[None, :] * np.ones((90, 1))
    lights = (np.clip(rng.poisson(8000.0 * scene * t / 0.008) / 8000.0, 0.0, 1.0) for t in times)
    return [np.rint(255.0 * curve.number(light)).astype(np.uint8) for light in lights]


@pytest.mark.parametrize("curve", [LINEAR, SRGB, SHOULDER], ids=lambda one: one.name)
def test_a_curve_comes_back(curve: Curve) -> None:
    found = fit_transfer(pictures(curve), TIMES)
    share = np.linspace(0.1, 0.95, 30)
    factor = found.curve.of(np.array(0.6)) / curve.of(np.array(0.6))  # exposures tell no common factor
    assert factor == pytest.approx(1.0, abs=0.04)
    np.testing.assert_allclose(found.curve.of(share), factor * curve.of(share), atol=0.015)
    assert found.residual < 0.05
    assert (found.curve in (LINEAR, SRGB)) == (curve in (LINEAR, SRGB))


@pytest.mark.parametrize("exposures", ["0.002,nan,0.008", "0.002,0,0.008", "0.002,0.008"])
def test_impossible_exposure_times_are_refused(exposures: str, tmp_path: Path) -> None:
    paths = [tmp_path / f"{k}.png" for k in range(3)]
    for path in paths:
        path.write_bytes(encode_png(np.zeros((16, 16), np.uint8)))
    with pytest.raises(UserError, match="specify a positive exposure time for each picture"):
        read_series(paths, exposures)


def test_exposures_that_are_too_alike_are_refused() -> None:
    times = (0.008, 0.009, 0.010)
    with pytest.raises(RigError, match=r"0\.008 to 0\.01 s"):
        fit_transfer(pictures(SRGB, times), times)


def test_pictures_all_clipped_are_refused() -> None:
    with pytest.raises(RigError, match="too few pixels"):
        fit_transfer([np.full((90, 120), 255, np.uint8)] * 5, TIMES)
