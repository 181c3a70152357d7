"""The pictures of a result: inputs beside silhouettes, the ring of cameras, the shape from two sides. Matplotlib without a screen."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray

from recon import shading, surface_distance
from recon.result_files import Mesh, picture_path, read_grey
from scenes import frames, plan
from scenes.dataset import Dataset, read_image
from scenes.model import Scene

Floats = NDArray[np.float64]

SHAPE_RGB = (0.86, 0.55, 0.25)
TRUTH_RGB = (0.42, 0.62, 0.80)
UNSEEN_RGB = np.array([0.85, 0.35, 0.45])
SHRINK = 3
"""Renderings are made this much finer than shown, then averaged."""


def figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure that draws without a screen and shares nothing with other figures."""
    made = Figure(figsize=(width_in, height_in), layout="constrained", facecolor="white")
    FigureCanvasAgg(made)
    return made


def inputs_and_silhouettes(summary: dict[str, Any], result_folder: Path, dataset: Dataset, *, count: int = 4) -> Figure | None:
    """Draw a few views, evenly over the scan: the picture above its silhouette, what says nothing tinted red."""
    used = [view for view in summary["views"] if view["used"]]
    used = [view for view in used if picture_path(result_folder / "silhouettes", view["file"]).is_file()]
    if not used:
        return None
    chosen = [used[i] for i in np.unique(np.linspace(0, len(used), min(count, len(used)), endpoint=False).astype(int))]
    by_file = {frame.file: frame for frame in dataset.frames}
    width, height = dataset.scene.camera.image_wh
    drawn = figure(3.6 * len(chosen), 7.2 * height / width + 0.9)
    axes = drawn.subplots(2, len(chosen), squeeze=False)
    for column, view in enumerate(chosen):
        picture = read_image(dataset, by_file[view["file"]]).astype(np.float64)
        picture /= max(np.percentile(picture, 99.8), 1.0)
        if not dataset.masks:
            picture = np.clip(picture, 0.0, 1.0) ** (1.0 / 2.2)  # the pictures are linear in light, screens are not
        coverage = read_grey(picture_path(result_folder / "silhouettes", view["file"])).astype(np.float64)
        seen_path = picture_path(result_folder / "seen", view["file"])
        seen = read_grey(seen_path) > 0.5 if seen_path.is_file() else np.ones(coverage.shape, np.bool_)
        silhouette = np.repeat(coverage[..., None], 3, axis=2)
        silhouette[~seen] = 0.55 * silhouette[~seen] + 0.45 * UNSEEN_RGB
        axes[0, column].imshow(picture, cmap="gray", vmin=0.0, vmax=1.0, interpolation="antialiased")
        axes[1, column].imshow(np.clip(silhouette, 0.0, 1.0), interpolation="antialiased")
        angle = "" if view.get("table_deg") is None else f", table {view['table_deg']:.0f} deg"
        axes[0, column].set_title(f"{Path(view['file']).name}{angle}", fontsize=9)
        fill = "" if view.get("fill") is None else f", fills {100.0 * view['fill']:.1f} % of what is seen"
        axes[1, column].set_title(f"silhouette{fill}", fontsize=9)
        for axis in axes[:, column]:
            axis.set_xticks([])
            axis.set_yticks([])
    drawn.supxlabel("silhouette: white is root; red tint: the picture says nothing there", fontsize=9)
    return drawn


def nominal_centres(dataset: Dataset) -> dict[str, Floats]:
    """Return where each frame's camera should have stood by the plan, (3,) in the canister frame; nothing where nobody planned."""
    centres: dict[str, Floats] = {}
    for frame in dataset.frames:
        if frame.table_deg is None or frame.ring >= len(dataset.scene.plan.rings):
            continue
        ring = dataset.scene.plan.rings[frame.ring]
        cam_from_rig = frames.level_camera(distance_mm=ring.distance_mm, height_mm=ring.height_mm, tilt_deg=ring.tilt_deg)
        cam_from_table = cam_from_rig @ plan.rig_from_table(dataset.scene, frame.table_deg)
        centres[frame.file] = frames.invert(cam_from_table)[:3, 3]
    return centres


