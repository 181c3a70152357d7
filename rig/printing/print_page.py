"""Pages for printing at true scale.

A page describes its contents in millimetres, with a ruler and a square for checking the printer's scale.
"""

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np

from rhizotwin.scenes.frames import Array

PAGES_MM: Final = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4)}
"""Width and height of pages in portrait orientation, mm."""
MARGIN_MM: Final = 10.0
"""Margin on all sides, mm. Printers do not print up to the edge."""
RULER_MM: Final = 100.0
SQUARE_MM: Final = 50.0
LINE_MM: Final = 0.1
TEXT_MM: Final = 2.2
"""Height of capital letters, mm."""
LEADING: Final = 1.75
TEXT_WIDE_MM: Final = 118.0
"""Width required for lines of text, mm. A ruler requires less."""
RULER_HIGH_MM: Final = 11.0
"""Height of a ruler including its numbers, mm."""


@dataclass(frozen=True, kw_only=True)
class Fill:
    """Rectangles (N, 4) filled as one shape. Columns are left, top, right and bottom."""

    rectangles_mm: Array
    grey: float = 0.0
    """Grey level: 0 is black, 1 is white."""


@dataclass(frozen=True, kw_only=True)
class Shape:
    """Filled polygon with vertices (N, 2)."""

    points_mm: Array
    grey: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Line:
    """Straight line between two points."""

    from_mm: tuple[float, float]
    to_mm: tuple[float, float]
    width_mm: float = LINE_MM
    grey: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Strokes:
    """Polylines (N, 2) drawn with the same width."""

    lines_mm: tuple[Array, ...]
    width_mm: float = LINE_MM
    grey: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Text:
    """One line of text. ``at_mm`` is the position of its anchor on the baseline."""

    at_mm: tuple[float, float]
    text: str
    height_mm: float = TEXT_MM
    grey: float = 0.0
    align: Literal["left", "center", "right"] = "left"
    turned: bool = False
    """Whether to rotate the text so that it reads upwards."""


Part: TypeAlias = Fill | Shape | Line | Strokes | Text


@dataclass(frozen=True, kw_only=True)
class Page:
    """One page. Coordinates are in mm on paper, with x to the right and y down from the upper left corner."""

    size_mm: tuple[float, float]
    """Width and height of the paper, mm."""
    parts: tuple[Part, ...]
    stretch_xy: tuple[float, float] = (1.0, 1.0)
    """Horizontal and vertical magnification of all contents, which compensates for a printer that prints too small."""


@dataclass(frozen=True, kw_only=True)
class Paper:
    """Paper size, orientation, and measured scale of the printer."""

    size_mm: tuple[float, float] = PAGES_MM["a4"]
    turn: Literal["either", "portrait", "landscape", "as given"] = "either"
    printed_ruler_mm: tuple[float, float] = (RULER_MM, RULER_MM)
    """Lengths, mm, across and down the page, that a ruler of 100 mm has when it is printed without correction."""

    @property
    def stretch_xy(self) -> tuple[float, float]:
        """Magnification across and down the page that compensates for the measured scale of the printer."""
        return RULER_MM / self.printed_ruler_mm[0], RULER_MM / self.printed_ruler_mm[1]

    def sizes_mm(self) -> list[tuple[float, float]]:
        """Return the width and height of the page, mm, in each permitted orientation."""
        low, high = sorted(self.size_mm)
        turned = {"portrait": [(low, high)], "landscape": [(high, low)], "either": [(low, high), (high, low)]}
        return turned.get(self.turn, [self.size_mm])

    def room_mm(self, size_mm: tuple[float, float]) -> tuple[float, float]:
        """Return the width and height available within the margins of a page.

        They are in millimetres of the page's contents before the correction of the printer's scale.
        """
        across, down = self.stretch_xy
        return (size_mm[0] - 2.0 * MARGIN_MM) / across, (size_mm[1] - 2.0 * MARGIN_MM) / down

    def corner_mm(self) -> tuple[float, float]:
        """Return the upper left corner of the area within the margins, mm."""
        return MARGIN_MM / self.stretch_xy[0], MARGIN_MM / self.stretch_xy[1]


def ruler(left_mm: float, top_mm: float, *, upright: bool = False) -> list[Part]:
    """Return the parts of a ruler of 100 mm.

    The length is measured from the centre of its first line to the centre of its last line. The first line is at
    ``left_mm`` or, if the ruler is upright, at ``top_mm``.

    Parameters
    ----------
    left_mm, top_mm : float
        Position of the ruler's upper left corner, from the page's upper left corner.
    upright : bool
        Whether the ruler runs down the page.

    Returns
    -------
    list of Part
        Lines and numbers.
    """
    parts: list[Part] = []
    for mm in range(int(RULER_MM) + 1):
        long_mm = 5.0 if mm % 10 == 0 else 3.5 if mm % 5 == 0 else 2.2
        if upright:
            parts.append(Line(from_mm=(left_mm, top_mm + mm), to_mm=(left_mm + long_mm, top_mm + mm)))
        else:
            parts.append(Line(from_mm=(left_mm + mm, top_mm), to_mm=(left_mm + mm, top_mm + long_mm)))
        if mm % 10 == 0 and upright:
            parts.append(Text(at_mm=(left_mm + 6.0, top_mm + mm + 0.7), text=str(mm), height_mm=1.6))
        elif mm % 10 == 0:
            parts.append(
                Text(at_mm=(left_mm + mm, top_mm + 7.6), text=f"{mm} mm" if mm == RULER_MM else str(mm), height_mm=1.6, align="center")
            )
    return parts


def square(left_mm: float, top_mm: float) -> list[Part]:
    """Return a grey square with an edge length of 50 mm, and its label."""
    edges = np.array([[left_mm, top_mm, left_mm + SQUARE_MM, top_mm + SQUARE_MM]])
    middle = (left_mm + SQUARE_MM / 2.0, top_mm + SQUARE_MM / 2.0)
    return [Fill(rectangles_mm=edges, grey=0.85), Text(at_mm=middle, text=f"{SQUARE_MM:g} x {SQUARE_MM:g} mm", align="center")]


def lines(left_mm: float, top_mm: float, texts: list[str], *, height_mm: float = TEXT_MM) -> list[Part]:
    """Return lines of text below each other. The capital letters of the first line begin at ``top_mm``.

    Parameters
    ----------
    left_mm, top_mm : float
        Upper left corner of the first line's capital letters, from the page's upper left corner.
    texts : list of str
        Lines of text.
    height_mm : float
        Height of capital letters, mm.

    Returns
    -------
    list of Part
        One text part per line.
    """
    return [
        Text(at_mm=(left_mm, top_mm + height_mm * (1.0 + LEADING * number)), text=text, height_mm=height_mm)
        for number, text in enumerate(texts)
    ]


def printing_notes(paper: Paper) -> list[str]:
    """Return the notes about checking the printer's scale, which are printed on every page."""
    across, down = paper.printed_ruler_mm
    notes = [
        "Print at 100 % (actual size, no fitting to the page), then measure:",
        "the ruler must be 100.0 mm long, the square 50.0 mm wide and high.",
    ]
    if (across, down) == (RULER_MM, RULER_MM):
        return [
            *notes,
            "If not, write this file again with --printed-ruler-mm and the measured",
            "length of 100 mm across and down the page, such as 99.6x99.8.",
        ]
    return [*notes, f"Corrected for a printer that prints 100 mm as {across:g} mm across", f"and {down:g} mm down."]
