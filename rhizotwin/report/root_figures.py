"""Figure of the centre lines from two sides, coloured by diameter and by order."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure

from rhizotwin.drawing import root_colours
from rhizotwin.drawing.root_mesh import THICKEST_PERCENT
from rhizotwin.drawing.shading import FRONT, SIDE, Side
from rhizotwin.report import sides
from rhizotwin.report.figures import PAGE_IN, for_print
from rhizotwin.scenes.figures import figure
from rhizotwin.scenes.rsml import Root

ORDERS = np.array(root_colours.ORDERS) / 255.0
"""Colours (K, 3) of the root orders, from 0 to 1. The first is the colour of main roots."""
LEAST_WIDTH_PT = 0.7
"""Minimum width of a line, points. Thinner lines are hardly visible."""
PANEL_IN = PAGE_IN / 4.0
"""Width of a panel, inches. Four panels fill the width of a page."""


def draw_roots(roots: Sequence[Root]) -> Figure:
    """Draw at least one root from the front and from the side, by diameter and by order."""
    points, diameters = (np.concatenate([getattr(root, name) for root in roots]) for name in ("points_mm", "diameters_mm"))
    thick = ScalarMappable(norm=Normalize(0.0, float(np.percentile(diameters, THICKEST_PERCENT))), cmap="viridis")
    highest = min(max(root.order for root in roots), len(ORDERS) - 1)
    order = ScalarMappable(norm=Normalize(-0.5, highest + 0.5), cmap=ListedColormap(ORDERS[: highest + 1]))
    both = (FRONT, SIDE)
    boxes = sides.boxes(points, both)
    tall = (boxes[0][3] - boxes[0][2]) / (boxes[0][1] - boxes[0][0])
    drawn = figure(PAGE_IN, 1.15 + PANEL_IN * tall)
    panels = drawn.subplots(1, 4, sharey=True)
    for place, (by, scale) in enumerate((("diameter", thick), ("order", order))):
        for axes, side, box in zip(panels[2 * place : 2 * place + 2], both, boxes, strict=True):
            _draw_lines(axes, roots, side, box, thick if by == "diameter" else None)
            axes.set_title(f"by {by}\n{side.name}")
        bar = drawn.colorbar(scale, ax=list(panels[2 * place : 2 * place + 2]), location="bottom", shrink=0.6, aspect=40)
        bar.set_label("diameter (mm)" if by == "diameter" else "order (0: main root)")
        if by == "order":
            bar.set_ticks(range(highest + 1))
    for axes in panels[1:]:
        axes.set_ylabel("")
    return for_print(drawn)


def _draw_lines(axes: Axes, roots: Sequence[Root], side: Side, box: sides.Box, scale: ScalarMappable | None) -> None:
    """Draw roots as lines as wide as they are, the nearest last, by diameter, or by order if ``scale`` is None."""
    seen = [root.points_mm @ side.axes.T for root in roots]
    pieces = np.concatenate([np.stack([points[:-1, :2], points[1:, :2]], axis=1) for points in seen])
    depth = np.concatenate([(points[:-1, 2] + points[1:, 2]) / 2.0 for points in seen])
    diameters = np.concatenate([(root.diameters_mm[:-1] + root.diameters_mm[1:]) / 2.0 for root in roots])
    of_order = np.repeat([min(root.order, len(ORDERS) - 1) for root in roots], [len(points) - 1 for points in seen])
    shades = ORDERS[of_order] if scale is None else scale.to_rgba(diameters)
    widths = np.maximum(diameters * 72.0 * PANEL_IN / (box[1] - box[0]), LEAST_WIDTH_PT)
    far_first = np.argsort(depth, kind="stable")
    lines = LineCollection(list(pieces[far_first]), colors=shades[far_first], linewidths=widths[far_first], capstyle="round")
    axes.add_collection(lines)
    axes.set(xlim=box[:2], ylim=box[2:], aspect="equal", xlabel=side.right_label, ylabel="z (mm)")
