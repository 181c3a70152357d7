"""Figures of a result for documents: pictures with silhouettes, and the shape from two sides."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.text import Text
from numpy.typing import NDArray

from rhizotwin.corrections.lines import Lines, as_lines
from rhizotwin.drawing import root_colours, root_mesh, shading, surface_mesh
from rhizotwin.drawing.through_water import Pictures
from rhizotwin.recon.results.parts import Json, Mesh, picture_path
from rhizotwin.report.sides import SHAPE_RGB, SHRINK, Box, boxes, raster
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.figures import figure
from rhizotwin.scenes.formatting import printable
from rhizotwin.scenes.rsml import Root
from rhizotwin.scoring import surface_distance
from rhizotwin.stored.load import read_silhouette

Floats = NDArray[np.float64]
TRUTH_RGB = (0.42, 0.62, 0.80)
"""Colour of the true shape: blue, which colour-blind people can distinguish from ochre."""
UNUSED_GREY = 0.8
"""Brightness of pixels without information about the roots. Roots are black, and water is white."""
_VIEWS_SHOWN = 4
"""Number of views that are shown side by side."""
PAGE_IN, TEXT_PT = 7.0, 8.0
"""Width of a figure, inches, and size of its text, points. Journals print figures over two columns with a width of 7
inches, and ask for text of 5 to 8 pt."""
LEAST_WIDTH_PT = 0.7
"""Minimum width of a root in the figure of the roots, points. Thinner roots are hardly visible."""
KEY_IN = 0.65
"""Height of the space below the axes for legend and colour scale, inches: three lines of text."""
_SIDES = (shading.FRONT, shading.SIDE)
_DISTANCE_PX = 2 * SHRINK
"""Edge of the square blocks of rendered pixels for which a single distance is computed, px."""


def for_print(drawn: Figure) -> Figure:
    """Set all text of a figure to the size for print, and return the figure."""
    for text in drawn.findobj(Text):
        cast("Text", text).set_fontsize(TEXT_PT)
    for axes in drawn.axes:
        axes.tick_params(labelsize=TEXT_PT)
    return drawn


def inputs_and_silhouettes(summary: Json, result_folder: Path, dataset: Dataset) -> Figure | None:
    """Draw pictures from directions spread over the scan, with their silhouettes below.

    Roots are black in silhouettes, and unusable pixels are grey. The figure is None if the result has no silhouettes.
    """
    pictures = Pictures.of(dataset, summary)
    stored = [place for place, file in enumerate(pictures.files) if picture_path(result_folder / "silhouettes", file).is_file()]
    if not stored:
        return None
    chosen = [stored[i] for i in np.unique(np.linspace(0, len(stored), min(_VIEWS_SHOWN, len(stored)), endpoint=False).astype(int))]
    width, height = dataset.scene.camera.image_wh
    wide = PAGE_IN / _VIEWS_SHOWN * len(chosen)
    drawn = figure(wide, 2.0 * wide / len(chosen) * height / width + 0.45)
    turned = {view["file"]: view.get("table_deg") for view in summary["views"]}
    for place, (above, below) in zip(chosen, drawn.subplots(2, len(chosen), squeeze=False).T, strict=True):
        file = pictures.files[place]
        found = read_silhouette(result_folder, file)
        silhouette = np.where(found.usable, 1.0 - found.coverage, UNUSED_GREY)
        try:
            above.imshow(pictures.picture(place), interpolation="antialiased")
        except UserError as error:
            logging.getLogger(__name__).warning("%s; the figure is drawn without this picture", printable(str(error)))
        below.imshow(silhouette, interpolation="antialiased", cmap="gray", vmin=0.0, vmax=1.0)
        angle = turned.get(file)
        above.set_title("" if angle is None else f"table at {round(angle)}\N{DEGREE SIGN}")
        for axes in (above, below):
            axes.set_xticks([])
            axes.set_yticks([])
    drawn.supxlabel("silhouettes: roots are black, pixels without information about the roots are grey")
    return for_print(drawn)


def shape_close_up(shape: Mesh, roots: Sequence[Root] = (), *, by: str = "order") -> Figure:
    """Draw the shape without the canister, from the front and from the side.

    Parameters
    ----------
    shape : Mesh
        Surface mesh, mm, canister frame.
    roots : sequence of Root
        Roots by which the surface is coloured. Empty: a single colour.
    by : str
        Root property shown by the colour, one of `root_colours.CHOICES`.

    Returns
    -------
    Figure
        Two drawings at the same scale, with a colour key.
    """
    drawn = figure(PAGE_IN, 4.2)
    _draw_shape(drawn, [drawn.subplots(1, 2, sharey=True)], shape, boxes(shape.vertices_mm, _SIDES), roots, (by,))
    return for_print(drawn)


def roots_close_up(roots: Sequence[Root]) -> Figure:
    """Draw at least one root as tubes from the front and from the side, by order and by diameter."""
    around = boxes(np.concatenate([root.points_mm for root in roots]), _SIDES)
    panel_in = PAGE_IN / 4.0
    wide, tall = around[0][1] - around[0][0], around[0][3] - around[0][2]
    least_mm = LEAST_WIDTH_PT / 72.0 * wide / panel_in
    mesh = root_mesh.unite_tubes([replace(root, diameters_mm=np.maximum(root.diameters_mm, least_mm)) for root in roots])
    drawn = figure(PAGE_IN, 0.75 + KEY_IN + (panel_in - 0.2) * tall / wide)
    panels = drawn.subplots(1, 4, sharey=True)
    _draw_shape(drawn, [panels[:2], panels[2:]], mesh, around, roots, ("order", "diameter"))
    return for_print(drawn)


def _draw_shape(
    drawn: Figure, pairs: Sequence[NDArray[np.object_]], shape: Mesh, around: Sequence[Box], roots: Sequence[Root], choices: Sequence[str]
) -> None:
    """Draw a shape from the front and from the side on each pair of axes, coloured by a property of the roots."""
    lines = as_lines(roots)
    for place, (side, box) in enumerate(zip(_SIDES, around, strict=True)):
        seen, px_mm = raster(shape, side, box)
        nearest = _nearest_points(seen, side, box, px_mm, lines) if lines else None
        for by, pair in zip(choices, pairs, strict=True):
            shades = SHAPE_RGB
            if nearest is not None:
                colour, _ = root_colours.colour_roots(by, lines)
                shades = np.concatenate([colour(number, line) for number, line in lines.items()])[nearest] / 255.0
            _show_rendering(pair[place], side, box, shading.shade(seen, shades, px_mm=px_mm, shrink=SHRINK, flat=by != "order"))
    for axes in [axes for pair in pairs for axes in pair][1:]:
        axes.set_ylabel("")
    below = KEY_IN / drawn.get_figheight() if lines else 0.0
    drawn.set_layout_engine("constrained", rect=(0.0, below, 1.0, 1.0 - below))
    for place, by in enumerate(choices if lines else ()):
        _add_key(drawn, (place + 0.5) / len(choices), by, root_colours.colour_roots(by, lines)[1])


def _add_key(drawn: Figure, middle: float, by: str, key: root_colours.Key) -> None:
    """Add a legend or a colour scale in the space for keys, around a position from 0 (left) to 1 (right)."""
    high = drawn.get_figheight()
    if key.ends is None:
        handles = [Patch(color="#" + bytes(rgb).hex(), label=label) for rgb, label in key.swatches]
        place = {"loc": "upper center", "bbox_to_anchor": (middle, KEY_IN / high), "borderaxespad": 0.0}
        drawn.legend(handles=handles, frameon=False, handlelength=1.0, ncols=2, **place)
        return
    wide, tall = 1.8 / PAGE_IN, 0.1 / high
    scale = drawn.add_axes((middle - wide / 2.0, KEY_IN / high - 2.0 * tall, wide, tall))
    bar = drawn.colorbar(ScalarMappable(norm=Normalize(0.0, 1.0), cmap="viridis"), cax=scale, orientation="horizontal")
    bar.outline.set_visible(False)
    bar.set_ticks([0.0, 1.0], labels=list(key.ends))
    bar.set_label(by)


def _nearest_points(found: shading.Raster, side: shading.Side, box: Box, px_mm: float, lines: Lines) -> NDArray[np.int64]:
    """Return the index (H, W) of the nearest point of a centre line in each pixel of a rendered shape."""
    row, column = np.nonzero(found.hit)
    flat = np.stack([box[0] + (column + 0.5) * px_mm, box[3] - (row + 0.5) * px_mm, found.depth_mm[row, column]], axis=1)
    centres = np.concatenate([line.points_mm for line in lines.values()])
    radii = np.concatenate([line.diameters_mm for line in lines.values()]) / 2.0
    nearest = np.zeros(found.hit.shape, np.int64)
    nearest[row, column] = surface_mesh.nearest_root(flat @ side.axes, centres, radii)
    return nearest


def shape_and_truth(shape: Mesh, truth: Mesh, *, title: str) -> Figure:
    """Draw the reconstructed shape, the true shape, and the distance between their surfaces.

    The top row shows them from the front, the bottom row from the side. The colours of the third column show the
    distance to the true surface.

    Parameters
    ----------
    shape, truth : Mesh
        Surface meshes, mm, canister frame.
    title : str
        Title of the figure.

    Returns
    -------
    Figure
        Two rows of three drawings.
    """
    around = boxes(np.concatenate([shape.vertices_mm, truth.vertices_mm]), _SIDES)
    seen = [raster(shape, side, box) for side, box in zip(_SIDES, around, strict=True)]
    apart = [_surface_distances(found, side, box, px_mm, truth) for side, box, (found, px_mm) in zip(_SIDES, around, seen, strict=True)]
    shown = np.concatenate([distance[found.hit] for distance, (found, _) in zip(apart, seen, strict=True)])
    most = float(np.percentile(shown, 98.0)) if len(shown) else 0.0
    scale = ScalarMappable(norm=Normalize(0.0, max(0.05, most)), cmap="viridis")
    tall = (around[0][3] - around[0][2]) / (around[0][1] - around[0][0])
    drawn = figure(PAGE_IN, 0.8 + 0.58 * PAGE_IN * tall)
    grid = drawn.subplots(2, 3, squeeze=False, sharex="row", sharey=True)
    for row, side, box, (found, px_mm), distance in zip(grid, _SIDES, around, seen, apart, strict=True):
        true, _ = raster(truth, side, box)
        by_distance = np.asarray(scale.to_rgba(distance), np.float32)[..., :3]
        drawings = (
            shading.shade(found, SHAPE_RGB, px_mm=px_mm, shrink=SHRINK),
            shading.shade(true, TRUTH_RGB, px_mm=px_mm, shrink=SHRINK),
            shading.shade(found, by_distance, px_mm=px_mm, shrink=SHRINK, flat=True),
        )
        for axes, drawing in zip(row, drawings, strict=True):
            _show_rendering(axes, side, box, drawing)
        for axes in row[1:]:
            axes.set_ylabel("")
    for axes, name in zip(grid[0], ("reconstructed", "truth", "distance to the truth"), strict=True):
        axes.set_title(f"{name}\n{_SIDES[0].name}")
    bar = drawn.colorbar(scale, ax=list(grid[:, 2]), shrink=0.7, extend="max")
    bar.set_label("distance to the true surface (mm)")
    drawn.suptitle(title, parse_math=False)
    return for_print(drawn)


def _surface_distances(found: shading.Raster, side: shading.Side, box: Box, px_mm: float, truth: Mesh) -> Floats:
    """Return the distance (H, W), mm, from the reconstructed surface in each rendered pixel to the true surface.

    It is zero in empty pixels. One distance is computed for each block of pixels, at its first pixel.

    Parameters
    ----------
    found : shading.Raster
        Rendered shape.
    side, box, px_mm : shading.Side, Box, float
        Direction of projection, rendered rectangle, and edge of a pixel, mm.
    truth : Mesh
        True surface mesh.

    Returns
    -------
    (H, W) array
        Distance to the truth, mm.
    """
    row, column = np.nonzero(found.hit)
    _, first, number = np.unique(
        (row // _DISTANCE_PX) * found.hit.shape[1] + column // _DISTANCE_PX, return_index=True, return_inverse=True
    )
    flat = np.stack([box[0] + (column + 0.5) * px_mm, box[3] - (row + 0.5) * px_mm, found.depth_mm[row, column]], axis=1)[first]
    distance = np.zeros(found.hit.shape)
    if len(first):
        distance[row, column] = surface_distance.distances(flat @ side.axes, truth.vertices_mm, truth.faces)[number]
    return distance


def _show_rendering(axes: Axes, side: shading.Side, box: Box, picture: NDArray[np.float32]) -> None:
    axes.imshow(picture, extent=box, interpolation="antialiased")
    axes.set_title(side.name)
    axes.set_xlabel(side.right_label)
    axes.set_ylabel("z (mm)")
    axes.spines[["top", "right"]].set_visible(False)
    axes.locator_params(nbins=4)
