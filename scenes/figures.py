"""Creation of figures that requires no display and changes no global state.

Matplotlib is imported only when a figure is created.
"""

import io
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figure(width_in: float, height_in: float) -> "Figure":
    """Return an empty figure of the given size in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    made = Figure(figsize=(width_in, height_in), layout="constrained", facecolor="white")
    FigureCanvasAgg(made)
    return made


def png(drawn: "Figure", *, dpi: int) -> bytes:
    """Render a figure as PNG in a single pass. The save function of matplotlib would render it twice for its layout."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    stored = io.BytesIO()
    drawn.set_dpi(dpi)
    FigureCanvasAgg(drawn).print_png(stored)
    return stored.getvalue()
