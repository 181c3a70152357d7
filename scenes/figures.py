"""Figures that are drawn without a screen, and share nothing with others; matplotlib is loaded when one is."""

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
    """Return a figure as PNG: drawn once, where matplotlib's own way of saving would lay it out in a drawing before."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    stored = io.BytesIO()
    drawn.set_dpi(dpi)
    FigureCanvasAgg(drawn).print_png(stored)
    return stored.getvalue()
