"""The calibration board, the same for printer, twin and calibration.

It is a chessboard with ArUco markers in its white squares (ChArUco).
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from rhizotwin.scenes import toml_text
from rhizotwin.scenes.atomic import write_text
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import read_toml
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.limits import bounded
from rhizotwin.scenes.markers import black_rectangles, dictionary_named
from rhizotwin.scenes.schema import Place, from_plain, to_plain

MARKER_SHARE = 11.0 / 15.0
"""Side of a marker over that of its square, where nothing else is said."""
LEAST_GAP = 0.05
"""White between a marker and the edge of its square, in squares: less, and the corners cannot be measured."""


@dataclass(frozen=True, kw_only=True)
class CharucoBoard:
    """A ChArUco board in OpenCV's present pattern: the top left square is black, ids rise along the rows.

    The board's frame has its origin at the pattern's top left corner, x to the right, y down, z away from the viewer.
    """

    squares_xy: tuple[int, int] = bounded((7, 5), 3, 60)
    """Squares to the right and down."""
    square_mm: float = bounded(30.0, 1.0, 1000.0)
    marker_mm: float = bounded(22.0, 0.5, 1000.0)
    dictionary: str = "5X5_100"
    """One that the strip does not use, so that neither is taken for the other."""

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the pattern."""
        return self.squares_xy[0] * self.square_mm, self.squares_xy[1] * self.square_mm

    @property
    def markers(self) -> int:
        """How many markers it has: one in every white square."""
        return self.squares_xy[0] * self.squares_xy[1] // 2

    @property
    def corners_mm(self) -> Array:
        """Inner corners of the chessboard (N, 3) in the board's frame, along the rows; the index is the corner's id."""
        x, y = np.meshgrid(np.arange(1, self.squares_xy[0]), np.arange(1, self.squares_xy[1]))
        return np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3).astype(np.float64) * self.square_mm


def opencv_board(board: CharucoBoard) -> cv2.aruco.CharucoBoard:
    """Return the board as OpenCV has it, in mm."""
    return cv2.aruco.CharucoBoard(board.squares_xy, board.square_mm, board.marker_mm, dictionary_named(board.dictionary))


def black_parts(board: CharucoBoard) -> Array:
    """Return the black squares and black parts of the markers as rectangles (N, 4), mm.

    Left, top, right, bottom in the board's frame.
    """
    columns, rows = board.squares_xy
    gap_mm = (board.square_mm - board.marker_mm) / 2.0
    parts, marker = [], 0
    for row in range(rows):
        for column in range(columns):
            left_mm, top_mm = column * board.square_mm, row * board.square_mm
            if (row + column) % 2 == 0:
                parts.append(np.array([[left_mm, top_mm, left_mm + board.square_mm, top_mm + board.square_mm]]))
            else:
                at = {"left_mm": left_mm + gap_mm, "top_mm": top_mm + gap_mm, "side_mm": board.marker_mm}
                parts.append(black_rectangles(board.dictionary, marker, **at))
                marker += 1
    return np.concatenate(parts)


def check_board(board: CharucoBoard, *, where: str = "board", text: str = "") -> CharucoBoard:
    """Return the board if it can be drawn and found again.

    Parameters
    ----------
    board : CharucoBoard
        What is to be drawn.
    where : str
        What messages call it.
    text : str
        The file it is from, to name the line that is wrong.

    Returns
    -------
    CharucoBoard
        The same board.

    Raises
    ------
    UserError
        For an unknown or too small dictionary, or markers that do not fit into their squares.
    """
    place = Place(where, text)
    if board.marker_mm > board.square_mm * (1.0 - 2.0 * LEAST_GAP):
        must = f"must be at most {board.square_mm * (1.0 - 2.0 * LEAST_GAP):g}, to leave white round the markers"
        raise place.at("board", "marker_mm").error(must, board.marker_mm)
    try:
        size = len(dictionary_named(board.dictionary).bytesList)
    except UserError as error:
        raise place.at("board", "dictionary").error(str(error)) from error
    if board.markers > size:
        must = f"needs {board.markers} markers, but {board.dictionary} has {size}: use fewer squares or a larger dictionary"
        raise place.at("board", "squares_xy").error(must, list(board.squares_xy))
    return board


def load_board(path: Path | str) -> CharucoBoard:
    """Load a board file: TOML with one section ``[board]``; what is left out takes the default.

    Raises
    ------
    UserError
        For an unreadable file, or anything wrong in it, with line, key, value and limit.
    """
    path = Path(path)
    table, text = read_toml(path)
    place = Place(str(path), text)
    for key in table:
        if key != "board":
            raise place.at(key).error("unknown key; a board file has the section [board] only")
    return check_board(from_plain(CharucoBoard, table.get("board", {}), place.at("board")), where=str(path), text=text)


def save_board(board: CharucoBoard, path: Path | str) -> None:
    """Write a board file that `load_board` reads back to an equal board."""
    write_text(
        path,
        "# The calibration board, as drawn: rhizotwin calibrate camera PICTURES --board THIS_FILE\n"
        + toml_text.dumps({"board": to_plain(board)}),
    )
