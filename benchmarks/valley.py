"""Figure of the loss valley in which larger radii, lower attenuation and more blur are nearly equivalent.

``python -m benchmarks.valley DATASET PICTURE.png`` refits the tubes at every attenuation and blur of a grid; the
ellipses are one and two standard deviations of the joint fit.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rhizotwin import engine
from rhizotwin.scenes.atomic import write_bytes
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.figures import figure, png
from rhizotwin.scenes.monitor import Monitor

Array = NDArray[np.float64]

MU_PER_MM = np.geomspace(0.6, 2.4, 13)
BLUR_PX = np.linspace(0.0, 0.6, 9)
STEPS = 4
"""Steps of each fit: twice as many change the loss by less than a hundredth of its range."""


def main() -> None:
    """Measure and draw."""
    dataset, picture = (Path(path) for path in sys.argv[1:])
    engine.start("cpu")
    loss, light, covariance = measure(dataset)
    draw(loss, light, covariance, picture)


def measure(path: Path) -> tuple[Array, Array, Array]:
    """Return the loss (blur, attenuation) on lone roots, and the fitted light (L,) with its covariance (L, L)."""
    from rhizotwin.recon import carved_hull, shaping
    from rhizotwin.recon.calibration.curve import verify_curve
    from rhizotwin.recon.calibration.find_cameras import find_cameras
    from rhizotwin.recon.coverage.measure import measure_coverage
    from rhizotwin.recon.read_pictures import read_pictures
    from rhizotwin.recon.roots import rooting
    from rhizotwin.recon.settings import Settings
    from rhizotwin.recon.tubes import root_light, tube_fit, tube_profiles
    from rhizotwin.recon.tubes.tube_profiles import OUTLIER

    settings, monitor, dataset = Settings(), Monitor(), load_dataset(path)
    pictures = verify_curve(read_pictures(dataset, settings=settings.pictures, monitor=monitor), monitor=monitor)
    cameras = find_cameras(pictures, settings=settings.calibration, monitor=monitor)
    cameras, coverage = measure_coverage(pictures, cameras, settings=settings.coverage, monitor=monitor)
    carved = carved_hull.find_hull(dataset, cameras, coverage, settings, monitor=monitor)
    tree = shaping.find_roots(carved, coverage, dataset.scene, monitor=monitor)
    if tree is None or tree.attenuation.mu_per_mm is None:
        raise UserError("these roots are opaque: there is no valley")
    system, lone = rooting.finish_tree(tree, monitor=monitor), None
    left = []
    for blur_px in BLUR_PX:
        for mu_per_mm in MU_PER_MM:
            evidence = replace(system.evidence, mu_per_mm=float(mu_per_mm), blur_px=float(blur_px))
            start = root_light.match_absorption(system.tubes, system.thick, system.evidence, evidence)
            fit = tube_fit.fit(evidence, start, system.thick, steps=STEPS)
            told = tube_profiles.misfit(evidence, fit.tubes, fit.rendering.difference)
            if lone is None:
                lone = tube_profiles.profiles(system.rendering).is_lone & ~system.thick & np.isfinite(told)
            left.append(float(OUTLIER * np.log1p(np.nan_to_num(told[lone]) / OUTLIER).sum()))
    return np.array(left).reshape(len(BLUR_PX), len(MU_PER_MM)), system.attenuation.light, system.attenuation.covariance


def draw(loss: Array, light: Array, covariance: Array, path: Path) -> None:
    """Draw the loss above its minimum as contours, with the ellipses of the fit.

    Parameters
    ----------
    loss : (B, M) array
        Loss at the blurs and attenuations of the grid.
    light, covariance : (L,), (L, L) array
        Fitted parameters and their covariance.
    path : Path
        Path of the picture.
    """
    drawn = figure(6.4, 4.4)
    axis = drawn.subplots()
    shown = axis.contourf(MU_PER_MM, BLUR_PX**2, 100.0 * (loss / loss.min() - 1.0), levels=[0, 1, 2, 4, 8, 16, 32, 64], extend="max")
    drawn.colorbar(shown, label="loss above its minimum (%)")
    turn = np.linspace(0.0, 2.0 * np.pi, 100)
    way = np.linalg.cholesky(covariance[:2, :2] + 1e-12 * np.eye(2)) @ np.stack([np.cos(turn), np.sin(turn)])
    for many in (1.0, 2.0):
        axis.plot(np.exp(light[0] + many * way[0]), light[1] + many * way[1], color="w")
    axis.plot(np.exp(light[0]), light[1], "w+")
    axis.set(xlabel="attenuation (1/mm)", ylabel="variance of the blur (px$^2$)", xscale="log", ylim=(0.0, BLUR_PX[-1] ** 2))
    axis.set_xlim(MU_PER_MM[0], MU_PER_MM[-1])
    axis.minorticks_off()
    axis.set_xticks([0.6, 1.0, 1.5, 2.4], ["0.6", "1.0", "1.5", "2.4"])
    write_bytes(path, png(drawn, dpi=130))


if __name__ == "__main__":
    main()
