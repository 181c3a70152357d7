"""The rest that pictures need after a stop."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from rhizotwin.rig.devices import Shot
from rhizotwin.rig.scanning.scan import scan
from rhizotwin.rig.scanning.settling import settling, watch
from rhizotwin.rig.twin.clock import VirtualClock
from tests.rig.fake_devices import World, devices


def swinging(at_s: float, *, amplitude_px: float, decay_s: float, noise: float, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Return a picture of upright stripes that swing at 2 Hz and come to rest."""
    shift = amplitude_px * np.exp(-at_s / decay_s) * np.cos(2.0 * np.pi * 2.03 * at_s)
    x = np.arange(160.0) - shift
    stripes = 20000.0 + 8000.0 * np.tanh(2.0 * np.sin(x / 4.0))
    return np.clip(np.tile(stripes, (120, 1)) + rng.normal(0.0, noise, (120, 160)), 0, 65535).astype(np.uint16)


@pytest.mark.parametrize("decay_s", [0.3, 0.8, 1.5])
def test_the_rest_is_where_the_swing_drowns_in_noise(decay_s: float) -> None:
    rng, times = np.random.default_rng(0), np.arange(0.0, 12.0, 0.25)
    noise, amplitude = 200.0, 3.0
    found = settling([swinging(t, amplitude_px=amplitude, decay_s=decay_s, noise=noise, rng=rng) for t in times], times.tolist())
    slope = 8000.0 * 0.25 * np.sqrt(np.mean((2.0 / np.cosh(2.0 * np.sin(np.arange(160) / 4.0)) ** 2 * np.cos(np.arange(160) / 4.0)) ** 2))
    # moved beyond 1.15 times the noise: the swing makes sqrt(1.15^2 - 1) of it
    expected = decay_s * np.log(amplitude * slope / (noise * np.sqrt(1.15**2 - 1.0)))
    assert found.rest_s is not None
    assert expected - 0.6 <= found.rest_s <= expected + 0.6  # half a period of its swing and a look either way
    assert found.moved > 5.0


def test_what_stands_still_needs_no_rest() -> None:
    rng, times = np.random.default_rng(1), np.arange(0.0, 6.0, 0.25)
    found = settling([swinging(t, amplitude_px=0.0, decay_s=1.0, noise=200.0, rng=rng) for t in times], times.tolist())
    assert found.rest_s == 0.0
    assert found.moved == pytest.approx(1.0, abs=0.1)


def test_what_still_swings_at_the_end_is_told() -> None:
    rng, times = np.random.default_rng(2), np.arange(0.0, 6.0, 0.25)
    found = settling([swinging(t, amplitude_px=3.0, decay_s=30.0, noise=200.0, rng=rng) for t in times], times.tolist())
    assert found.rest_s is None


def test_looks_are_as_far_apart_as_asked() -> None:
    clock = VirtualClock()
    pictures, times_s = watch(lambda: np.zeros((4, 4), np.uint8), clock, seconds=3.0, every_s=0.5)
    assert len(pictures) == 6
    assert times_s == pytest.approx([0.0, 0.5, 1.0, 1.5, 2.0, 2.5])


@pytest.mark.parametrize(("decay_s", "least_s", "most_s"), [(1.2, 2.0, 12.0), (0.01, 0.5, 0.5)], ids=["sloshing", "still"])
def test_a_scan_rests_as_long_as_it_saw_the_water_move(decay_s: float, least_s: float, most_s: float, tmp_path: Path) -> None:
    world = World()
    opened = devices(world)
    opened.rig = replace(opened.rig, turntable=replace(opened.rig.turntable, rest="measured"))
    rng, rests, stopped = np.random.default_rng(3), list[float](), [0.0]
    move, capture = opened.table.move_to, opened.camera.capture

    def moving(angle_deg: float) -> float:
        read = move(angle_deg)
        stopped[0] = world.now_s
        return read

    def sloshing() -> Shot:
        since_s = world.now_s - stopped[0]
        rests.append(since_s)
        shot = capture()
        swing = 6.0 * np.exp(-since_s / decay_s) * np.cos(2.0 * np.pi * 2.03 * since_s)
        moved = np.roll(shot.image, round(swing), axis=1).astype(np.float64)
        full = np.iinfo(shot.image.dtype).max
        image = np.clip(moved + rng.normal(0.0, 0.005 * full, moved.shape), 0, full).astype(shot.image.dtype)
        return replace(shot, image=image)

    opened.table.move_to, opened.camera.capture = moving, sloshing  # type: ignore[method-assign]
    said: list[str] = []
    dataset = scan(opened, world.scene, tmp_path / "scan", say=said.append)
    (line,) = [text for text in said if "each picture waits" in text]
    assert least_s <= min(rests[-len(dataset.frames) :]) <= most_s
    assert f"{min(rests[-len(dataset.frames) :]):.1f}"[:2] in line
    assert any("each picture waits" in entry["text"] for entry in dataset.origin["log"])