def camera_ring(summary: dict[str, Any], dataset: Dataset) -> Figure:
    """Draw the cameras round the canister from above and from the side; views that were left out are crossed."""
    scene = dataset.scene
    nominal = nominal_centres(dataset)
    used: list[Floats] = []
    left_out: list[Floats] = []
    lost = 0
    for view in summary["views"]:
        pose = view.get("cam_from_canister")
        if view["used"] and pose is not None:
            used.append(frames.invert(np.array(pose, np.float64)))
        elif pose is not None:
            left_out.append(frames.invert(np.array(pose, np.float64))[:3, 3])
        elif view["file"] in nominal:
            left_out.append(nominal[view["file"]])
        else:
            lost += 1
    drawn = figure(12.0, 6.2)
    top, side = drawn.subplots(1, 2, width_ratios=[1.0, 1.0])
    _canister_from_above(top, scene)
    _canister_from_side(side, scene)
    for axes, (i, j) in ((top, (0, 1)), (side, (0, 2))):
        for canister_from_cam in used:
            centre, forward = canister_from_cam[:3, 3], canister_from_cam[:3, 2]
            tip = centre + 30.0 * forward
            axes.plot([centre[i], tip[i]], [centre[j], tip[j]], color="#9db7cc", linewidth=1.0, zorder=2)
        if used:
            centres = np.array([pose[:3, 3] for pose in used])
            axes.scatter(centres[:, i], centres[:, j], s=22, color="#1f5f8b", zorder=3, label=f"used ({len(used)})")
        if left_out:
            centres = np.array(left_out)
            axes.scatter(centres[:, i], centres[:, j], s=55, marker="x", color="#c0392b", zorder=4, label=f"left out ({len(left_out)})")
        axes.set_aspect("equal")
        axes.grid(color="#eeeeee", linewidth=0.6, zorder=0)
        axes.set_axisbelow(True)
        axes.set_xlabel("x (mm)")
    top.set_ylabel("y (mm)")
    side.set_ylabel("z (mm)")
    top.set_title("cameras in the canister's frame, from above")
    side.set_title("from the side")
    if used or left_out:
        top.legend(loc="upper right", fontsize=8, framealpha=0.9)
    if lost:
        drawn.supxlabel(f"{lost} view(s) left out whose place is not known", fontsize=9)
    return drawn


def _canister_from_above(axes: Axes, scene: Scene) -> None:
    can, pot = scene.canister, scene.net_pot
    axes.add_patch(Circle((0.0, 0.0), can.outer_radius_mm, facecolor="#f0f0f0", edgecolor="#808080", linewidth=1.2))
    axes.add_patch(Circle((0.0, 0.0), can.inner_radius_mm, facecolor="#e8f3fa", edgecolor="#a0a0a0", linewidth=0.8))
    half = scene.strip.marker_mm / pot.outer_radius_mm / 2.0
    for column in range(scene.strip.columns):
        middle = (column + 0.5) * 2.0 * np.pi / scene.strip.columns
        arc = np.linspace(middle - half, middle + half, 6)
        axes.plot(pot.outer_radius_mm * np.cos(arc), pot.outer_radius_mm * np.sin(arc), color="black", linewidth=2.0, solid_capstyle="butt")
    axes.annotate("seam", (pot.outer_radius_mm + 4.0, 0.0), fontsize=7, va="center", color="#606060")


def _canister_from_side(axes: Axes, scene: Scene) -> None:
    _canister_outline(axes, scene)
    pot, strip = scene.net_pot, scene.strip
    axes.add_patch(
        Rectangle(
            (-pot.outer_radius_mm, pot.skirt_bottom_mm),
            2.0 * pot.outer_radius_mm,
            pot.top_mm - pot.skirt_bottom_mm,
            facecolor="#dcdcdc",
            edgecolor="#808080",
            linewidth=0.8,
        )
    )
    for row in range(strip.rows):
        for column in range(strip.columns):
            angle = (column + 0.5) * 2.0 * np.pi / strip.columns
            if np.sin(angle) > 0.0:  # the half that faces away
                continue
            width = strip.marker_mm * -np.sin(angle)
            low = strip.bottom_mm + row * strip.row_pitch_mm
            axes.add_patch(Rectangle((pot.outer_radius_mm * np.cos(angle) - width / 2.0, low), width, strip.marker_mm, facecolor="#404040"))


