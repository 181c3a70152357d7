"""Preparation of pictures of the rig for display. Marker outlines and measurements of picture quality are added."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.settings import TrustSettings
from rhizotwin.rig.scanning import picture_change, preflight
from rhizotwin.rig.scanning.markers import Sighting
from rhizotwin.scenes.picture_codec import Grey

TRUST = TrustSettings()
"""Limits of the scan quality checks in the reconstruction. Pictures in the console are assessed with the same
limits."""
PICTURE_PX = 800
"""Maximum width of a displayed picture, px. Wider pictures are downsampled."""
JPEG_QUALITY = 85
_MARKER_BGR = (90, 210, 0)

State = Literal["good", "fair", "bad", "unknown"]


@dataclass(frozen=True, kw_only=True)
class Meter:
    """Measured property of a picture with its limits and verdict."""

    name: str
    value: str
    limits: str
    state: State
    """Verdict. It is unknown if the property has no limits."""


@dataclass(frozen=True, kw_only=True)
class Shown:
    """Picture prepared for display in the console."""

    number: int
    """Consecutive number of the picture."""
    title: str
    jpeg: bytes
    meters: tuple[Meter, ...]


def show(
    image: Grey,
    sighting: Sighting | None,
    *,
    number: int,
    title: str,
    panel: tuple[float, float] | None = None,
    motion: float | None = None,
) -> Shown:
    """Prepare a picture for display in the console.

    Parameters
    ----------
    image : (H, W) uint8 or uint16 array
        Picture with linear values.
    sighting : Sighting or None
        Markers detected in the picture; None if they could not be read.
    number, title : int, str
        Consecutive number and title of the picture.
    panel : tuple of float or None
        5th and 95th percentile of the panel's brightness, as fractions of full scale; None if unknown.
    motion : float or None
        Fraction of the picture that still moved after the turntable stopped; None if it was not measured.
    """
    return Shown(
        number=number, title=title, jpeg=jpeg(image, sighting=sighting), meters=meters(image, sighting, panel=panel, motion=motion)
    )


def meters(image: Grey, sighting: Sighting | None, *, panel: tuple[float, float] | None, motion: float | None) -> tuple[Meter, ...]:
    """Measure markers, focus, exposure, panel brightness and motion in a picture.

    Parameters
    ----------
    image, sighting : (H, W) uint8 or uint16 array, Sighting or None
        Picture with linear values, and its detected markers.
    panel, motion : tuple of float or None, float or None
        Brightness of the panel and fraction of moving pixels, see `show`.

    Returns
    -------
    tuple of Meter
        Available measurements with limits and verdicts.
    """
    found = (_markers(sighting), _focus(sighting), _exposure(image), _panel(panel), _motion(motion))
    return tuple(meter for meter in found if meter is not None)


def jpeg(image: Grey, *, sighting: Sighting | None = None, widest_px: int = PICTURE_PX) -> bytes:
    """Encode a linear picture as JPEG with display gamma and the outlines of detected markers.

    Pictures that are wider than ``widest_px`` are downsampled.
    """
    height, width = image.shape
    scale = min(1.0, widest_px / width)
    if scale < 1.0:
        image = cv2.resize(image, (widest_px, max(1, round(height * scale))), interpolation=cv2.INTER_AREA)
    light = image.astype(np.float32) / np.iinfo(image.dtype).max
    shown: NDArray[np.uint8] = np.round(255.0 * light ** (1.0 / 2.2)).astype(np.uint8)
    colour = cv2.cvtColor(shown, cv2.COLOR_GRAY2BGR)
    if sighting is not None:
        corners = (sighting.corners_px + 0.5) * scale - 0.5
        cv2.polylines(colour, list(np.round(corners * 16).astype(np.int32)), True, _MARKER_BGR, 1, cv2.LINE_AA, 4)
    _, data = cv2.imencode(".jpg", colour, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return data.tobytes()


def _markers(sighting: Sighting | None) -> Meter:
    if sighting is None:
        return Meter(name="Markers", value="not detected", limits="the turntable angle is not confirmed by the markers", state="fair")
    value = f"{sighting.markers} detected, RMS residual {sighting.reprojection_px:.2f} px"
    return Meter(name="Markers", value=value, limits="residual of the marker corners; it has no limits", state="unknown")


def _focus(sighting: Sighting | None) -> Meter | None:
    if sighting is None or sighting.blur_px is None:
        return None
    good, bad = TRUST.blur_px
    state = _state(-sighting.blur_px, -good, -bad)
    return Meter(name="Focus", value=f"blur {sighting.blur_px:.2f} px", limits=f"good up to {good:g} px, bad above {bad:g} px", state=state)


def _exposure(image: Grey) -> Meter:
    light = preflight.measure_exposure(image)
    least, most = 100.0 * preflight.DIMMEST, 100.0 * preflight.MOST_SATURATED
    good = light.bright >= preflight.DIMMEST and light.saturated <= preflight.MOST_SATURATED
    value = f"{100.0 * light.bright:.0f} % of full scale, {100.0 * light.saturated:.1f} % saturated"
    limits = f"at least {least:.0f} % of full scale, and at most {most:.0f} % saturated"
    return Meter(name="Exposure", value=value, limits=limits, state="good" if good else "bad")


def _panel(panel: tuple[float, float] | None) -> Meter | None:
    if panel is None or panel[1] <= 0.0:
        return None
    good, bad = TRUST.dim
    value = f"{100.0 * panel[0]:.0f} to {100.0 * panel[1]:.0f} % of full scale"
    limits = f"darkest part: good from {100.0 * good:.0f} %, bad below {100.0 * bad:.0f} %"
    return Meter(name="Panel", value=value, limits=limits, state=_state(panel[0], good, bad))


def _motion(motion: float | None) -> Meter | None:
    if motion is None:
        return None
    still = motion < picture_change.LEAST_SHARE
    value = "no motion" if still else f"{100.0 * motion:.1f} % of the picture still moves"
    limits = f"less than {100.0 * picture_change.LEAST_SHARE:g} %; otherwise increase settle_s in the rig file"
    return Meter(name="Motion", value=value, limits=limits, state="good" if still else "fair")


def _state(value: float, good: float, bad: float) -> State:
    """Return the verdict on a value that is better if it is larger. ``good`` and ``bad`` are the thresholds."""
    return "good" if value >= good else "fair" if value >= bad else "bad"
