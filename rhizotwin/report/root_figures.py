"""Figure of the roots: centre lines from two sides beside a picture."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rhizotwin import root_colours, shading
from rhizotwin.recon.results.parts import Json
from rhizotwin.report import figures, sides
from rhizotwin.root_mesh import THICKEST_PERCENT
from rhizotwin.scenes import frames
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.figures import figure
from rhizotwin.scenes.rsml import Root
from rhizotwin.stored.stored_cameras import Cameras

Floats = NDArray[np.float64]

ORDERS = tuple(tuple(channel / 255.0 for channel in rgb) for rgb in root_colours.ORDERS)
"""Colours of the root orders, as RGB values from 0 to 1. The first is the colour of main roots."""
LEAST_WIDTH_PT = 0.7
"""Minimum width of a line, points. Thinner lines are hardly visible."""
PANEL_IN = 4.6
"""Width of a panel, inches. A figure of three panels is about 15 inches wide, including the margins."""


def roots_and_inputs(roots: tuple[Root, ...], summary: Json, dataset: Dataset) -> Figure:
    """Draw the roots, coloured by diameter and by order, beside the nearest picture.

    The top row shows them from the front, the bottom row from the side.
    """
    points = np.concatenate([root.points_mm for root in roots])
    diameters = np.concatenate([root.diameters_mm for root in roots])
    scale = ScalarMappable(norm=Normalize(0.0, float(np.percentile(diameters, THICKEST_PERCENT))), cmap="viridis")
    both = (shading.FRONT, shading.SIDE)
    around = sides.boxes(points, both)
    tall = (around[0][3] - around[0][2]) / (around[0][1] - around[0][0])
    drawn = figure(3.0 * PANEL_IN + 0.8, 1.0 + 2.0 * PANEL_IN * tall)
    grid = drawn.subplots(2, 3, squeeze=False)
    for row, side, box in zip(grid, both, around, strict=True):
        _show_picture(row[0], side, box, summary, dataset)
        for axes, by in ((row[1], "diameter"), (row[2], "order")):
            _draw_roots(axes, roots, side, box, scale if by == "diameter" else None)
            axes.set_title(f"by {by}, {side.name}", fontsize=9)
    bar = drawn.colorbar(scale, ax=list(grid[:, 1]), location="bottom", shrink=0.8, extend="max", aspect=40)
    bar.set_label("diameter (mm)")
    highest = min(max(root.order for root in roots), len(ORDERS) - 1)
    orders = ScalarMappable(norm=Normalize(-0.5, highest + 0.5), cmap=ListedColormap(ORDERS[: highest + 1]))
    bar = drawn.colorbar(orders, ax=list(grid[:, 2]), location="bottom", shrink=0.8, ticks=range(highest + 1), aspect=40)
    bar.set_label("order (0: main root)")
    return drawn


def _draw_roots(axes: Axes, roots: tuple[Root, ...], side: shading.Side, box: sides.Box, scale: ScalarMappable | None) -> None:
    """Draw roots as lines as wide as the root diameters. Distant segments are drawn first."""
    pieces, shades, diameters, depth = [], [], [], []
    for root in roots:
        seen = root.points_mm @ side.axes.T
        pieces.append(np.stack([seen[:-1, :2], seen[1:, :2]], axis=1))
        depth.append((seen[:-1, 2] + seen[1:, 2]) / 2.0)
        thick = (root.diameters_mm[:-1] + root.diameters_mm[1:]) / 2.0
        diameters.append(thick)
        if scale is None:
            shades += [ORDERS[min(root.order, len(ORDERS) - 1)]] * len(thick)
        else:
            shades += list(scale.to_rgba(thick))
    far_first = np.argsort(np.concatenate(depth), kind="stable")
    width = np.maximum(np.concatenate(diameters) * 72.0 * PANEL_IN / (box[1] - box[0]), LEAST_WIDTH_PT)
    axes.add_collection(
        LineCollection(
            list(np.concatenate(pieces)[far_first]), colors=[shades[k] for k in far_first], linewidths=width[far_first], capstyle="round"
        )
    )
    figures.put_axes(axes, side, box)


def _show_picture(axes: Axes, side: shading.Side, box: sides.Box, summary: Json, dataset: Dataset) -> None:
    """Show the picture whose camera is nearest to a viewing direction.

    The picture is cropped to the roots, which are magnified by refraction.
    """
    axes.set_xticks([])
    axes.set_yticks([])
    cameras, toward = Cameras.of(dataset, summary), side.axes[2]
    if not cameras.views:
        axes.set_title("no picture", fontsize=9)
        return
    near = int(np.argmax([view.centre_mm @ toward / np.linalg.norm(view.centre_mm) for view in cameras.views]))
    file, view = cameras.files[near], cameras.views[near]
    picture = figures.for_screen(dataset, file)
    if picture is None:
        axes.set_title(f"{file} could not be read", fontsize=9, parse_math=False)
        return
    corners = np.array([[box[i], box[j], 0.0] for i in (0, 1) for j in (2, 3)]) @ side.axes
    seen = frames.apply(view.cam_from_canister, corners)
    pixels = seen[:, :2] / seen[:, 2:] * view.camera.focal_px + view.camera.principal_px
    middle = pixels.mean(axis=0)
    # refraction widens the roots by a factor of about n and does not change their height
    low, high = (middle + (corner - middle) * [dataset.scene.water.n_water, 1.1] for corner in (pixels.min(axis=0), pixels.max(axis=0)))
    width, height = view.camera.image_wh
    left, right = np.clip([low[0], high[0]], -0.5, width - 0.5)
    top, bottom = np.clip([low[1], high[1]], -0.5, height - 0.5)
    axes.imshow(picture, cmap="gray", vmin=0.0, vmax=1.0, interpolation="antialiased")
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_title(f"{file}, through the water", fontsize=9, parse_math=False)