def _canister_outline(axes: Axes, scene: Scene) -> None:
    """Draw the canister's walls, floor and water from the side."""
    can = scene.canister
    outer, inner, floor = can.outer_radius_mm, can.inner_radius_mm, can.floor_z_mm
    axes.add_patch(Rectangle((-outer, -can.height_mm), 2.0 * outer, can.height_mm, facecolor="#f4f4f4", edgecolor="#808080", linewidth=1.2))
    axes.add_patch(
        Rectangle((-inner, floor), 2.0 * inner, scene.water.level_mm - floor, facecolor="#eff7fc", edgecolor="#a0c4dc", linewidth=0.8)
    )


def shape_views(shape: Mesh, scene: Scene, *, truth: Mesh | None = None, title: str = "") -> Figure:
    """Draw the shape from the front and from the side to one scale; with the truth and the distance to it beside, where given."""
    points = shape.vertices_mm if truth is None else np.concatenate([shape.vertices_mm, truth.vertices_mm])
    columns = ["reconstructed"] if truth is None else ["reconstructed", "truth", "reconstructed, by distance to the truth"]
    apart = None if truth is None else surface_distance.distances(shape.vertices_mm, truth.vertices_mm, truth.faces)
    limit = 0.1 if apart is None else max(0.05, float(np.percentile(apart, 98.0)))
    scale = ScalarMappable(norm=Normalize(0.0, limit), cmap="turbo")

    boxes = [_box(points, side) for side in (shading.FRONT, shading.SIDE)]
    sides = [shading.FRONT, shading.SIDE]
    if truth is None:  # the two sides next to each other
        drawn = figure(11.0, 0.9 + 5.2 * max((box[3] - box[2]) / (box[1] - box[0]) for box in boxes))
        grid = drawn.subplots(1, 2, squeeze=False).reshape(2, 1)
    else:
        drawn = figure(14.5, 0.9 + 4.4 * sum((box[3] - box[2]) / (box[1] - box[0]) for box in boxes))
        grid = drawn.subplots(2, 3, squeeze=False, height_ratios=[(box[3] - box[2]) / (box[1] - box[0]) for box in boxes])
    for row, (side, box) in enumerate(zip(sides, boxes, strict=True)):
        for column, name in enumerate(columns):
            axes = grid[row, column]
            _canister_outline(axes, scene)
            mesh = truth if name == "truth" and truth is not None else shape
            coloured = apart if column == 2 else None
            _draw_mesh(axes, mesh, side, box, TRUTH_RGB if name == "truth" else SHAPE_RGB, values=coloured, scale=scale)
            axes.set_title(f"{name}, {side.name}" if truth is None or row == 0 else side.name, fontsize=10)
            axes.set_xlabel(side.right_label)
            axes.set_ylabel("z (mm)")
    if apart is not None:
        bar = drawn.colorbar(scale, ax=list(grid[:, 2]), shrink=0.7, extend="max")
        bar.set_label("distance to the true surface (mm)")
    if title:
        drawn.suptitle(title, fontsize=11)
    return drawn


def _box(points_mm: Floats, side: shading.Side) -> tuple[float, float, float, float]:
    """Return (left, right, bottom, top) round the points with a margin, neither very narrow nor very flat."""
    flat = points_mm @ side.axes[:2].T
    low, high = flat.min(axis=0), flat.max(axis=0)
    middle, half = (low + high) / 2.0, (high - low) / 2.0 + 4.0
    half = np.maximum(half, [0.75 * half[1], 0.6 * half[0]])
    return float(middle[0] - half[0]), float(middle[0] + half[0]), float(middle[1] - half[1]), float(middle[1] + half[1])


def _draw_mesh(
    axes: Axes,
    mesh: Mesh,
    side: shading.Side,
    box: tuple[float, float, float, float],
    colour: tuple[float, float, float],
    *,
    values: Floats | None,
    scale: ScalarMappable,
) -> None:
    px_mm = (box[3] - box[2]) / (760 * SHRINK)
    raster = shading.rasterise(mesh, side, box_mm=box, px_mm=px_mm, values=values)
    rgb = colour if values is None else np.asarray(scale.to_rgba(raster.values))[..., :3]
    picture = shading.shade(raster, rgb, px_mm=px_mm, shrink=SHRINK)
    axes.imshow(picture, extent=box, origin="upper", zorder=5, interpolation="antialiased")
    axes.set_xlim(box[0], box[1])
    axes.set_ylim(box[2], box[3])
    axes.set_aspect("equal")
