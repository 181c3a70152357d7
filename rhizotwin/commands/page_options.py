"""Command-line options for printed pages: paper, printer scale, and calibration board."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from rhizotwin.scenes.errors import UserError
from rhizotwin.steps.arguments import Flag, option, read_length_mm, read_two_integers, with_metavar

if TYPE_CHECKING:
    from rhizotwin.rig.printing.print_page import Paper
    from rhizotwin.scenes.board import CharucoBoard

PAGES = ("a4", "a3", "letter")
PAGE_LIMITS_MM = (50.0, 5000.0)
RULER_LIMITS_MM = (90.0, 110.0)
SQUARE_LIMITS_MM = (1.0, 1000.0)
SQUARES_LIMITS = (3, 60)


def read_page(text: str) -> str | tuple[float, float]:
    """Convert text to the name of a paper size, or to its width and height in mm."""
    if text.lower() in PAGES:
        return text.lower()
    pair = _pair(text)
    if pair is None:
        raise ValueError(f"{text!r} is not a paper size; give {', '.join(PAGES)}, or width and height in mm, such as 297x210")
    return read_length_mm(pair[0], PAGE_LIMITS_MM), read_length_mm(pair[1], PAGE_LIMITS_MM)


def read_printed_ruler(text: str) -> tuple[float, float]:
    """Convert text to the length of the printed 100 mm ruler across the page and down the page, as measured in mm.

    Text with a single number gives both lengths.
    """
    pair = _pair(text if "x" in text.lower() else f"{text}x{text}")
    if pair is None:
        raise ValueError(f"{text!r} is not a ruler length in mm; write it as 99.6, or as 99.6x99.8 (across and down)")
    return read_length_mm(pair[0], RULER_LIMITS_MM), read_length_mm(pair[1], RULER_LIMITS_MM)


def read_squares(text: str) -> tuple[int, int]:
    """Convert text such as 7x5 to the number of squares of a board across and down."""
    return read_two_integers(text, SQUARES_LIMITS, "a number of squares", "7x5", "squares per side")


def read_square_mm(text: str) -> float:
    """Convert text to the side length of a square in mm."""
    return read_length_mm(text, SQUARE_LIMITS_MM)


def _pair(text: str) -> tuple[str, str] | None:
    """Split text such as 297x210 into its two numbers, which are returned as texts.

    The result is None if the text does not consist of two numbers with an x between them.
    """
    first, cross, second = text.lower().partition("x")
    try:
        float(first), float(second)
    except ValueError:
        return None
    return (first, second) if cross else None


@Parameter(name="*", group="Paper")
@dataclass(frozen=True, kw_only=True)
class PageOptions:
    """Options for the paper and the scale of the printer."""

    page: Annotated[str | tuple[float, float], option(read_page, "SIZE")] = "a4"
    """Paper size: a4, a3, letter, or width and height in mm, such as 297x210."""
    landscape: Flag = False
    """Print in landscape orientation; default: the orientation that fits better."""
    portrait: Flag = False
    """Print in portrait orientation."""
    printed_ruler_mm: Annotated[tuple[float, float], option(read_printed_ruler, "MM")] = (100.0, 100.0)
    """Lengths in mm of the 100 mm ruler as measured on an earlier print, across and down the page, such as 99.6 or \
99.6x99.8. The drawing is scaled to compensate for the error of the printer."""

    def paper(self) -> "Paper":
        """Return the paper that the options describe.

        Raises
        ------
        UserError
            If both orientations are requested.
        """
        from rhizotwin.rig.printing.print_page import PAGES_MM, Paper

        if self.landscape and self.portrait:
            raise UserError("--landscape and --portrait cannot be used together; remove one of them")
        free: Literal["either", "as given"] = "either" if isinstance(self.page, str) else "as given"
        size_mm = PAGES_MM[self.page] if isinstance(self.page, str) else self.page
        turn: Literal["either", "as given", "landscape", "portrait"]
        turn = "landscape" if self.landscape else "portrait" if self.portrait else free
        return Paper(size_mm=size_mm, turn=turn, printed_ruler_mm=self.printed_ruler_mm)


@Parameter(name="*", group="Board")
@dataclass(frozen=True, kw_only=True)
class BoardOptions:
    """Options that describe a calibration board."""

    squares: Annotated[tuple[int, int] | None, option(read_squares, "NxN")] = None
    """Number of squares across and down; default: 7x5."""
    square_mm: Annotated[float | None, option(read_square_mm, "MM")] = None
    """Side length of the squares in mm; default: 30."""
    marker_mm: Annotated[float | None, option(read_square_mm, "MM")] = None
    """Side length of the markers in mm; default: 11/15 of the squares' side."""
    dictionary: Annotated[str | None, with_metavar("NAME")] = None
    """ArUco dictionary of the markers; default: 5X5_100."""

    def given(self) -> list[str]:
        """Return the names of the options that were given on the command line."""
        return [f"--{name.replace('_', '-')}" for name, value in vars(self).items() if value is not None]

    def board(self) -> "CharucoBoard":
        """Return the board that the options describe, after validation."""
        from rhizotwin.scenes.board import MARKER_SHARE, CharucoBoard, check_board

        default = CharucoBoard()
        square_mm = self.square_mm or default.square_mm
        board = CharucoBoard(
            squares_xy=self.squares or default.squares_xy,
            square_mm=square_mm,
            marker_mm=self.marker_mm or round(square_mm * MARKER_SHARE, 3),
            dictionary=self.dictionary or default.dictionary,
        )
        return check_board(board, where="the board")

    def board_of(self, file: Path | None) -> "CharucoBoard":
        """Return the board described by a file, or by the options if ``file`` is None."""
        from rhizotwin.scenes.board import load_board

        if file is None:
            return self.board()
        if self.given():
            raise UserError(
                f"--board {file} and {self.given()[0]} cannot be used together, because the file describes the complete board; "
                f"remove {self.given()[0]}"
            )
        return load_board(file)
