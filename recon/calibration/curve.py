"""Verification that the pictures are linear in light, by the edges of the markers.

A lens blurs light symmetrically, so the middle of an edge between black and white has a brightness halfway between
black and white. The greys of an edge are too bright or too dark if the camera's transfer curve was not inverted, or if
a curve was inverted although the picture was already linear. `MarkerFit.bend` measures this deviation on all edges of
all markers, independently of the blur.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from rhizotwin.recon.calibration.markers import Markers, detect_markers
from rhizotwin.recon.read_pictures import CurveFound, Pictures, stated_curve
from rhizotwin.scenes import transfer
from rhizotwin.scenes.dataset import read_image
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.picture_codec import Grey
from rhizotwin.scenes.transfer import Curve

MOST_BEND = 0.02
"""Maximum bend (excess brightness of medium greys at marker edges) of pictures that are accepted as linear. The bend is
0.18 for sRGB values read as linear light, -0.25 for linear light read as sRGB, and 0.000 to 0.003 for correct pictures
of the twin.

An error of 0.1 in the gamma causes a bend of 0.02, and moves the outlines of roots (at half coverage) by less than 0.03
px."""
LEAST_MARKERS = 10
"""Minimum number of markers from which the median bend is computed. The median of ten markers has a standard error of
0.4 times their standard deviation."""
_SOME = 8
"""Number of pictures that are tested, evenly spaced over the scan."""
_EXPONENTS = (1.0 / 3.0, 0.45, 1.0 / 1.8, 0.75, 1.0, 1.4, 1.8, 2.2, 3.0)
"""Exponents of the power functions that are tried, after the stated transfer curve, if no known curve fits."""


def verify_curve(pictures: Pictures, *, monitor: Monitor) -> Pictures:
    """Verify, by the edges of the markers, that the pictures were decoded with the correct transfer curve.

    If the edges clearly contradict the curve, the pictures are read again with the estimated curve.

    Masks, pictures with given cameras, and pictures of a rig without a strip are returned unchanged, because they show
    no markers.
    """
    dataset, captured = pictures.dataset, pictures.frames
    if dataset.masks or dataset.scene.strip.rows == 0 or all(frame.cam_from_canister is not None for frame in captured):
        return pictures
    some = sorted({round(k) for k in np.linspace(0, len(captured) - 1, _SOME)})

    def detect(image: Grey) -> Markers:
        return detect_markers(image, dataset.scene.strip, lamps_off=dataset.lamps_off)

    def again(curve: Curve) -> list[Markers]:
        return monitor.each(lambda k: detect(read_image(dataset, captured[k], curve=curve)), "curve", some)

    with monitor.stage("curve"):
        detected = monitor.each(detect, "curve", [pictures.images[k] for k in some])
        found = find(detected, stated_curve(dataset, captured), again)
        if found.warning is None:
            return replace(pictures, curve=found, measured=dict(zip(some, detected, strict=True)))
        images = monitor.each(lambda frame: read_image(dataset, frame, curve=found.curve), "read", captured)
    return replace(pictures, images=tuple(images), curve=found, warnings=(*pictures.warnings, found.warning))


def median_bend(detected: Sequence[Markers]) -> tuple[float | None, int]:
    """Return the median bend of all measured markers, and the number of markers.

    The median is None if there are fewer than `LEAST_MARKERS` markers.
    """
    bends = np.concatenate([np.zeros(0), *(markers.bend for markers in detected if markers.bend is not None)])
    return (float(np.median(bends)) if len(bends) >= LEAST_MARKERS else None), len(bends)


def find(detected: Sequence[Markers], stated: Curve, again: Callable[[Curve], Sequence[Markers]]) -> CurveFound:
    """Estimate the transfer curve of the pictures from the edges of the markers.

    Parameters
    ----------
    detected : sequence of Markers
        Markers of the pictures, decoded with the stated curve.
    stated : Curve
        Transfer curve stated in the files or in the scene.
    again : callable
        Function that reads some of the pictures with another curve and returns their markers.
    """
    bend, count = median_bend(detected)
    if bend is None or abs(bend) <= MOST_BEND:
        return CurveFound(curve=stated, stated=stated, bend=bend, stated_bend=bend, markers=count)
    best, least = stated, bend
    for known in (transfer.LINEAR, transfer.SRGB):
        if not known.same(stated):
            other, _ = median_bend(again(known))
            if other is not None and abs(other) < abs(least):
                best, least = known, other
    if abs(least) > MOST_BEND:
        best, least = _find_gamma(stated, least, best, again)
    return CurveFound(curve=best, stated=stated, bend=least, stated_bend=bend, markers=count)


def _find_gamma(stated: Curve, least: float, best: Curve, again: Callable[[Curve], Sequence[Markers]]) -> tuple[Curve, float]:
    """Find the gamma that removes the bend if it is applied after the stated transfer curve.

    Return the resulting curve and its bend. If the curve ``best`` has a smaller bend, ``best`` and its bend ``least``
    are returned.
    """
    tried = [(exponent, bend) for exponent in _EXPONENTS if (bend := median_bend(again(_append_gamma(stated, exponent)))[0]) is not None]
    exponents, bends = np.array(tried).reshape(-1, 2).T
    signs = np.flatnonzero(np.diff(np.sign(bends)))
    if not len(signs):
        return best, least
    k = int(signs[0])
    share = bends[k] / (bends[k] - bends[k + 1])
    curve = _append_gamma(stated, float(exponents[k] * (exponents[k + 1] / exponents[k]) ** share))
    bend, _ = median_bend(again(curve))
    return (curve, bend) if bend is not None and abs(bend) < abs(least) else (best, least)


def _append_gamma(stated: Curve, exponent: float) -> Curve:
    """Return the stated curve followed by a power function with the given exponent."""
    light = stated.of(np.linspace(0.0, 1.0, 4097)) ** exponent
    return Curve(f"a gamma of {exponent:.2f} after {stated.name}", tuple(light.tolist()))
