"""Figures without a display or shared state; matplotlib is only loaded when a figure is created."""

import io
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figure(width_in: float, height_in: float) -> "Figure":
    """Return an empty figure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    made = Figure(figsize=(width_in, height_in), layout="constrained", facecolor="white")
    FigureCanvasAgg(made)
    return made


def png(drawn: "Figure", *, dpi: int) -> bytes:
    """Render a figure as PNG in one pass; matplotlib's own saving would render it twice for its layout."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    stored = io.BytesIO()
    drawn.set_dpi(dpi)
    FigureCanvasAgg(drawn).print_png(stored)
    return stored.getvalue()
