"""Pages with the marker strip, in pieces that are cut out and glued around the net pot."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from rhizotwin.rig.printing.print_page import (
    LEADING,
    RULER_HIGH_MM,
    SQUARE_MM,
    TEXT_MM,
    TEXT_WIDE_MM,
    Fill,
    Line,
    Page,
    Paper,
    Part,
    Shape,
    Text,
    lines,
    printing_notes,
    ruler,
    square,
)
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.markers import black_rectangles, marker_cells, strip_ids
from rhizotwin.scenes.model import MarkerStrip, NetPot, Scene

TAB_MM: Final = 6.0
"""Length of the tab at the end of a piece, mm. The tab is glued under the beginning of the next piece."""
ABOVE_MM: Final = 8.0
"""Space above a piece for its name and cut marks, mm."""
BELOW_MM: Final = 5.0
MARK_MM: Final = 3.0
BESIDE_MM: Final = 8.0
"""Space between the square and the text, mm."""
LABEL_MM: Final = 1.3
"""Height of the marker ids printed on the strip, mm."""
EDGE_MM: Final = 0.4
QUIET_CELLS: Final = 1.5
"""Width of the white margin between a marker and the printed ids, in cells of the marker."""
CUT_GREY: Final = 0.7


@dataclass(frozen=True, kw_only=True)
class Piece:
    """Piece of the strip, from column ``first`` (included) to column ``last`` (excluded)."""

    number: int
    first: int
    last: int


@dataclass(frozen=True, kw_only=True)
class FlatStrip:
    """Marker strip as it is printed, before it is bent around the net pot."""

    strip: MarkerStrip
    net_pot: NetPot
    paper_mm: float
    """Thickness of the paper, mm. When the paper is wrapped around the net pot, its outer side is stretched, whereas
    the length in the middle of its thickness remains the same."""

    @property
    def bend(self) -> float:
        """Ratio of a length on the flat paper to its length on the outside of the strip.

        The outside is stretched when the strip is wrapped around the net pot.
        """
        return (self.net_pot.outer_radius_mm - self.paper_mm / 2.0) / self.net_pot.outer_radius_mm

    @property
    def length_mm(self) -> float:
        """Length of the strip on flat paper, mm. The ends meet when it is wrapped around the net pot."""
        return 2.0 * np.pi * self.net_pot.outer_radius_mm * self.bend

    @property
    def height_mm(self) -> float:
        """Height of the strip, mm, from the lower edge of the net pot's skirt to the upper edge of the net pot."""
        return self.net_pot.top_mm - self.net_pot.skirt_bottom_mm

    @property
    def pitch_mm(self) -> float:
        """Distance between adjacent columns on flat paper, mm."""
        return self.length_mm / self.strip.columns


