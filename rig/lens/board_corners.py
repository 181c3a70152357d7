"""Detection of the calibration board.

OpenCV identifies the corners, and `rig.lens.saddle_fit` measures their positions.
"""

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.rig.lens.saddle_fit import Saddle, fit_saddle
from rhizotwin.scenes.board import CharucoBoard, opencv_board
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.markers import get_dictionary
from rhizotwin.scenes.picture_reduction import Picture, reduce_picture

LEAST_CORNERS: Final = 8
LEAST_MEASURED: Final = 0.5
"""Minimum fraction of the detected corners whose positions must be measurable for a picture to be used."""
CLEAR: Final = 0.9
"""Extent of the area in which the edges of a corner are fitted, as a fraction of the distance between the corner and
the nearest marker. The distance is the width of the white margin around a marker."""
MOST_BENT: Final = 0.2
"""Maximum median distance between the detected corners and their positions according to a homography of the flat board,
in squares. A larger distance indicates that corners were identified wrongly."""
OTHER_DICTIONARIES: Final = (
    "APRILTAG_36h11",
    "4X4_250",
    "5X5_1000",
    "6X6_250",
    "7X7_250",
    "ARUCO_ORIGINAL",
    "APRILTAG_16h5",
    "APRILTAG_25h9",
    "ARUCO_MIP_36h12",
)


@dataclass(frozen=True, kw_only=True)
class BoardView:
    """Board corners in one picture."""

    ids: NDArray[np.int64]
    """Indices into `CharucoBoard.corners_mm`, ascending, shape (N,)."""
    corners_px: Array
    """Corner positions, px, shape (N, 2). Pixel centres have integer coordinates."""
    sigma_px: float
    """Median standard deviation of the coordinates of a corner, as estimated by the fits, px."""
    blur_px: float
    """Median standard deviation of the blur, px. It includes the averaging over the area of a pixel, which has a
    standard deviation of 0.29 px."""


@dataclass(frozen=True, kw_only=True)
class NoBoard:
    """Result of a failed detection, with the reason."""

    reason: str


def find_board(image: Picture, board: CharucoBoard) -> BoardView | NoBoard:
    """Detect and measure the corners of the board in a picture.

    Parameters
    ----------
    image : (H, W) uint8 or uint16 array
        Grey levels.
    board : CharucoBoard
        Dimensions and dictionary of the printed board.

    Returns
    -------
    BoardView or NoBoard
        At least `LEAST_CORNERS` corners that are not all in one row, or the reason for the failure.
    """
    ids, start_px, markers = _search(image, board)
    if len(ids) < LEAST_CORNERS:
        return NoBoard(reason=_why_few(image, board, corners=len(ids), markers=markers))
    flat, at_mm = _flat(board, ids, start_px)
    if flat is None:
        return NoBoard(reason=f"the {len(ids)} detected corners are in one row; show more of the board")
    near_px = np.median(np.linalg.norm(start_px - _map(flat, at_mm), axis=1))
    if near_px > MOST_BENT * _square_px(board, flat, at_mm):
        return NoBoard(reason=f"the corners do not fit a flat board of {_size(board)} squares; check --squares, and that the board is flat")
    found: dict[int, Saddle] = {}
    for corner, p_px, q_mm in zip(ids.tolist(), start_px, at_mm, strict=True):
        fit = fit_saddle(image, p_px, _sides(board, flat, q_mm))
        if fit is not None:
            found[corner] = fit
    if len(found) < max(LEAST_CORNERS, LEAST_MEASURED * len(ids)):
        return NoBoard(
            reason=f"only {len(found)} of {len(ids)} corners can be measured; the picture is too blurred or noisy, or the board too small"
        )
    chosen = np.array(sorted(found))
    if _flat(board, chosen, np.array([found[k].at_px for k in chosen]))[0] is None:
        return NoBoard(reason=f"the {len(found)} measurable corners are in one row; show more of the board")
    return BoardView(
        ids=chosen,
        corners_px=np.array([found[k].at_px for k in chosen]),
        sigma_px=float(np.median([fit.sigma_px for fit in found.values()])),
        blur_px=float(np.median([fit.blur_px for fit in found.values()])),
    )


def _search(image: Picture, board: CharucoBoard) -> tuple[NDArray[np.int64], Array, int]:
    """Return the ids (N,) of the corners, their approximate positions (N, 2), px, and the number of markers found."""
    small, scale = reduce_picture(image)
    parameters = cv2.aruco.CharucoParameters()
    parameters.minMarkers = 1  # one marker beside a corner identifies it; corners are measured later
    detector = cv2.aruco.CharucoDetector(opencv_board(board), parameters)
    best: tuple[NDArray[np.int64], Array, int] = (np.zeros(0, np.int64), np.zeros((0, 2)), 0)
    for power in (1.0, 0.5):  # the square root raises the contrast of dark parts
        corners, ids, _, marker_ids = detector.detectBoard(_tone(small, power))
        markers = 0 if marker_ids is None else len(marker_ids)
        if ids is not None and len(ids) > len(best[0]):
            found = np.ravel(ids).astype(np.int64)
            order = np.argsort(found)
            best = found[order], ((np.asarray(corners, np.float64).reshape(-1, 2) + 0.5) * scale - 0.5)[order], markers
        elif not len(best[0]):
            best = (*best[:2], max(best[2], markers))
        if len(best[0]) > LEAST_CORNERS:
            break
    return best


