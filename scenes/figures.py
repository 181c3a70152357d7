"""Creation of figures that requires no display and changes no global state.

Matplotlib is imported only when a figure is created.
"""

import io
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FigureFormat = Literal["png", "svg", "pdf"]


def figure(width_in: float, height_in: float) -> "Figure":
    """Return an empty figure of the given size in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    made = Figure(figsize=(width_in, height_in), layout="constrained", facecolor="white")
    FigureCanvasAgg(made)
    return made


def encode(drawn: "Figure", kind: FigureFormat, *, dpi: int) -> bytes:
    """Render a figure as a file that contains text as text and no date.

    Parameters
    ----------
    drawn : Figure
        Figure.
    kind : {"png", "svg", "pdf"}
        Format of the file.
    dpi : int
        Resolution of the file, or of its pictures, dots per inch.
    """
    if kind == "png":
        return png(drawn, dpi=dpi)
    from matplotlib import rc_context

    stored = io.BytesIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "rhizotwin", "pdf.fonttype": 42}):
        drawn.savefig(stored, format=kind, dpi=dpi, metadata={"Date" if kind == "svg" else "CreationDate": None})
    return stored.getvalue()


def png(drawn: "Figure", *, dpi: int) -> bytes:
    """Render a figure as PNG in a single pass. The save function of matplotlib would render it twice for its layout."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    stored = io.BytesIO()
    drawn.set_dpi(dpi)
    FigureCanvasAgg(drawn).print_png(stored)
    return stored.getvalue()
