"""Page layout of the calibration board for printing."""

from typing import Final

import numpy as np

from rhizotwin.rig.printing.print_page import (
    LEADING,
    RULER_HIGH_MM,
    RULER_MM,
    SQUARE_MM,
    TEXT_MM,
    TEXT_WIDE_MM,
    Fill,
    Page,
    Paper,
    Part,
    lines,
    printing_notes,
    ruler,
    square,
)
from rhizotwin.scenes.board import CharucoBoard, black_parts, check_board
from rhizotwin.scenes.errors import UserError

GAP_MM: Final = 6.0
"""Width of the white margin around the pattern, mm."""


def board_page(board: CharucoBoard, *, paper: Paper) -> Page:
    """Lay out the board on a page, with a ruler and a square below or beside it.

    Raises
    ------
    UserError
        If the board does not fit on the page or is invalid.
    """
    check_board(board)
    notes = [*printing_notes(paper), *_board_notes(board)]
    text_mm = LEADING * TEXT_MM * len(notes)
    wide_mm, high_mm = board.size_mm
    below_mm = (max(wide_mm, SQUARE_MM + 8.0 + TEXT_WIDE_MM), high_mm + GAP_MM + max(SQUARE_MM, RULER_HIGH_MM + text_mm))
    beside_mm = (max(wide_mm + GAP_MM + SQUARE_MM, RULER_MM + 10.0 + TEXT_WIDE_MM), high_mm + GAP_MM + max(RULER_HIGH_MM, text_mm))
    for size_mm in paper.sizes_mm():
        room_mm = paper.room_mm(size_mm)
        for needed_mm, beside in ((below_mm, False), (beside_mm, True)):
            if needed_mm[0] <= room_mm[0] and needed_mm[1] <= room_mm[1]:
                return Page(size_mm=size_mm, parts=tuple(_parts(board, paper, room_mm, notes, beside=beside)), stretch_xy=paper.stretch_xy)
    page = f"{paper.size_mm[0]:g} x {paper.size_mm[1]:g}"
    raise UserError(
        f"the board of {wide_mm:g} x {high_mm:g} mm, with its ruler, does not fit on a page of {page} mm "
        f"({below_mm[0]:.0f} x {below_mm[1]:.0f} mm are needed within the margins); use a larger --page, or smaller or fewer squares"
    )


def _board_notes(board: CharucoBoard) -> list[str]:
    columns, rows = board.squares_xy
    return [
        f"ChArUco board, {columns}x{rows} squares of {board.square_mm:g} mm, markers {board.marker_mm:g} mm, {board.dictionary}.",
        "Glue this sheet to a flat and stiff plate (glass, acrylic), without bubbles.",
    ]


def _parts(board: CharucoBoard, paper: Paper, room_mm: tuple[float, float], notes: list[str], *, beside: bool) -> list[Part]:
    left_mm, top_mm = paper.corner_mm()
    high_mm = board.size_mm[1]
    parts: list[Part] = [Fill(rectangles_mm=black_parts(board) + np.array([left_mm, top_mm, left_mm, top_mm]))]
    under_mm = top_mm + high_mm + GAP_MM
    if not beside:
        right_mm = left_mm + SQUARE_MM + 8.0
        parts += [*square(left_mm, under_mm), *ruler(right_mm, under_mm), *lines(right_mm, under_mm + RULER_HIGH_MM, notes)]
        if room_mm[1] >= high_mm + 3.0 * GAP_MM + SQUARE_MM + RULER_MM:
            parts += ruler(left_mm, under_mm + SQUARE_MM + GAP_MM, upright=True)
        return parts
    right_mm = left_mm + room_mm[0] - SQUARE_MM
    parts += [*square(right_mm, top_mm), *ruler(left_mm + 2.0, under_mm), *lines(left_mm + RULER_MM + 10.0, under_mm, notes)]
    if high_mm + GAP_MM >= SQUARE_MM + GAP_MM + RULER_MM:
        parts += ruler(right_mm, top_mm + SQUARE_MM + GAP_MM, upright=True)
    return parts