def strip_pages(scene: Scene, *, paper: Paper, paper_mm: float = 0.1) -> list[Page]:
    """Lay out the marker strip on pages, with as few pieces as possible.

    Parameters
    ----------
    scene : Scene
        Scene whose ``net_pot.outer_radius_mm`` is the outer radius of the wrapped paper at the markers.
    paper : Paper
        Paper size, orientation, and measured scale of the printer.
    paper_mm : float
        Thickness of the paper, mm.

    Returns
    -------
    list of Page
        Pages with one or several pieces each.

    Raises
    ------
    UserError
        If a page is too narrow for a single column, or too low for the strip and the ruler.
    """
    flat = FlatStrip(strip=scene.strip, net_pot=scene.net_pot, paper_mm=paper_mm)
    notes = [*printing_notes(paper), *_wrapping_notes(flat)]
    band_mm = max(RULER_HIGH_MM + 3.0 + LEADING * TEXT_MM * len(notes), SQUARE_MM)
    best: tuple[tuple[int, int], tuple[float, float], list[Piece], int] | None = None
    for size_mm in paper.sizes_mm():
        wide_mm, high_mm = paper.room_mm(size_mm)
        columns = int((wide_mm - TAB_MM) // flat.pitch_mm)
        rows = int((high_mm - band_mm) // (flat.height_mm + ABOVE_MM + BELOW_MM))
        if columns >= 1 and rows >= 1 and wide_mm >= SQUARE_MM + BESIDE_MM + TEXT_WIDE_MM:
            pieces = _pieces(flat.strip.columns, columns)
            cost = (len(pieces), -(-len(pieces) // rows))
            if best is None or cost < best[0]:
                best = cost, size_mm, pieces, rows
    if best is None:
        wide_mm, high_mm = max(flat.pitch_mm + TAB_MM, SQUARE_MM + BESIDE_MM + TEXT_WIDE_MM), flat.height_mm + ABOVE_MM + BELOW_MM + band_mm
        raise UserError(
            f"a page of {paper.size_mm[0]:g} x {paper.size_mm[1]:g} mm is too small for the strip: one piece and the ruler require "
            f"{wide_mm:.0f} x {high_mm:.0f} mm within the margins; use a larger --page"
        )
    (_, pages), size_mm, pieces, rows = best
    made = []
    for number in range(pages):
        here = pieces[number * rows : (number + 1) * rows]
        made.append(_page(flat, paper, size_mm, here, notes, title=f"marker strip of {scene.name}, page {number + 1} of {pages}"))
    return made


def _pieces(columns: int, most: int) -> list[Piece]:
    """Divide the columns evenly into pieces of at most ``most`` columns."""
    ends = np.rint(np.linspace(0, columns, -(-columns // most) + 1)).astype(int)
    return [Piece(number=k, first=int(a), last=int(b)) for k, (a, b) in enumerate(pairwise(ends))]


def _wrapping_notes(flat: FlatStrip) -> list[str]:
    across_mm = 2.0 * flat.net_pot.outer_radius_mm
    return [
        "Cut along the grey lines. Glue each piece's left edge on the line where the",
        "white tab of the previous piece of the same strip begins; the last tab goes under",
        f"the first piece, closing at the seam: {flat.length_mm:.1f} mm round, for paper {flat.paper_mm:g} mm thick.",
        "Arrows point up. After wrapping, measure the diameter of the pot over",
        f"the paper: it must be {across_mm:.1f} mm. If not, enter half of the measured value in",
        "the scene as net_pot.outer_radius_mm, and print the strip again.",
    ]


def _page(flat: FlatStrip, paper: Paper, size_mm: tuple[float, float], pieces: list[Piece], notes: list[str], *, title: str) -> Page:
    left_mm, top_mm = paper.corner_mm()
    parts: list[Part] = []
    for row, piece in enumerate(pieces):
        parts += _piece(flat, piece, left_mm, top_mm + ABOVE_MM + row * (flat.height_mm + ABOVE_MM + BELOW_MM))
    bottom_mm = top_mm + paper.room_mm(size_mm)[1]
    parts += square(left_mm, bottom_mm - SQUARE_MM)
    beside_mm = left_mm + SQUARE_MM + BESIDE_MM
    text_top_mm = bottom_mm - LEADING * TEXT_MM * len(notes)
    parts += [Text(at_mm=(beside_mm, text_top_mm - RULER_HIGH_MM - 1.0), text=title)]
    parts += ruler(beside_mm, text_top_mm - RULER_HIGH_MM + 1.0)
    parts += lines(beside_mm, text_top_mm, notes)
    return Page(size_mm=size_mm, parts=tuple(parts), stretch_xy=paper.stretch_xy)


def _piece(flat: FlatStrip, piece: Piece, left_mm: float, top_mm: float) -> list[Part]:
    """Return the parts of one piece: markers (row 0 at the top), cut marks and tab."""
    strip, pot, ids = flat.strip, flat.net_pot, strip_ids(flat.strip)
    number, last_of_all = strip.first_id // ids.size + 1, piece.last == strip.columns
    end_mm, bottom_mm = left_mm + (piece.last - piece.first) * flat.pitch_mm, top_mm + flat.height_mm
    black = []
    for row in range(strip.rows):
        upper_mm = top_mm + pot.top_mm - (strip.bottom_mm + (strip.rows - 1 - row) * strip.row_pitch_mm + strip.marker_mm)
        for column in range(piece.first, piece.last):
            middle_mm = left_mm + (column + 0.5 - piece.first) * flat.pitch_mm
            flat_marker = black_rectangles(
                strip.dictionary,
                int(ids[row, column]),
                left_mm=-strip.marker_mm / 2.0,
                top_mm=0.0,
                side_mm=strip.marker_mm,
            )
            black.append(flat_marker * np.array([flat.bend, 1.0, flat.bend, 1.0]) + np.array([middle_mm, upper_mm, middle_mm, upper_mm]))
    parts: list[Part] = [Fill(rectangles_mm=np.concatenate(black))]
    parts += _cuts(left_mm, end_mm, top_mm, bottom_mm)
    parts += _labels(flat, piece, left_mm, top_mm)
    parts += [
        _arrow(left_mm + 3.0, top_mm - 2.0),
        Text(at_mm=(left_mm + 5.5, top_mm - 3.5), text=f"up; strip {number}, piece {piece.number + 1}", height_mm=1.8),
    ]
    tab = f"glue under piece {1 if last_of_all else piece.number + 2} of strip {number}"
    parts += [Text(at_mm=(end_mm + TAB_MM / 2.0 + 0.8, bottom_mm - 1.5), text=tab, height_mm=1.5, grey=0.4, turned=True)]
    if piece.first == 0:
        parts += [Shape(points_mm=np.array([[left_mm, top_mm], [left_mm + 1.0, top_mm], [left_mm, top_mm + 1.6]]))]
        parts += [Text(at_mm=(left_mm, bottom_mm + 3.6), text="seam (+x)", height_mm=1.5)]
    if last_of_all:
        parts += [Shape(points_mm=np.array([[end_mm, top_mm], [end_mm - 1.0, top_mm], [end_mm, top_mm + 1.6]]))]
        parts += [Text(at_mm=(end_mm, bottom_mm + 3.6), text="seam (+x)", height_mm=1.5, align="right")]
    return parts


def _cuts(left_mm: float, end_mm: float, top_mm: float, bottom_mm: float) -> list[Part]:
    """Return the outline of a piece and its tab, with cut marks that point to the corners.

    A line across the tab's beginning marks where the next piece begins.
    """
    tab_mm = end_mm + TAB_MM
    grey = {"grey": CUT_GREY}
    parts: list[Part] = [Line(from_mm=(left_mm, y), to_mm=(tab_mm, y), **grey) for y in (top_mm, bottom_mm)]
    parts += [Line(from_mm=(x, top_mm), to_mm=(x, bottom_mm), **grey) for x in (left_mm, end_mm, tab_mm)]
    for x in (left_mm, end_mm, tab_mm):
        parts += [
            Line(from_mm=(x, top_mm - 0.5), to_mm=(x, top_mm - 0.5 - MARK_MM)),
            Line(from_mm=(x, bottom_mm + 0.5), to_mm=(x, bottom_mm + 2.0)),
        ]
    for y in (top_mm, bottom_mm):
        parts += [
            Line(from_mm=(left_mm - 0.5, y), to_mm=(left_mm - 0.5 - MARK_MM, y)),
            Line(from_mm=(tab_mm + 0.5, y), to_mm=(tab_mm + MARK_MM, y)),
        ]
    return parts


def _labels(flat: FlatStrip, piece: Piece, left_mm: float, top_mm: float) -> list[Part]:
    """Return each column's marker ids, placed on the strip if the quiet zone permits, otherwise above the cut line."""
    strip, ids = flat.strip, strip_ids(flat.strip)
    highest_mm = strip.bottom_mm + (strip.rows - 1) * strip.row_pitch_mm + strip.marker_mm
    cell_mm = strip.marker_mm / len(marker_cells(strip.dictionary, int(ids[0, 0])))
    fits = flat.net_pot.top_mm - highest_mm >= EDGE_MM + LABEL_MM + QUIET_CELLS * cell_mm
    baseline_mm = top_mm + EDGE_MM + LABEL_MM if fits else top_mm - 1.0
    parts: list[Part] = []
    for column in range(piece.first, piece.last):
        middle_mm = left_mm + (column + 0.5 - piece.first) * flat.pitch_mm
        text = " ".join(map(str, ids[:, column]))
        parts.append(Text(at_mm=(middle_mm, baseline_mm), text=text, height_mm=LABEL_MM, grey=0.3, align="center"))
        if fits and column == piece.first:
            parts.append(_arrow(middle_mm - 0.5 * strip.marker_mm, baseline_mm, high_mm=LABEL_MM))
    return parts


def _arrow(x_mm: float, foot_mm: float, *, high_mm: float = 4.5) -> Shape:
    """Return an upward arrow whose lower end is at ``foot_mm``."""
    outline = np.array([[-0.12, 0.0], [-0.12, -0.5], [-0.35, -0.5], [0.0, -1.0], [0.35, -0.5], [0.12, -0.5], [0.12, 0.0]])
    return Shape(points_mm=outline * high_mm + np.array([x_mm, foot_mm]), grey=0.3)