def _tone(image: Picture, power: float) -> NDArray[np.uint8]:
    """Scale a picture to 8 bits. Only the brightest 0.5 % of the pixels are clipped."""
    top = max(float(np.percentile(image[::3, ::3], 99.5)), 1.0)
    return np.asarray(255.0 * np.clip(image.astype(np.float32) / top, 0.0, 1.0) ** power, np.uint8)


def _flat(board: CharucoBoard, ids: NDArray[np.int64], corners_px: Array) -> tuple[Array | None, Array]:
    """Return the homography (3, 3) from board to picture, and the corner positions (N, 2) on the board, mm.

    The homography is None if the corners are in one row.
    """
    at_mm = board.corners_mm[ids, :2]
    if np.linalg.svd(at_mm - at_mm.mean(axis=0), compute_uv=False)[1] < 0.5 * board.square_mm:
        return None, at_mm
    flat, _ = cv2.findHomography(at_mm, corners_px, cv2.LMEDS)
    return (None if flat is None else np.asarray(flat, np.float64)), at_mm


def _map(flat: Array, at_mm: Array) -> Array:
    mapped = at_mm @ flat[:, :2].T + flat[:, 2]
    return mapped[:, :2] / mapped[:, 2:]


def _sides(board: CharucoBoard, flat: Array, at_mm: Array) -> Array:
    """Return two vectors, as columns (2, 2) in pixels, that span the area around a corner without markers.

    They point from the corner along the two edges.
    """
    clear_mm = CLEAR * (board.square_mm - board.marker_mm) / 2.0
    here, right, down = _map(flat, at_mm + clear_mm * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    return np.stack([right - here, down - here], axis=1)


def _square_px(board: CharucoBoard, flat: Array, at_mm: Array) -> float:
    """Return the geometric mean of the two side lengths of a square, px.

    It is computed for a square in the middle of the visible part of the board.
    """
    here, right, down = _map(flat, at_mm.mean(axis=0) + board.square_mm * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    return float(np.sqrt(np.linalg.norm(right - here) * np.linalg.norm(down - here)))


def _size(board: CharucoBoard) -> str:
    return f"{board.squares_xy[0]}x{board.squares_xy[1]}"


def _why_few(image: Picture, board: CharucoBoard, *, corners: int, markers: int) -> str:
    """Return the reason why too few corners were found in a picture."""
    if corners:
        return f"the picture shows only {corners} corners of the board, but at least {LEAST_CORNERS} are needed; show more of the board"
    picture = _tone(image, 1.0)
    if markers >= 3:
        highest = int(_ids(picture, board.dictionary).max(initial=-1))
        if highest >= board.markers:
            cure = (
                f"it has 0 to {board.markers - 1}, but the picture shows marker {highest}; check --squares, and that the first marker is 0"
            )
        elif (fitting := _turned(image, board)) is not None:
            cure = f"the board has {_size(fitting)} squares (columns x rows); give --squares {_size(fitting)}"
        else:
            cure = "check --squares, and that the board is flat"
        found = (
            f"the picture shows {markers} markers of {board.dictionary}, but not in the arrangement of a board of {_size(board)} squares"
        )
        return f"{found}; {cure}"
    if len(_ids(np.ascontiguousarray(picture[:, ::-1]), board.dictionary)) >= 3:
        return "the picture is mirrored: the board is found only in its mirror image"
    for name in OTHER_DICTIONARIES:
        if name != board.dictionary and len(_ids(picture, name)) >= 3:
            return f"the picture shows markers of {name} instead of {board.dictionary}; show only the board, or check --dictionary"
    return "no board was found; it may be too dark, too blurred, too far away, or missing"


def _turned(image: Picture, board: CharucoBoard) -> CharucoBoard | None:
    """Return the board with columns and rows exchanged, in one of its patterns, if the picture shows it."""
    turned = replace(board, squares_xy=(board.squares_xy[1], board.squares_xy[0]))
    return next((one for one in (turned, turned.other_pattern) if one and len(_search(image, one)[0]) >= LEAST_CORNERS), None)


def _ids(picture: NDArray[np.uint8], dictionary: str) -> NDArray[np.int64]:
    """Return the ids (N,) of the detected markers of a dictionary in a picture."""
    ids = cv2.aruco.ArucoDetector(get_dictionary(dictionary)).detectMarkers(picture)[1]
    return np.zeros(0, np.int64) if ids is None else np.ravel(ids).astype(np.int64)
