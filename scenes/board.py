"""ChArUco calibration board for printing, rendering and calibration.

The board is a chessboard with ArUco markers in its white squares.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from rhizotwin.scenes import toml_text
from rhizotwin.scenes.atomic import write_text
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import read_toml
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.limits import bounded
from rhizotwin.scenes.markers import black_rectangles, get_dictionary
from rhizotwin.scenes.schema import Place, from_plain, to_plain

MARKER_SHARE = 11.0 / 15.0
"""Default ratio of a marker's side length to that of its square."""
LEAST_GAP = 0.05
"""Minimum width of the white margin between a marker and the edge of its square, as a fraction of the square's side
length. Corners cannot be measured if the margin is narrower."""


@dataclass(frozen=True, kw_only=True)
class CharucoBoard:
    """ChArUco board of OpenCV: the top left square is black, and ids increase along the rows.

    The origin of the board's frame is the top left corner of the pattern, with x to the right, y down and z away from
    the viewer.
    """

    squares_xy: tuple[int, int] = bounded((7, 5), 3, 60)
    """Number of squares of the chessboard in x and y."""
    square_mm: float = bounded(30.0, 1.0, 1000.0)
    marker_mm: float = bounded(22.0, 0.5, 1000.0)
    dictionary: str = "5X5_100"
    """ArUco dictionary of the markers, which must differ from the dictionary of the strip."""
    legacy_pattern: bool = False
    """Pattern of OpenCV before 4.6, as of many printed boards: with an even number of rows, the top left square is
    white. With an odd number of rows, both patterns are the same."""

    @property
    def other_pattern(self) -> "CharucoBoard | None":
        """Return the board with the other pattern; None if both patterns are the same."""
        return None if self.squares_xy[1] % 2 else replace(self, legacy_pattern=not self.legacy_pattern)

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the pattern, mm."""
        return self.squares_xy[0] * self.square_mm, self.squares_xy[1] * self.square_mm

    @property
    def markers(self) -> int:
        """Number of markers, one in every white square."""
        return self.squares_xy[0] * self.squares_xy[1] // 2

    @property
    def corners_mm(self) -> Array:
        """Inner corners of the chessboard (N, 3) in the board's frame, row by row, mm.

        The index of a corner is its id.
        """
        x, y = np.meshgrid(np.arange(1, self.squares_xy[0]), np.arange(1, self.squares_xy[1]))
        return np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3).astype(np.float64) * self.square_mm


def opencv_board(board: CharucoBoard) -> cv2.aruco.CharucoBoard:
    """Convert the board to an OpenCV object with dimensions in mm."""
    made = cv2.aruco.CharucoBoard(board.squares_xy, board.square_mm, board.marker_mm, get_dictionary(board.dictionary))
    made.setLegacyPattern(board.legacy_pattern)
    return made


def black_parts(board: CharucoBoard) -> Array:
    """Return the black squares and the black parts of the markers as rectangles (N, 4), mm.

    The columns are the left, top, right and bottom edge in the board's frame.
    """
    columns, rows = board.squares_xy
    gap_mm = (board.square_mm - board.marker_mm) / 2.0
    parts, marker, first_black = [], 0, int(board.legacy_pattern and rows % 2 == 0)
    for row in range(rows):
        for column in range(columns):
            left_mm, top_mm = column * board.square_mm, row * board.square_mm
            if (row + column) % 2 == first_black:
                parts.append(np.array([[left_mm, top_mm, left_mm + board.square_mm, top_mm + board.square_mm]]))
            else:
                at = {"left_mm": left_mm + gap_mm, "top_mm": top_mm + gap_mm, "side_mm": board.marker_mm}
                parts.append(black_rectangles(board.dictionary, marker, **at))
                marker += 1
    return np.concatenate(parts)


def check_board(board: CharucoBoard, *, where: str = "board", text: str = "") -> CharucoBoard:
    """Check that a board can be drawn and detected, and return it.

    Parameters
    ----------
    board : CharucoBoard
        Board to check.
    where : str
        Name of the file or other origin, used in messages.
    text : str
        Text of the file, used to determine the number of the invalid line.

    Returns
    -------
    CharucoBoard
        The given board.

    Raises
    ------
    UserError
        If the dictionary is unknown or too small, or the markers do not fit into the squares.
    """
    place = Place(where, text)
    if board.marker_mm > board.square_mm * (1.0 - 2.0 * LEAST_GAP):
        must = f"must be at most {board.square_mm * (1.0 - 2.0 * LEAST_GAP):g}, so that a white margin around the markers remains"
        raise place.at("board", "marker_mm").error(must, board.marker_mm)
    try:
        size = len(get_dictionary(board.dictionary).bytesList)
    except UserError as error:
        raise place.at("board", "dictionary").error(str(error)) from error
    if board.markers > size:
        must = f"requires {board.markers} markers, but {board.dictionary} has only {size}; use fewer squares or a larger dictionary"
        raise place.at("board", "squares_xy").error(must, list(board.squares_xy))
    return board


def load_board(path: Path | str) -> CharucoBoard:
    """Load a board file, which is a TOML file with the section ``[board]``. Missing keys take their default values.

    Raises
    ------
    UserError
        If the file cannot be read or is invalid; the message states line, key, value and limit.
    """
    path = Path(path)
    table, text = read_toml(path)
    place = Place(str(path), text)
    for key in table:
        if key != "board":
            raise place.at(key).error("unknown key; a board file has only the section [board]")
    return check_board(from_plain(CharucoBoard, table.get("board", {}), place.at("board")), where=str(path), text=text)


def save_board(board: CharucoBoard, path: Path | str) -> None:
    """Write a board file from which `load_board` reads an equal board."""
    write_text(
        path,
        "# Calibration board as drawn, for use with: rhizotwin calibrate camera PICTURES --board THIS_FILE\n"
        + toml_text.dumps({"board": to_plain(board)}),
    )
