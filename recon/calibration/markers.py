"""Detection of the strip's markers in a picture.

OpenCV identifies the markers, and `recon.calibration.marker_fit` measures their corners.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.marker_fit import FIRST_BLUR_PX, MarkerFit, Scratch, fit_marker
from rhizotwin.scenes.formatting import was
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.markers import get_dictionary, ids_text, marker_cells, strip_ids
from rhizotwin.scenes.model import MarkerStrip
from rhizotwin.scenes.picture_reduction import Picture, reduce_picture

Bytes = NDArray[np.uint8]
_ALIKE = 0.7, 1.4
"""Minimum and maximum height of a foreign marker that is reported, relative to the median height of the strip's markers
in the picture. The id of a foreign marker is not on the strip. The nearest marker of a strip is 1 + R / d times as high
as the markers at its left and right edges, where d is the distance of the camera from the axis, and R is the radius of
the net pot. This ratio is 1.2 for the thesis's rig, and 1.4 for d = 2.5 R."""
_WINDOWS_PX = 7, 37, 10
"""Three parameters of OpenCV's adaptive threshold, px: the smallest window, the largest window, and the increment of
the window. They were tuned on pictures of the strip."""
_BRIGHTEST = 99.5
"""Brightness percentile that is mapped to white before markers are detected. Brighter pixels are clipped, so that the
reflection of a lamp does not reduce the contrast of the strip."""
FEW = 6
"""Number of detected markers below which the detection is repeated with the next tone curve."""
OTHER_DICTIONARIES = (
    "4X4_50", "4X4_250", "5X5_50", "5X5_250", "6X6_50", "6X6_250", "7X7_50",
    "APRILTAG_16h5", "APRILTAG_25h9", "APRILTAG_36h11", "APRILTAG_36h10",
)  # fmt: skip
"""Marker dictionaries that are searched if no marker of the strip's dictionary is found."""


@dataclass(frozen=True, kw_only=True)
class Markers:
    """Markers of the strip in one picture."""

    ids: NDArray[np.int64]
    """(M,) ids of the markers, in ascending order."""
    corners_px: Array
    """(M, 4, 2) corners, px, with pixel centres at integer coordinates. The order is top left, top right, bottom right,
    bottom left of the upright strip viewed from outside."""
    covariance_px2: Array | None = None
    """(M, 8, 8) covariance of the x and y coordinates of each marker's corners, px^2. None if the corners were not
    measured, in which case their errors are assumed to be independent with a standard deviation of 0.1 px."""
    bend: Array | None = None
    """(M,) bend of each marker, which is the excess brightness of mid-greys at its edges (`MarkerFit.bend`). It is None
    if the corners were not measured."""
    blur_px: Array | None = None
    """(M,) standard deviation of the blur at each marker, px, including the pixel itself; None if the corners were not
    measured."""
    foreign: tuple[int, ...] = ()
    """Ids in this picture that belong to the strip's dictionary but are not on the strip. Only markers about as high as
    those of the strip are included."""
    diagnosis: str | None = None
    """Reason why no markers were found; None if markers were found."""


def detect_markers(image: Picture, strip: MarkerStrip, *, measure: bool = True, lamps_off: Sequence[str] = ()) -> Markers:
    """Detect a strip's markers in a picture and measure their corners.

    Parameters
    ----------
    image : (H, W) uint8 or uint16 array
        Grey levels, linear in light, left-aligned in 8 or 16 bits. In linear light, blur does not displace edges.
    strip : MarkerStrip
        Strip whose markers are detected; markers with other ids are only reported as foreign.
    measure : bool
        Whether to measure the corners by a fit of the marker pattern. If False, OpenCV's corners are returned, which
        are refined with SUBPIX as in the thesis. OpenCV's corners are about ten times less accurate.
    lamps_off : sequence of str
        Lamps that were off, see `scenes.dataset.Dataset.lamps_off`. They are named if no markers are found.

    Returns
    -------
    Markers
        Ids, corners and covariance of the markers, and a diagnosis if no markers are found.

    Raises
    ------
    UserError
        If OpenCV does not know the strip's dictionary, or it is too small for the strip.
    """
    dictionary = get_dictionary(strip.dictionary)
    ids, corners_px, foreign = _search(image, dictionary, strip, subpix=not measure)
    if len(ids) and not measure:
        return Markers(ids=ids, corners_px=corners_px, foreign=tuple(foreign))
    found: dict[int, MarkerFit] = {}
    blur_px, scratch = FIRST_BLUR_PX, Scratch()
    for marker_id, start_px in zip(ids, corners_px, strict=True):
        white = marker_cells(strip.dictionary, int(marker_id))
        fit = fit_marker(image, white, start_px, blur_px=blur_px, scratch=scratch)
        if fit is not None:
            blur_px, found[int(marker_id)] = fit.blur_px, fit
    if not found:
        return Markers(
            ids=np.zeros(0, np.int64),
            corners_px=np.zeros((0, 4, 2)),
            foreign=tuple(foreign),
            diagnosis=_diagnose(image, strip, blurred=len(ids), foreign=foreign, lamps_off=lamps_off),
        )
    return Markers(
        ids=np.array(list(found)),
        corners_px=np.stack([fit.corners_px for fit in found.values()]),
        covariance_px2=np.stack([fit.covariance_px2 for fit in found.values()]),
        bend=np.array([fit.bend for fit in found.values()]),
        blur_px=np.array([fit.blur_px for fit in found.values()]),
        foreign=tuple(foreign),
    )


