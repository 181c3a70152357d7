"""Pages for printing at true scale: their contents in millimetres, with a ruler and a square to check the printer."""

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np

from rhizotwin.scenes.frames import Array

PAGES_MM: Final = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4)}
"""Width and height of pages in portrait orientation."""
MARGIN_MM: Final = 10.0
"""Margin on all sides, as printers do not print up to the edge."""
RULER_MM: Final = 100.0
SQUARE_MM: Final = 50.0
LINE_MM: Final = 0.1
TEXT_MM: Final = 2.2
"""Height of capitals in text."""
LEADING: Final = 1.75
TEXT_WIDE_MM: Final = 118.0
"""Width required for lines of text; the ruler requires less."""
RULER_HIGH_MM: Final = 11.0
"""Height of a ruler with its numbers."""


@dataclass(frozen=True, kw_only=True)
class Fill:
    """Rectangles (N, 4) filled as one shape: left, top, right, bottom."""

    rectangles_mm: Array
    grey: float = 0.0
    """Grey level: 0 black, 1 white."""


@dataclass(frozen=True, kw_only=True)
class Shape:
    """A filled polygon (N, 2)."""

    points_mm: Array
    grey: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Line:
    """A straight line."""

    from_mm: tuple[float, float]
    to_mm: tuple[float, float]
    width_mm: float = LINE_MM
    grey: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Strokes:
    """Polylines (N, 2) of one width."""

    lines_mm: tuple[Array, ...]
    width_mm: float = LINE_MM
    grey: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Text:
    """One line of text; ``at_mm`` is on its baseline."""

    at_mm: tuple[float, float]
    text: str
    height_mm: float = TEXT_MM
    grey: float = 0.0
    align: Literal["left", "center", "right"] = "left"
    turned: bool = False
    """Whether to rotate the text to read upwards."""


Part: TypeAlias = Fill | Shape | Line | Strokes | Text


@dataclass(frozen=True, kw_only=True)
class Page:
    """One page, with x to the right and y down from its top left corner, in mm on paper."""

    size_mm: tuple[float, float]
    """Size of the paper."""
    parts: tuple[Part, ...]
    stretch_xy: tuple[float, float] = (1.0, 1.0)
    """Enlargement of all contents, for a printer that prints too small."""


@dataclass(frozen=True, kw_only=True)
class Paper:
    """Paper size and scale of the printer."""

    size_mm: tuple[float, float] = PAGES_MM["a4"]
    turn: Literal["either", "portrait", "landscape", "as given"] = "either"
    printed_ruler_mm: tuple[float, float] = (RULER_MM, RULER_MM)
    """Printed length of 100 mm, across and down the page, without this correction."""

    @property
    def stretch_xy(self) -> tuple[float, float]:
        """Required enlargement across and down the page."""
        return RULER_MM / self.printed_ruler_mm[0], RULER_MM / self.printed_ruler_mm[1]

    def sizes_mm(self) -> list[tuple[float, float]]:
        """Return the page's size in each possible orientation."""
        low, high = sorted(self.size_mm)
        turned = {"portrait": [(low, high)], "landscape": [(high, low)], "either": [(low, high), (high, low)]}
        return turned.get(self.turn, [self.size_mm])

    def room_mm(self, size_mm: tuple[float, float]) -> tuple[float, float]:
        """Return the width and height within the margins of a page, as printed."""
        across, down = self.stretch_xy
        return (size_mm[0] - 2.0 * MARGIN_MM) / across, (size_mm[1] - 2.0 * MARGIN_MM) / down

    def corner_mm(self) -> tuple[float, float]:
        """Return the upper left corner of the area within the margins."""
        return MARGIN_MM / self.stretch_xy[0], MARGIN_MM / self.stretch_xy[1]


def ruler(left_mm: float, top_mm: float, *, upright: bool = False) -> list[Part]:
    """Return a ruler of 100 mm.

    The length is between the centres of its first line, at ``left_mm`` (upright: ``top_mm``), and its last.

    Parameters
    ----------
    left_mm, top_mm : float
        Position of its corner, from the page's upper left.
    upright : bool
        Whether it runs down the page.

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
    """Return a grey square of 50 mm, from edge to edge."""
    edges = np.array([[left_mm, top_mm, left_mm + SQUARE_MM, top_mm + SQUARE_MM]])
    middle = (left_mm + SQUARE_MM / 2.0, top_mm + SQUARE_MM / 2.0)
    return [Fill(rectangles_mm=edges, grey=0.85), Text(at_mm=middle, text=f"{SQUARE_MM:g} x {SQUARE_MM:g} mm", align="center")]


def lines(left_mm: float, top_mm: float, texts: list[str], *, height_mm: float = TEXT_MM) -> list[Part]:
    """Return lines of text below each other, with the capitals of the first one beginning at ``top_mm``.

    Parameters
    ----------
    left_mm, top_mm : float
        Position of the first line's capitals, from the page's upper left.
    texts : list of str
        Lines of text.
    height_mm : float
        Height of capitals.

    Returns
    -------
    list of Part
        One text per line.
    """
    return [
        Text(at_mm=(left_mm, top_mm + height_mm * (1.0 + LEADING * number)), text=text, height_mm=height_mm)
        for number, text in enumerate(texts)
    ]


def printing_notes(paper: Paper) -> list[str]:
    """Return the notes, on every page, about checking the printer."""
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
    return [*notes, f"Drawn for a printer that makes {across:g} mm across and", f"{down:g} mm down of 100 mm."]
