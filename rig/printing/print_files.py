"""Output of pages as PDF or SVG vector graphics at true scale."""

import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from rhizotwin.rig.printing.print_page import Fill, Line, Page, Shape, Strokes, Text
from rhizotwin.scenes.atomic import write_bytes
from rhizotwin.scenes.errors import UserError

if TYPE_CHECKING:  # importing matplotlib takes long, and is not needed for scanning on a Raspberry Pi
    from matplotlib.figure import Figure

SUFFIXES: Final = (".pdf", ".svg")
MM_PER_INCH: Final = 25.4
POINTS_PER_MM: Final = 72.0 / MM_PER_INCH
CAPITALS: Final = 0.73
"""Height of capital letters relative to the font size (DejaVu Sans)."""
CREATOR: Final = "rhizotwin"


def write_pages(pages: Sequence[Page], path: Path, *, title: str) -> list[Path]:
    """Write pages to one PDF file, or to one SVG file per page.

    For several SVG files, ``-1``, ``-2``, ... are appended to the file name.

    Parameters
    ----------
    pages : sequence of Page
        Pages to write.
    path : Path
        Path with the suffix .pdf or .svg.
    title : str
        Title of the document.

    Returns
    -------
    list of Path
        Paths of the written files.

    Raises
    ------
    UserError
        If the suffix is neither .pdf nor .svg, or a file already exists.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise UserError(f"{path}: unknown format; the name must end in .pdf or .svg")
    svg_names = [path.with_stem(f"{path.stem}-{number + 1}") for number in range(len(pages))]
    paths = svg_names if suffix == ".svg" and len(pages) > 1 else [path]
    for one in paths:
        if one.exists():
            raise UserError(f"{one} already exists; choose another name or remove it")
    contents = [_pdf(pages, title)] if suffix == ".pdf" else [_svg(page, title) for page in pages]
    for one, content in zip(paths, contents, strict=True):
        write_bytes(one, content)
    return paths


def to_figure(page: Page) -> "Figure":
    """Convert a page to a figure of the same size. One unit of the axes corresponds to 1 mm on paper."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    wide_mm, high_mm = page.size_mm
    stretch = np.array(page.stretch_xy)
    figure = Figure(figsize=(wide_mm / MM_PER_INCH, high_mm / MM_PER_INCH), facecolor="white")
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, wide_mm), ylim=(high_mm, 0.0))
    axes.set_axis_off()
    for part in page.parts:
        if isinstance(part, Fill | Shape):
            outlines = _corners(part.rectangles_mm) if isinstance(part, Fill) else part.points_mm[None]
            outline = Outline.make_compound_path(*(Outline(np.vstack([o, o[:1]]) * stretch, closed=True) for o in outlines))
            # A single path avoids seams between neighbours. Snapping to pixels would displace edges.
            axes.add_artist(PathPatch(outline, facecolor=str(part.grey), linewidth=0.0, snap=False))
        elif isinstance(part, Strokes):
            if part.lines_mm:
                strokes = Outline.make_compound_path(*(Outline(line * stretch) for line in part.lines_mm))
                width = part.width_mm * POINTS_PER_MM
                axes.add_artist(PathPatch(strokes, fill=False, linewidth=width, edgecolor=str(part.grey), joinstyle="round", snap=False))
        elif isinstance(part, Line):
            (x0, y0), (x1, y1) = np.array([part.from_mm, part.to_mm]) * stretch
            width = part.width_mm * POINTS_PER_MM
            axes.add_artist(Line2D([x0, x1], [y0, y1], linewidth=width, color=str(part.grey), solid_capstyle="butt", snap=False))
        else:
            _write(axes, part, stretch)
    return figure


def _write(axes: Any, part: Text, stretch: Any) -> None:
    x, y = np.array(part.at_mm) * stretch
    size = part.height_mm * POINTS_PER_MM / CAPITALS
    turn = {"rotation": 90, "rotation_mode": "anchor"} if part.turned else {}
    axes.text(
        x, y, part.text, fontsize=size, color=str(part.grey), ha=part.align, va="baseline", family="DejaVu Sans", parse_math=False, **turn
    )


def _corners(rectangles: Any) -> Any:
    """Return the corners (N, 4, 2) of rectangles (N, 4) given by left, top, right and bottom."""
    left, top, right, bottom = rectangles.T
    return np.stack(
        [np.stack([left, top], 1), np.stack([right, top], 1), np.stack([right, bottom], 1), np.stack([left, bottom], 1)], axis=1
    )


def _settings() -> Any:
    """Return a context with the default settings of matplotlib.

    A user's settings might crop the page or change fonts.
    """
    import matplotlib as mpl

    return mpl.rc_context(dict(mpl.rcParamsDefault) | {"svg.hashsalt": CREATOR, "pdf.fonttype": 42})


def _svg(page: Page, title: str) -> bytes:
    stored = io.BytesIO()
    with _settings():
        to_figure(page).savefig(stored, format="svg", metadata={"Title": title, "Creator": CREATOR, "Date": None})
    wide_mm, high_mm = page.size_mm
    # points are rounded, and some programs do not interpret them as points
    head = re.compile(rb'width="[0-9.]+pt" height="[0-9.]+pt"')
    return head.sub(f'width="{wide_mm:g}mm" height="{high_mm:g}mm"'.encode(), stored.getvalue(), count=1)


def _pdf(pages: Sequence[Page], title: str) -> bytes:
    from matplotlib.backends.backend_pdf import PdfPages

    stored = io.BytesIO()
    with _settings(), PdfPages(stored, metadata={"Title": title, "Creator": CREATOR, "CreationDate": None}) as pdf:
        for page in pages:
            pdf.savefig(to_figure(page))
    return _at_true_scale(stored.getvalue())


def _at_true_scale(pdf: bytes) -> bytes:
    """Append a setting to a PDF file that disables scaling in viewers.

    The setting is ``/PrintScaling /None`` (PDF 1.6, table 8.1), as an incremental update.
    """
    root, size = re.search(rb"/Root (\d+) 0 R", pdf), re.search(rb"/Size (\d+)", pdf)
    starts = re.findall(rb"startxref\s+(\d+)", pdf)
    catalog = root and re.search(rb"(?:^|\n)" + root[1] + rb" 0 obj\s*<<(.*?)>>\s*endobj", pdf, re.DOTALL)
    info = re.search(rb"/Info (\d+) 0 R", pdf)
    if not (root and size and starts and catalog and info):
        return pdf  # unknown numbering by the writer: the text on the page states 100 %
    changed = root[1] + b" 0 obj\n<<" + catalog[1] + b" /ViewerPreferences << /PrintScaling /None >> >>\nendobj\n"
    start, table = len(pdf), len(pdf) + len(changed)
    trailer = b"trailer\n<< /Size " + size[1] + b" /Root " + root[1] + b" 0 R /Info " + info[1] + b" 0 R /Prev " + starts[-1] + b" >>\n"
    rows = b"xref\n0 1\n0000000000 65535 f \n" + root[1] + b" 1\n" + f"{start:010d} 00000 n \n".encode()
    return pdf + changed + rows + trailer + f"startxref\n{table}\n%%EOF\n".encode()
