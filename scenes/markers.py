"""ArUco markers: the ids of each canister's strip, and markers as arrays of cells and as black rectangles."""

from functools import cache
from math import isqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import MarkerStrip

LARGE_DICTIONARY = "APRILTAG_36h10"
"""Dictionary of the strips of canisters for which the dictionary of a scene is too small. It is the largest of OpenCV,
with 2320 markers that differ by 10 or more cells. From those of APRILTAG_36h11 they differ by 4 or more. No flawless
marker is read as one of the other dictionary, because OpenCV corrects at most 3 wrong cells."""
MOST_COMMON = 2
"""Maximum number of markers that the strips of two canisters have in common. Any four markers of a strip thus include
two or more that are not on a given other strip."""


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


@cache
def strip_count(dictionary: str, first_id: int, markers: int) -> int:
    """Return the number of canisters that strips from a dictionary distinguish.

    The ids of a strip are described in `marker_ids`.

    Parameters
    ----------
    dictionary : str
        Name of the dictionary in OpenCV.
    first_id : int
        `MarkerStrip.first_id` of any of the strips.
    markers : int
        Number of markers on each strip.
    """
    if first_id < 0 or markers < 1:
        return 0
    symbols = (len(get_dictionary(dictionary).bytesList) - first_id % markers) // markers
    prime = _largest_prime(symbols)
    return max(symbols, prime**2) if markers <= MOST_COMMON * prime else symbols


@cache
def marker_ids(dictionary: str, first_id: int, markers: int) -> NDArray[np.int64]:
    """Return the ids (markers,) of the markers on a strip, row by row.

    With M markers on each strip, ``first_id = n M + r``, where n counts the canisters from 0 and r is the same for all
    strips of an experiment. Position p of a strip has the id ``r + s M + p``, so that the id gives the position, and
    the symbol s. If all ids from ``first_id`` to ``first_id + M - 1`` exist, s = n: the ids are successive, and
    different from those of all other strips.

    The other strips are words of a Reed-Solomon code of dimension 2 [1]_: s = (a + b p) mod q, where n = a + b q, and q
    is the largest prime number of symbols in the dictionary. Strips with equal b have no marker in common. If b
    differs, their symbols agree only where (b - b') p = a' - a (mod q), that is at one p mod q, or at most M / q
    positions, rounded up. For 62 markers of APRILTAG_36h10, q = 37, and 37^2 = 1369 canisters have at most two of 62
    markers in common. Four markers in view therefore belong to one canister only, and it takes two misread markers,
    with exactly the ids of another strip, to suggest this strip.

    Parameters
    ----------
    dictionary : str
        Name of the dictionary in OpenCV.
    first_id : int
        `MarkerStrip.first_id`.
    markers : int
        Number of markers on the strip.

    Returns
    -------
    (markers,) int array
        Ids. The array is shared and cannot be changed.

    Raises
    ------
    UserError
        If the dictionary is unknown, or too small for this strip.

    References
    ----------
    .. [1] Reed, I. S., and Solomon, G. (1960). Polynomial codes over certain finite fields. Journal of the Society for
       Industrial and Applied Mathematics, 8(2), 300-304. https://doi.org/10.1137/0108018
    """
    size, count = len(get_dictionary(dictionary).bytesList), strip_count(dictionary, first_id, markers)
    number, rest = divmod(first_id, max(markers, 1))
    if not 0 <= number < count:
        raise UserError(
            f"the marker dictionary {dictionary} has {size} markers, enough for {count} strips of {markers} markers, but not for the strip "
            f"with first_id = {first_id}; use a smaller first_id, fewer columns or a larger dictionary, such as {LARGE_DICTIONARY}"
        )
    place = np.arange(markers)
    if first_id + markers > size:
        prime = _largest_prime((size - rest) // markers)
        ids = rest + (number + number // prime * place) % prime * markers + place
    else:
        ids = first_id + place
    ids.setflags(write=False)
    return ids


def strip_ids(strip: MarkerStrip) -> NDArray[np.int64]:
    """Return the ids (rows, columns) of the markers on a strip, as described in `marker_ids`."""
    markers = strip.rows * strip.columns
    ids = marker_ids(strip.dictionary, strip.first_id, markers) if markers else np.zeros(0, np.int64)
    return ids.reshape(strip.rows, strip.columns)


def ids_text(dictionary: str, first_id: int, markers: int) -> str:
    """Return text such as ``62 to 123``, or ``0, 63, 126, ... (first_id 2294)`` for a coded strip.

    Parameters
    ----------
    dictionary, first_id, markers : str, int, int
        As for `marker_ids`.
    """
    ids = marker_ids(dictionary, first_id, markers)
    if ids[0] == first_id:
        return f"{first_id} to {ids[-1]}"
    return f"{', '.join(map(str, ids[:3]))}, ... (first_id {first_id})"


def _largest_prime(limit: int) -> int:
    """Return the largest prime number up to a limit; 0 if there is none."""
    return next((n for n in range(limit, 1, -1) if all(n % k for k in range(2, isqrt(n) + 1))), 0)


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
