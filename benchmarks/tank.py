"""Visible fraction of the water, through the canister's round wall alone, and through a tank's flat one (T5.3).

``python -m benchmarks.tank -o FIGURE.png`` draws the fraction by radius and prints that of the whole water.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.projection import images_swept
from rhizotwin.recon.optics import tank
from rhizotwin.recon.optics.cameras import View, tank_view
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes import frames
from rhizotwin.scenes.atomic import write_bytes
from rhizotwin.scenes.figures import figure, png
from rhizotwin.scenes.model import Camera, Ring, Scene, Tank

Array = NDArray[np.float64]
HEIGHT_MM = -60.0
AZIMUTHS, RADII = 180, 72


def shares(scene: Scene, *, distance_mm: float) -> tuple[Array, dict[str, Array]]:
    """Return radii (R,) in mm, and by name the fraction (R,) of directions with exactly one image of a point.

    Points are in the horizontal plane of a level camera, where a sweep of rays counts the images of each; a turn of the
    canister moves every azimuth in front of the camera, so that the fraction of azimuths is that of views.
    """
    optics = Optics.from_scene(scene)
    radius = (np.arange(RADII) + 0.5) / RADII * optics.inner_radius_mm
    azimuth = (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS * 2.0 * np.pi
    r, a = (grid.ravel() for grid in np.meshgrid(radius, azimuth, indexing="ij"))
    points = np.column_stack([r * np.cos(a), r * np.sin(a), np.full(len(r), HEIGHT_MM)])
    view = View(camera=Camera(), cam_from_canister=frames.level_camera(distance_mm=distance_mm, height_mm=HEIGHT_MM, tilt_deg=0.0))
    through = {"round": images_swept(view, optics, points, rays=8001)}
    wet = replace(optics, tank=Tank(n_liquid=scene.water.n_water))
    at = tank_view(replace(view, cam_from_tank=view.cam_from_canister), wet)
    through["tank of water"] = images_at_height(at, points, rays=8001)
    return radius, {name: (count.reshape(RADII, AZIMUTHS) == 1).mean(axis=1) for name, count in through.items()}


def images_at_height(at: tank.TankView, points_mm: Array, *, rays: int = 4001) -> NDArray[np.int64]:
    """Count the images (N,) of points in a level camera's own plane, the canister upright, by a sweep of rays.

    A point has an image between two neighbouring rays if it is to the left of one and to the right of the other.

    Parameters
    ----------
    at : tank.TankView
        View of a level camera in front of the tank.
    points_mm : (N, 3) array
        Points in the camera's plane, mm.
    rays : int
        Number of rays over the canister's width.

    Returns
    -------
    (N,) int array
        Number of images of each point.
    """
    q = np.linspace(-0.7, 0.7, rays)  # 44 degrees to either side, more than any tank covers
    line, enters = tank.trace(at, q, np.zeros_like(q))
    side = points_mm[:, :1] * line.nu[:, 0] + points_mm[:, 1:2] * line.nu[:, 1] - line.b_mm
    with np.errstate(invalid="ignore"):
        change = np.signbit(side[:, 1:]) != np.signbit(side[:, :-1])
    return np.asarray((change & enters[1:] & enters[:-1]).sum(axis=1))


def main() -> None:
    """Draw the figure and print the fractions."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    output: Path = parser.parse_args().output
    radius, by_name = shares(Scene(), distance_mm=Ring().distance_mm)
    drawn = figure(7.0, 4.0)
    axes = drawn.add_subplot(xlabel="distance from the axis (mm)", ylabel="fraction of views with exactly one image", ylim=(0.0, 1.02))
    outer = radius > 0.95 * radius[-1]
    for name, share in by_name.items():
        whole = float(np.average(share, weights=radius))
        sys.stdout.write(
            f"{name:<16} {100.0 * whole:5.1f} % of the water, {100.0 * share[outer].mean():5.1f} % of its outermost twentieth\n"
        )
        axes.plot(radius, share, label=f"{name}: {100.0 * whole:.1f} % of the water")
    axes.legend(loc="lower left")
    axes.set_xlim(0.0, None)
    write_bytes(output, png(drawn, dpi=110))


if __name__ == "__main__":
    main()