def _search(
    image: Picture, dictionary: cv2.aruco.Dictionary, strip: MarkerStrip, *, subpix: bool
) -> tuple[NDArray[np.int64], Array, list[int]]:
    """Find the strip's markers in a picture, and foreign markers of similar size.

    Return the ids (M,) and approximate corners (M, 4, 2) of the strip's markers, and the ids of the foreign markers.
    The corners are in pixels of the full-resolution picture.
    """
    small, scale = reduce_picture(image)
    detector = _detector(dictionary, subpix=subpix)
    own: dict[int, Array] = {}
    foreign: dict[int, Array] = {}
    on_strip = set(strip_ids(strip).ravel().tolist())
    for tone in (_linear, _square_root, _equalise):
        corners, ids, _ = detector.detectMarkers(tone(small))
        for marker_id, four in zip([] if ids is None else np.ravel(ids).tolist(), corners, strict=True):
            group = own if marker_id in on_strip else foreign
            group.setdefault(marker_id, (np.asarray(four, np.float64).reshape(4, 2) + 0.5) * scale - 0.5)
        if len(own) >= FEW:
            break
    chosen = sorted(own)
    usual_px = np.median([_height_px(four) for four in own.values()]) if own else None
    alike = [k for k in sorted(foreign) if usual_px is None or _ALIKE[0] < _height_px(foreign[k]) / usual_px < _ALIKE[1]]
    return np.array(chosen, np.int64), np.array([own[k] for k in chosen]).reshape(-1, 4, 2), alike


def _height_px(four: Array) -> float:
    """Return the mean length of a marker's left and right sides, px.

    The curvature of the strip does not affect these sides.
    """
    return float(np.linalg.norm(four[[0, 1]] - four[[3, 2]], axis=1).mean())


def _detector(dictionary: cv2.aruco.Dictionary, *, subpix: bool = False) -> cv2.aruco.ArucoDetector:
    """Return an OpenCV detector whose parameters suit small, blurred and foreshortened markers.

    In pictures of the strip, it finds 18 to 20 of 26 markers.
    """
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeMax, parameters.adaptiveThreshWinSizeStep = _WINDOWS_PX
    parameters.perspectiveRemovePixelPerCell = 8
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX if subpix else cv2.aruco.CORNER_REFINE_NONE
    return cv2.aruco.ArucoDetector(dictionary, parameters)


def _linear(image: Picture) -> Bytes:
    """Scale the brightness of a picture to 8 bits, and clip the brightest 0.5 % of the pixels."""
    return np.asarray(cv2.convertScaleAbs(image, alpha=255.0 / max(_percentile(image, _BRIGHTEST), 1.0)), np.uint8)


def _square_root(image: Picture) -> Bytes:
    """Scale the square root of a picture's brightness to 8 bits.

    This brightens a strip that is much darker than the backlight.
    """
    low, top = _percentile(image, 0.5), _percentile(image, _BRIGHTEST)
    return (255.0 * np.sqrt(np.clip((image.astype(np.float32) - low) / max(top - low, 1.0), 0.0, 1.0))).astype(np.uint8)


def _percentile(image: Picture, percent: float) -> float:
    """Return a percentile of a picture's brightness, estimated from every third pixel of every third row."""
    return float(np.percentile(image[::3, ::3].astype(np.float32), percent))


def _equalise(image: Picture) -> Bytes:
    """Return the square-root picture with equalised local contrast (CLAHE)."""
    return np.asarray(cv2.createCLAHE(clipLimit=4.0, tileGridSize=(8, 8)).apply(_square_root(image)), np.uint8)


def _diagnose(image: Picture, strip: MarkerStrip, *, blurred: int, foreign: list[int], lamps_off: Sequence[str]) -> str:
    """Return the reason why no markers were found in a picture."""
    if blurred:
        return f"{blurred} markers were identified, but they are too blurred or noisy to be measured"
    names = ", ".join(str(k) for k in foreign[:5])
    others = (
        f"the picture shows markers of another strip: their {strip.dictionary} ids are {names}, but those of the scene's strip are "
        f"{ids_text(strip.dictionary, strip.first_id, strip.rows * strip.columns)}"
    )
    if len(foreign) >= 3:
        return others
    picture = _linear(image)
    mirrored = _detector(get_dictionary(strip.dictionary)).detectMarkers(np.ascontiguousarray(picture[:, ::-1]))[1]
    if mirrored is not None and len(mirrored) >= 3:
        return "the picture is mirrored: its markers can only be read in its mirror image"
    for name in OTHER_DICTIONARIES:
        if name != strip.dictionary:
            ids = _detector(get_dictionary(name)).detectMarkers(picture)[1]
            if ids is not None and len(ids) >= 3:
                return (
                    f"the picture shows markers of another strip: their dictionary is {name}, but the scene's strip has {strip.dictionary}"
                )
    if foreign:  # one or two may be coincidental in small dictionaries
        return others
    off = f"; according to the record of the scan, the {' and the '.join(lamps_off)} {was(len(lamps_off))} off" if lamps_off else ""
    return f"no markers were found{off}"
