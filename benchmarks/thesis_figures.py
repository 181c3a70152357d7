"""Reproduction of figures of the thesis on the printed phantom: cameras (3.6), rays (3.8), carving (3.9)."""

import numpy as np
from matplotlib.collections import PatchCollection
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks import datasets
from benchmarks.cases import Pictures
from rhizotwin.recon import carved_hull
from rhizotwin.recon.calibration.find_cameras import find_cameras
from rhizotwin.recon.coverage.measure import measure_coverage
from rhizotwin.recon.optics import refraction
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.read_pictures import read_pictures
from rhizotwin.scenes import plan
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.figures import figure, png
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Monitor

Array = NDArray[np.float64]

RAYS = 25
"""Number of rays from one side of the canister to the other."""
CARVED_MM = (8.64, 4.32, 2.16, 1.08)
"""Edges of the finest voxels in the figure of carving."""
_RED, _BLUE, _YELLOW = "#b2182b", "#2166ac", "#d8a200"


def draw(pictures: Pictures) -> dict[str, bytes]:
    """Return the figures as PNG, by name; the dataset is rendered if it is not in the cache.

    Parameters
    ----------
    pictures : Pictures
        Pictures of the phantom.
    """
    dataset = load_dataset(datasets.make(pictures))
    monitor = Monitor.of(None)
    read = read_pictures(dataset, monitor=monitor)
    alone = find_cameras(read, monitor=monitor, measure=False, single_view=True)
    together = find_cameras(read, monitor=monitor)
    cameras, coverage = measure_coverage(read, together, monitor=monitor)
    found = {
        "one pose per picture": np.array([view.centre_mm for view in alone.views]),
        "all pictures together": np.array([view.centre_mm for view in together.views]),
    }
    hulls = [carved_hull.carve_hull(dataset, cameras, coverage, finest_mm=mm, slack_px=0.3, monitor=monitor) for mm in CARVED_MM]
    scene = dataset.scene
    return {"circle": _circle(scene, found), "rays": _rays(Optics.from_scene(scene), scene), "carving": _carving(hulls)}


def fit_circle(points_mm: Array) -> tuple[Array, float, Array]:
    """Return centre (2,), radius and residuals (N,) of the least-squares circle through points (N, 2).

    Parameters
    ----------
    points_mm : (N, 2) array
        Three or more points.
    """
    start = [*points_mm.mean(axis=0), float(np.linalg.norm(points_mm - points_mm.mean(axis=0), axis=1).mean())]

    def residual(p: Array) -> Array:
        return np.linalg.norm(points_mm - p[:2], axis=1) - p[2]

    fit = least_squares(residual, start)
    return fit.x[:2], float(fit.x[2]), residual(fit.x)


def ray_path(optics: Optics, rho_mm: float, w: float) -> Array:
    """Return the vertices (4, 2) of a level ray: camera, outer wall, inner wall, and its exit from the water.

    Parameters
    ----------
    optics : Optics
        Optics of the canister.
    rho_mm : float
        Distance of the camera, which is on the x axis.
    w : float
        Impact parameter relative to the outer radius.

    Returns
    -------
    (4, 2) array
        Coordinates x and y, mm.
    """
    line = refraction.trace(optics, rho_mm, 0.0, np.array([w]), np.array([0.0]))
    along, half = line.t[0], float(np.sqrt(optics.inner_radius_mm**2 - line.b_mm[0] ** 2))
    foot = line.b_mm[0] * line.nu[0]
    entry, leave = foot - half * along, foot + half * along
    camera, impact = np.array([rho_mm, 0.0]), w * optics.outer_radius_mm
    angle = np.arcsin(impact / rho_mm)
    hits = []
    for side in (-1.0, 1.0):
        direction = np.array([-np.cos(angle), side * np.sin(angle)])
        reach = rho_mm * np.cos(angle) - np.sqrt(optics.outer_radius_mm**2 - impact**2)
        hits.append(camera + reach * direction)
    outer = min(hits, key=lambda hit: float(np.linalg.norm(hit - entry)))
    return np.stack([camera, outer, entry, leave])


def _circle(scene: Scene, found: dict[str, Array]) -> bytes:
    drawn = figure(9.0, 4.2)
    markers = np.array([corners.mean(axis=0) for corners in plan.marker_corners(scene.strip, scene.net_pot).values()])
    for axes, (name, centres) in zip(drawn.subplots(1, 2), found.items(), strict=True):
        middle, radius, away = fit_circle(centres[:, :2])
        turn = np.linspace(0.0, 2.0 * np.pi, 361)
        around = middle + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        axes.plot(around[:, 0], around[:, 1], color=_BLUE, linewidth=0.8, label="circle of best fit")
        axes.plot(centres[:, 0], centres[:, 1], "o", ms=3, color=_RED, label="cameras")
        axes.plot(markers[:, 0], markers[:, 1], ".", ms=2, color="0.3", label="markers")
        axes.set_title(f"{name}: {np.sqrt(np.mean(away**2)):.2f} mm off the circle (rms)", fontsize=9)
        axes.set_aspect("equal")
        axes.set_xlabel("x (mm)")
        axes.set_ylabel("y (mm)")
        axes.legend(fontsize=7, loc="center")
    return png(drawn, dpi=110)


def _rays(optics: Optics, scene: Scene) -> bytes:
    drawn = figure(9.0, 4.2)
    axes = drawn.subplots()
    rho = scene.plan.rings[0].distance_mm
    turn = np.linspace(0.0, 2.0 * np.pi, 361)
    for radius in (optics.outer_radius_mm, optics.inner_radius_mm):
        axes.plot(radius * np.cos(turn), radius * np.sin(turn), color="0.4", linewidth=0.8)
    for w in np.linspace(-0.98, 0.98, RAYS):
        path = ray_path(optics, rho, float(w))
        axes.plot(path[:3, 0], path[:3, 1], color=_YELLOW, linewidth=0.8)
        axes.plot(path[2:, 0], path[2:, 1], color=_RED, linewidth=0.8)
    axes.plot([rho], [0.0], "o", color="0.2")
    axes.set_aspect("equal")
    axes.set_xlabel("x (mm)")
    axes.set_ylabel("y (mm)")
    axes.set_title("in air and acrylic (yellow), in water (red): no ray reaches the sides", fontsize=9)
    return png(drawn, dpi=110)


def _carving(carved: list[carved_hull.CarvedHull]) -> bytes:
    drawn = figure(9.0, 4.0)
    water = carved[0].water
    for axes, one, mm in zip(drawn.subplots(1, len(carved), sharey=True), carved, CARVED_MM, strict=True):
        leaves = one.hull.leaves
        edge, middles = leaves.grid.size_mm * leaves.size, leaves.middles_mm
        low = middles[:, 1:] - 0.5 * edge[:, None]
        nearest_last = np.argsort(middles[:, 0])
        boxes = [Rectangle((low[k, 0], low[k, 1]), edge[k], edge[k]) for k in nearest_last]
        axes.add_collection(PatchCollection(boxes, facecolor="#d0a060", edgecolor="0.2", linewidth=0.2))
        axes.set_title(f"{mm:g} mm: {leaves.volume_mm3() / 1e3:.2f} ml", fontsize=9)
        axes.set_xlabel("y (mm)")
        axes.set_aspect("equal")
        axes.set_xlim(-0.9 * water.radius_mm, 0.9 * water.radius_mm)
        axes.set_ylim(water.bottom_mm, water.top_mm + 5.0)
    drawn.axes[0].set_ylabel("z (mm)")
    return png(drawn, dpi=110)
