"""Figures of a result for documents: pictures with silhouettes, and the shape from two sides."""

import logging
from collections.abc import Sequence
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
from rhizotwin.drawing import root_colours, shading
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
    lines = as_lines(roots)
    colour, key = root_colours.colour_roots(by, lines)
    drawn = figure(PAGE_IN, 3.8)
    both = drawn.subplots(1, 2, sharey=True)
    for axes, side, box in zip(both, _SIDES, boxes(shape.vertices_mm, _SIDES), strict=True):
        seen, px_mm = raster(shape, side, box)
        shades = _colours_of_pixels(seen, side, box, px_mm, lines, colour) if lines else np.array(SHAPE_RGB)
        picture = shading.shade(seen, shades, px_mm=px_mm, shrink=SHRINK)
        _show_rendering(axes, side, box, picture)
    both[1].set_ylabel("")
    if lines and key.swatches:
        handles = [Patch(color="#" + bytes(rgb).hex(), label=label) for rgb, label in key.swatches]
        drawn.legend(handles=handles, loc="outside right center", frameon=False)
    elif lines and key.ends is not None:
        bar = drawn.colorbar(ScalarMappable(norm=Normalize(0.0, 1.0), cmap="viridis"), ax=list(both), shrink=0.7)
        bar.set_ticks([0.0, 1.0], labels=list(key.ends))
    return for_print(drawn)


def _colours_of_pixels(
    found: shading.Raster, side: shading.Side, box: Box, px_mm: float, lines: Lines, colour: root_colours.Colouring
) -> Floats:
    """Return the colours (H, W, 3), 0 to 1, of a rendered shape.

    Each pixel has the colour of the nearest point of a centre line. Empty pixels are black.
    """
    row, column = np.nonzero(found.hit)
    flat = np.stack([box[0] + (column + 0.5) * px_mm, box[3] - (row + 0.5) * px_mm, found.depth_mm[row, column]], axis=1)
    picture = np.zeros((*found.hit.shape, 3))
    picture[row, column] = root_colours.colour_surface(flat @ side.axes, lines, colour) / 255.0
    return picture


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
