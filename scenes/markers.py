"""ArUco markers as arrays of cells, and as black rectangles for printing and rendering."""

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.frames import Array


def get_dictionary(name: str) -> cv2.aruco.Dictionary:
    """Return an ArUco dictionary of OpenCV. The name is given without ``DICT_``.

    Raises
    ------
    UserError
        If OpenCV has no dictionary with this name.
    """
    if not hasattr(cv2.aruco, f"DICT_{name}"):
        raise UserError(f"{name!r} is not an ArUco dictionary of OpenCV; use, for example, APRILTAG_36h11 or 5X5_100")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))


def marker_cells(dictionary: str, marker_id: int) -> NDArray[np.bool_]:
    """Return the cells (n, n) of a marker including its black border. White cells are True, and row 0 is at the top.

    Raises
    ------
    UserError
        If the dictionary is unknown, or has no marker with this number.
    """
    known = get_dictionary(dictionary)
    if not 0 <= marker_id < len(known.bytesList):
        raise UserError(f"marker {marker_id} does not exist, because {dictionary} has only the markers 0 to {len(known.bytesList) - 1}")
    return np.asarray(known.generateImageMarker(marker_id, known.markerSize + 2)) > 127


def black_rectangles(dictionary: str, marker_id: int, *, left_mm: float, top_mm: float, side_mm: float) -> Array:
    """Return the black parts of an upright marker as rectangles (N, 4).

    The columns are the left, top, right and bottom edge, with y downwards.

    Parameters
    ----------
    dictionary, marker_id : str, int
        Name of the dictionary in OpenCV, and number of the marker.
    left_mm, top_mm : float
        Position of the upper left corner.
    side_mm : float
        Side length of the marker.

    Returns
    -------
    (N, 4) array
        Rectangles in mm.
    """
    cells = marker_cells(dictionary, marker_id)
    cell_mm = side_mm / len(cells)
    found = []
    for row, white in enumerate(cells):
        steps = np.diff(np.concatenate([[0], (~white).astype(int), [0]]))
        found += [(first, row, last, row + 1) for first, last in zip(np.flatnonzero(steps > 0), np.flatnonzero(steps < 0), strict=True)]
    return np.array(found, np.float64) * cell_mm + np.array([left_mm, top_mm, left_mm, top_mm])
