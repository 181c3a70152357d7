"""Reproduction of the thesis's figures 3.6 to 3.10, 4.1 and 5.3, and root volumes by age."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.collections import PatchCollection
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks import assumptions, datasets
from benchmarks.assumptions import Level
from benchmarks.cases import Pictures
from rhizotwin.experiment import mass_curves, thesis_tables
from rhizotwin.recon import carved_hull
from rhizotwin.recon.calibration.find_cameras import find_cameras
from rhizotwin.recon.coverage.measure import measure_coverage
from rhizotwin.recon.optics import refraction
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.read_pictures import read_pictures
from rhizotwin.recon.results.parts import picture_path
from rhizotwin.scenes import plan
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.scenes.figures import figure, png
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scoring import baselines
from rhizotwin.scoring.score_views import mask_errors
from rhizotwin.stored.result_files import read_grey

Array = NDArray[np.float64]

PLANT = Pictures(scene="radish_day15b", profile="bench")
"""Pictures of which silhouettes are drawn; those of the ladder, with thick and thin roots."""
PLANT_VIEWS = 8
"""Number of these pictures from which the empty backlight is estimated."""
CROP = 0.25
"""Width and height of the drawn part of a picture, relative to its height."""
RAYS = 25
"""Number of rays from one side of the canister to the other."""
CARVED_MM = (8.64, 4.32, 2.16, 1.08)
"""Edges of the finest voxels in the figure of carving."""
PRINT_ML, THESIS_PRINT_ML = 8.0, 7.13
"""True volume of the printed phantom, and that found in the thesis after nine iterations (figure 3.10)."""
THESIS_DAY_S, THESIS_VOXEL_MM, THESIS_FACTOR = 86400.0, 0.27, 4.0
"""Time that the thesis states (about a day), its voxel, and the factor of time per level (T4.2.2, T5.3)."""
COLOURS = {"thesis": "#b2182b", "re-implemented": "#ef8a62", "ours": "#2166ac", "true": "0.3"}
_RED, _BLUE, _YELLOW = "#b2182b", "#2166ac", "#d8a200"
_DPI = 130


def draw(pictures: Pictures, plant: Pictures = PLANT) -> dict[str, bytes]:
    """Return the figures of the method as PNG, by name; datasets are rendered if they are not in the cache.

    Parameters
    ----------
    pictures : Pictures
        Pictures of the phantom.
    plant : Pictures
        Pictures of a plant, for its silhouettes.
    """
    dataset = load_dataset(datasets.make(pictures))
    monitor = Monitor.of(None)
    read = read_pictures(dataset, monitor=monitor)
    above = read_pictures(assumptions.below_one_row(pictures), monitor=monitor)
    together = find_cameras(read, monitor=monitor)
    calibrated = {
        "one row of markers,\neach picture alone": find_cameras(above, monitor=monitor, measure=False, single_view=True),
        "two rows,\neach picture alone": find_cameras(read, monitor=monitor, measure=False, single_view=True),
        "two rows,\nall pictures jointly": together,
    }
    cameras, coverage = measure_coverage(read, together, monitor=monitor)
    hulls = [carved_hull.carve_hull(dataset, cameras, coverage, finest_mm=mm, slack_px=0.3, monitor=monitor) for mm in CARVED_MM]
    scene = dataset.scene
    return {
        "circle": _circle(scene, {name: np.array([view.centre_mm for view in found.views]) for name, found in calibrated.items()}),
        "silhouettes": _silhouettes(load_dataset(datasets.make(plant))),
        "rays": _rays(Optics.from_scene(scene), scene),
        "carving": _carving(hulls),
    }


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
    line = refraction.follow(optics, refraction.from_point(rho_mm, 0.0, np.array([w * optics.outer_radius_mm]), np.array([0.0])))
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


def _circle(scene: Scene, found: Mapping[str, Array]) -> bytes:
    drawn = figure(7.2, 3.9)
    markers = np.array([corners.mean(axis=0) for corners in plan.marker_corners(scene.strip, scene.net_pot).values()])
    for axes, (name, centres) in zip(drawn.subplots(1, len(found), sharey=True), found.items(), strict=True):
        middle, radius, away = fit_circle(centres[:, :2])
        turn = np.linspace(0.0, 2.0 * np.pi, 361)
        around = middle + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        axes.plot(around[:, 0], around[:, 1], color=_BLUE, linewidth=0.8, label="circle of best fit")
        axes.plot(centres[:, 0], centres[:, 1], "o", ms=3, color=_RED, label="cameras")
        axes.plot(markers[:, 0], markers[:, 1], ".", ms=2, color="0.3", label="markers")
        axes.set_title(f"{name}:\n{np.sqrt(np.mean(away**2)):.2f} mm off the circle", fontsize=9)
        axes.set_aspect("equal")
        axes.set_xlabel("x (mm)")
    drawn.axes[0].set_ylabel("y (mm)")
    drawn.legend(*drawn.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=9)
    return png(drawn, dpi=_DPI)


def _silhouettes(dataset: Dataset) -> bytes:
    """Draw the steps of the thesis's silhouette (T3.4.2), and our coverage, for the first picture of a plant."""
    dataset = replace(dataset, frames=dataset.frames[:: max(1, len(dataset.frames) // PLANT_VIEWS)])
    monitor = Monitor.of(None)
    read = read_pictures(dataset, monitor=monitor)
    coverage = measure_coverage(read, find_cameras(read, monitor=monitor), monitor=monitor)[1].silhouettes[0]
    image, usable = read.images[0].astype(np.float32), coverage.usable
    true = read_grey(picture_path(dataset.folder / "truth" / "masks", dataset.frames[0].file))
    steps = {
        "Otsu's threshold": assumptions.dark(image, usable).coverage,
        "Sobel edges": baselines.thesis_edges(image, usable).astype(np.float32),
        "both, opened": baselines.thesis_silhouette(image, usable).coverage,
        "our coverage": coverage.coverage,
    }
    row, column = (int(np.average(index, weights=true)) for index in np.indices(true.shape))
    half = round(0.5 * CROP * len(true))
    part = (slice(max(0, row - half), row + half), slice(max(0, column - half), column + half))
    drawn = figure(7.2, 1.75)
    panels = drawn.subplots(1, 2 + len(steps))
    panels[0].imshow(image[part], cmap="gray")
    panels[0].set_title("picture\n", fontsize=9)
    for axes, (name, step) in zip(panels[1:], {**steps, "true coverage": true}.items(), strict=True):
        axes.imshow(step[part], cmap="gray_r", vmin=0.0, vmax=1.0)
        area = f"{100.0 * mask_errors(step[part], true[part], usable[part])[2]:+.0f} %" if name in steps else ""
        axes.set_title(f"{name}\n{area}", fontsize=9)
    for axes in panels:
        axes.set_xticks([])
        axes.set_yticks([])
    return png(drawn, dpi=_DPI)


def _rays(optics: Optics, scene: Scene) -> bytes:
    drawn = figure(7.2, 2.9)
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
    axes.set_title("in air and acrylic (yellow), in water (red): no ray reaches the sides", fontsize=10)
    return png(drawn, dpi=_DPI)


def _carving(carved: list[carved_hull.CarvedHull]) -> bytes:
    drawn = figure(7.2, 2.9)
    water = carved[0].water
    for axes, one, mm in zip(drawn.subplots(1, len(carved), sharey=True), carved, CARVED_MM, strict=True):
        leaves = one.hull.leaves
        edge, middles = leaves.grid.size_mm * leaves.size, leaves.middles_mm
        low = middles[:, 1:] - 0.5 * edge[:, None]
        nearest_last = np.argsort(middles[:, 0])
        boxes = [Rectangle((low[k, 0], low[k, 1]), edge[k], edge[k]) for k in nearest_last]
        axes.add_collection(PatchCollection(boxes, facecolor="#d0a060", edgecolor="0.2", linewidth=0.2))
        axes.set_title(f"{mm:g} mm: {leaves.volume_mm3() / 1e3:.2f} ml", fontsize=10)
        axes.set_xlabel("y (mm)")
        axes.set_aspect("equal")
        axes.set_xlim(-0.9 * water.radius_mm, 0.9 * water.radius_mm)
        axes.set_ylim(water.bottom_mm, water.top_mm + 5.0)
    drawn.axes[0].set_ylabel("z (mm)")
    return png(drawn, dpi=_DPI)


def masses() -> bytes:
    """Draw figure 4.1 from table A.1, with type that remains legible in a column."""
    weighed = mass_curves.read([thesis_tables.shipped("kliman_2022_masses.csv")])[0]
    with mpl.rc_context({"font.size": 16}):
        return mass_curves.draw(mass_curves.measure(weighed))


def growth(series: Mapping[str, Sequence[tuple[float, float]]]) -> bytes:
    """Draw volumes (ml) against age (days); the names of the series begin with a key of `COLOURS`."""
    drawn = figure(6.4, 4.0)
    axes = drawn.subplots()
    for number, (name, points) in enumerate(series.items()):
        colour = next(value for key, value in COLOURS.items() if name.startswith(key))
        style: dict[str, Any] = {"mfc": "white"} if "1 ring" in name else {}
        days, values = zip(*points, strict=True)
        axes.plot([day + 0.5 * (number - 2.0) for day in days], values, "o", ms=4, color=colour, label=name, **style)
    axes.set_yscale("log")
    axes.set_xlabel("age (days)")
    axes.set_ylabel("root volume (ml)")
    axes.grid(visible=True, alpha=0.25)
    axes.legend(fontsize=9)
    return png(drawn, dpi=_DPI)


def volume_by_level(levels: Sequence[Level]) -> bytes:
    """Draw the volume of the printed phantom against the finest voxel, with the thesis's."""
    drawn = figure(6.4, 4.0)
    axes = drawn.subplots()
    voxels = [one.voxel_mm for one in levels]
    axes.plot(voxels, [one.thesis.ml for one in levels], "o-", color=COLOURS["re-implemented"], label="its method, re-implemented")
    axes.plot(voxels, [one.ours.ml for one in levels], "o-", color=COLOURS["ours"], label="our hull, before trimming")
    axes.axhline(PRINT_ML, color=COLOURS["true"], linewidth=0.8, label="true")
    stated = f"thesis, its real phantom, as stated: {THESIS_PRINT_ML:g} ml"
    axes.axhline(THESIS_PRINT_ML, color=COLOURS["thesis"], linestyle="--", label=stated)
    return _by_voxel(drawn, "volume (ml)", legend="upper right")


def time_by_level(levels: Sequence[Level]) -> bytes:
    """Draw the processor time of the carving against the finest voxel, with the statements of the thesis."""
    drawn = figure(6.4, 4.0)
    axes = drawn.subplots()
    voxels = [one.voxel_mm for one in levels]
    stated = [THESIS_DAY_S * (THESIS_VOXEL_MM / voxel) ** np.log2(THESIS_FACTOR) for voxel in voxels]
    axes.plot(voxels, stated, "--", color=COLOURS["thesis"], label="thesis, as stated: a day, 4 times per level (no data)")
    full = [(one.voxel_mm, one.thesis.grid_cpu_s) for one in levels if one.thesis.grid_cpu_s is not None]
    axes.plot(*zip(*full, strict=True), "^:", color=COLOURS["re-implemented"], label="its method, our carving in a full grid")
    axes.plot(voxels, [one.thesis.cpu_s for one in levels], "o-", color=COLOURS["re-implemented"], label="its method, our carving")
    axes.plot(voxels, [one.ours.cpu_s for one in levels], "o-", color=COLOURS["ours"], label="ours")
    axes.set_ylim(1e-4, 3e5)  # space for the legend
    return _by_voxel(drawn, "time of the carving (s)", legend="lower right")


def _by_voxel(drawn: Any, title: str, *, legend: str) -> bytes:
    axes = drawn.axes[0]
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.invert_xaxis()
    axes.set_xlabel("edge of the finest voxel (mm)")
    axes.set_ylabel(title)
    axes.grid(visible=True, alpha=0.25)
    axes.legend(fontsize=9, loc=legend)
    return png(drawn, dpi=_DPI)
