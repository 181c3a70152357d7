"""Whether the pictures' numbers are light, as the marker strip's edges tell.

A lens blurs light, and evenly: half-way through an edge between black and white is half-way between black and white. A
camera's curve does so to numbers: where it was not undone, or undone when there was none, the greys of an edge are too
bright or too dark. `MarkerFit.bend` measures that on all edges of all markers, whatever the blur is.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from rhizotwin.recon.calibration.markers import Markers, detect_markers
from rhizotwin.recon.pictures import CurveFound, Pictures, stated_curve
from rhizotwin.scenes import transfer
from rhizotwin.scenes.dataset import read_image
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.pictures import Grey
from rhizotwin.scenes.transfer import Curve

MOST_BEND = 0.02
"""A larger bend is no accident: sRGB taken for light has 0.18, light taken for sRGB -0.25, the twin's right pictures
0.000 to 0.003.

A gamma that is off by 0.1 has 0.02, and moves the outlines of roots (at half coverage) by less than 0.03 px."""
LEAST_MARKERS = 10
"""The median of ten is uncertain by 0.4 of their scatter."""
_SOME = 8
"""Pictures that are asked, evenly over the scan."""
_EXPONENTS = (1.0 / 3.0, 0.45, 1.0 / 1.8, 0.75, 1.0, 1.4, 1.8, 2.2, 3.0)
"""Gammas that are tried where no known curve will do, upon the stated one."""


def read_by_edges(pictures: Pictures, *, monitor: Monitor) -> Pictures:
    """Ask the markers' edges whether the pictures were read by the right curve.

    Where they clearly were not, they are read anew.

    Silhouettes, and pictures with given cameras or of a rig without a strip, are left as they are: they show no
    markers.
    """
    dataset, captured = pictures.dataset, pictures.frames
    if dataset.masks or dataset.scene.strip.rows == 0 or all(frame.cam_from_canister is not None for frame in captured):
        return pictures
    some = sorted({round(k) for k in np.linspace(0, len(captured) - 1, _SOME)})

    def markers_of(image: Grey) -> Markers:
        return detect_markers(image, dataset.scene.strip)

    def again(curve: Curve) -> list[Markers]:
        return monitor.each(lambda k: markers_of(read_image(dataset, captured[k], curve=curve)), "curve", some)

    with monitor.stage("curve"):
        detected = monitor.each(markers_of, "curve", [pictures.images[k] for k in some])
        found = find(detected, stated_curve(dataset, captured), again)
        if found.warning is None:
            return replace(pictures, curve=found, measured=dict(zip(some, detected, strict=True)))
        images = monitor.each(lambda frame: read_image(dataset, frame, curve=found.curve), "read", captured)
    return replace(pictures, images=tuple(images), curve=found, warnings=(*pictures.warnings, found.warning))


def bend_of(detected: Sequence[Markers]) -> tuple[float | None, int]:
    """Return the median bend of all measured markers, and their number."""
    bends = np.concatenate([np.zeros(0), *(markers.bend for markers in detected if markers.bend is not None)])
    return (float(np.median(bends)) if len(bends) >= LEAST_MARKERS else None), len(bends)


def find(detected: Sequence[Markers], stated: Curve, again: Callable[[Curve], Sequence[Markers]]) -> CurveFound:
    """Find the curve that the markers' edges bear out.

    Parameters
    ----------
    detected : sequence of Markers
        Markers of the pictures, read by the stated curve.
    stated : Curve
        The files' own word, or the scene's.
    again : callable
        Reads some of the pictures by another curve, and returns their markers.
    """
    bend, count = bend_of(detected)
    if bend is None or abs(bend) <= MOST_BEND:
        return CurveFound(curve=stated, stated=stated, bend=bend, stated_bend=bend, markers=count)
    best, least = stated, bend
    for known in (transfer.LINEAR, transfer.SRGB):
        if not known.same(stated):
            other, _ = bend_of(again(known))
            if other is not None and abs(other) < abs(least):
                best, least = known, other
    if abs(least) > MOST_BEND:
        best, least = _gamma(stated, least, best, again)
    return CurveFound(curve=best, stated=stated, bend=least, stated_bend=bend, markers=count)


def _gamma(stated: Curve, least: float, best: Curve, again: Callable[[Curve], Sequence[Markers]]) -> tuple[Curve, float]:
    """Return the gamma upon the stated curve without a bend, or what was best before."""
    tried = [(exponent, bend) for exponent in _EXPONENTS if (bend := bend_of(again(_upon(stated, exponent)))[0]) is not None]
    exponents, bends = np.array(tried).reshape(-1, 2).T
    signs = np.flatnonzero(np.diff(np.sign(bends)))
    if not len(signs):
        return best, least
    k = int(signs[0])
    share = bends[k] / (bends[k] - bends[k + 1])
    curve = _upon(stated, float(exponents[k] * (exponents[k + 1] / exponents[k]) ** share))
    bend, _ = bend_of(again(curve))
    return (curve, bend) if bend is not None and abs(bend) < abs(least) else (best, least)


def _upon(stated: Curve, exponent: float) -> Curve:
    """Return a gamma after the stated curve."""
    light = stated.of(np.linspace(0.0, 1.0, 4097)) ** exponent
    return Curve(f"a gamma of {exponent:.2f} upon {stated.name}", tuple(light.tolist()))
