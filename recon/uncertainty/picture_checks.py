"""The checks of the scan and its pictures: finished, exposed, linear, sharp, with markers and a canister that are where they should be."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from rhizotwin.recon.calibration.canister_pose import CanisterPose
from rhizotwin.recon.calibration.curve import MOST_BEND
from rhizotwin.recon.calibration.exposure import Exposures
from rhizotwin.recon.pictures import CurveFound
from rhizotwin.recon.uncertainty.checks import Check, state_of
from rhizotwin.scenes.dataset import Frame
from rhizotwin.scenes.model import Canister

CLIPPED = 0.002, 0.02
"""Share of the panel's pixels at full scale: where the panel is clipped, what roots keep back of it is not known."""
DIM = 0.2, 0.05
"""Brightness of the panel: at a twentieth of full scale eight bits have 13 steps, and a root of half a pixel three of them."""
WANDER = 0.05, 0.3
"""Exposure that wanders is divided out; by a third it moves the panel out of the camera's range."""
BLUR_PX = 1.2, 2.5
"""Standard deviation, the pixel's own 0.29 included. A root of 0.3 mm is a pixel wide at 800 pixels across 250 mm; blurred by 2.5 px it
darkens the panel by a sixth."""
INSET_PX = 0.03, 0.06
"""The markers' blurred edges stay where they are in light: the twin has 0.002; sRGB taken for light 0.11."""
CORNERS_PX = 0.3, 1.0
"""How far the markers' corners lie from where the cameras put them; OpenCV's own corners reach 0.1 to 0.2 (`docs/calibration.md`)."""
RADIUS_SHARE = 0.002, 0.006
"""Outer radius of the canister over the drawing's, less one, that is left after it was corrected: a lens as strong by so much less."""
EDGE_MM = 0.06, 0.15
"""The canister's edges about a circle (median): a tube half a millimetre out of round (0.25 either way) has 0.1 to 0.18."""
LEFT_OUT = 0.1, 0.34
"""Share of the pictures that could not be used."""
GAP_DEG = 30.0, 75.0
"""Largest step between neighbouring views round the canister: what no view looks along is bounded by the two beside it."""


def of_scan(origin: dict[str, Any], frames: Sequence[Frame]) -> Check:
    """Check that the pictures are those of a finished scan, and pictures at all."""
    twin = (origin.get("settings") or {}).get("twin") or {}
    planned = origin.get("planned_views")
    state, found, advice = "good", f"the scan has all of its {len(frames)} pictures", ""
    if twin.get("fidelity") == "sketch":
        state, found = "bad", "the pictures are the twin's sketches, which show markers and no water"
        advice = "scan with --fidelity render"
    elif origin.get("complete") is False:
        of = f" of {planned}" if planned else ""
        state, found = "bad", f"the scan was stopped after {len(frames)}{of} pictures"
        advice = "finish it with scan --resume"
    elif unchecked := [str(event.get("text")) for event in origin.get("log") or [] if event.get("event") == "unchecked"]:
        state, found = "fair", unchecked[-1]
        advice = "light and focus the strip, so that the markers prove the angles"
    return _check("scan", state, float(len(frames)), "pictures", None, None, found, advice)


def of_exposure(found: Exposures | None) -> Check:
    """Check that the panel is bright, not clipped, and equally exposed."""
    if found is None or not np.isfinite(found.level).any():
        said = "no bare panel is seen beside the canister, so that the pictures' exposure cannot be told"
        return _check("exposure", "untold", None, "", None, None, said, "use a panel wider than the canister, or fix the exposure")
    clipped, level, wander = float(found.clipped.max()), float(np.nanmin(found.level)), found.wander
    if state_of(clipped, *CLIPPED) != "good":
        said = f"{100.0 * clipped:.2g} % of the panel are at full scale in the worst picture"
        return _check(
            "exposure", state_of(clipped, *CLIPPED), clipped, "share", *CLIPPED, said, "expose less: the panel at 0.8 of full scale"
        )
    if state_of(level, *DIM) != "good":
        said = f"the panel reaches only {100.0 * level:.2g} % of full scale"
        return _check("exposure", state_of(level, *DIM), level, "share", *DIM, said, "expose longer: the panel at 0.8 of full scale")
    state = state_of(wander, *WANDER)
    said = f"the exposure wanders by {100.0 * wander:.2g} % from picture to picture, which was divided out"
    return _check("exposure", state, wander, "share", *WANDER, said, "" if state == "good" else "set exposure and gain by hand")


def of_curve(found: CurveFound | None) -> Check:
    """Check that edges have the greys that light makes."""
    if found is None or found.bend is None:
        said = "too few markers were measured to tell whether the pictures' numbers are light"
        return _check("curve", "untold", None, "", None, None, said, "state the camera's transfer in the scene, or calibrate it")
    advice = "state the right transfer in the scene's camera; rhizotwin calibrate transfer measures it"
    bend = abs(found.bend)
    said = f"greys of the markers' edges are off by {100.0 * found.bend:.1f} % of the contrast, read by {found.curve.name}"
    if bend > MOST_BEND:
        return _check("curve", "bad", bend, "share", 0.5 * MOST_BEND, MOST_BEND, said, advice)
    if not found.is_known:
        said = f"the pictures follow no curve that was stated or is known; {found.curve.name} was taken in its place"
        return _check("curve", "bad", bend, "share", 0.5 * MOST_BEND, MOST_BEND, said, advice)
    if not found.curve.same(found.stated):
        said = f"the stated curve, {found.stated.name}, is wrong: the pictures were read by {found.curve.name}, as the markers' edges tell"
        return _check("curve", "fair", bend, "share", 0.5 * MOST_BEND, MOST_BEND, said, advice)
    state = state_of(bend, 0.5 * MOST_BEND, MOST_BEND)
    return _check("curve", state, bend, "share", 0.5 * MOST_BEND, MOST_BEND, said, "" if state == "good" else advice)


def of_sharpness(blur_px: float | None) -> Check:
    """Check that the markers are sharp."""
    if blur_px is None:
        return _check("sharpness", "untold", None, "px", *BLUR_PX, "no markers were measured to tell the blur", "")
    state = state_of(blur_px, *BLUR_PX)
    advice = "" if state == "good" else "focus on the canister's axis, close the lens's opening, or let the table come to rest"
    return _check("sharpness", state, blur_px, "px", *BLUR_PX, f"edges are blurred by {blur_px:.2f} px", advice)


def of_markers(inset_px: float | None, corners_px: float | None) -> Check:
    """Check that the markers are as large as they were printed, and where the cameras put them."""
    if inset_px is None or corners_px is None:
        return _check("markers", "untold", None, "px", *INSET_PX, "the cameras were given: no markers were measured", "")
    if state_of(corners_px, *CORNERS_PX) != "good":
        said = f"the markers' corners lie {corners_px:.2f} px from where the cameras put them"
        advice = "check strip, net pot and lens in the scene; print the strip to scale and put it on without a gap"
        return _check("markers", state_of(corners_px, *CORNERS_PX), corners_px, "px", *CORNERS_PX, said, advice)
    state = state_of(abs(inset_px), *INSET_PX)
    larger = "larger" if inset_px > 0 else "smaller"
    said = f"the markers look {abs(inset_px):.3f} px {larger} on each side than they were printed"
    advice = "" if state == "good" else "state the camera's transfer, switch its sharpening off, and measure the print with a ruler"
    return _check("markers", state, abs(inset_px), "px", *INSET_PX, said, advice)


def of_canister(pose: CanisterPose | None, canister: Canister) -> Check:
    """Check that the canister's edges fit its drawing."""
    if pose is None:
        said = "the canister's edges are not seen before the panel, so that its radius and place are those of the drawing"
        return _check("canister", "untold", None, "mm", *EDGE_MM, said, "use a panel wider than the canister")
    share = abs(pose.radius_excess_mm) / canister.outer_radius_mm
    if (state := state_of(share, *RADIUS_SHARE)) != "good":
        said = f"the canister's edges lie {pose.radius_excess_mm:+.2f} mm from its drawing"
        advice = "measure its outer diameter (and its wall) with callipers and put them into the scene"
        return _check("canister", state, share, "share", *RADIUS_SHARE, said, advice)
    state = state_of(pose.after_mm, *EDGE_MM)
    said = f"the canister's edges lie {pose.after_mm:.3f} mm (median) about a circle"
    return _check(
        "canister", state, pose.after_mm, "mm", *EDGE_MM, said, "" if state == "good" else "the tube is out of round: take another"
    )


def of_views(azimuth_deg: Sequence[float], pictures: int) -> Check:
    """Check that the views are enough and go all the way round.

    Parameters
    ----------
    azimuth_deg : of the cameras about the canister, of the views that are used.
    pictures : all that were taken.
    """
    used, out = len(azimuth_deg), 1.0 - len(azimuth_deg) / max(1, pictures)
    order = np.sort(np.mod(np.asarray(azimuth_deg, np.float64), 360.0))
    gap_deg = float(np.max(np.diff(np.append(order, order[0] + 360.0)))) if used else 360.0
    if (state := state_of(out, *LEFT_OUT)) != "good":
        said = f"{pictures - used} of {pictures} pictures could not be used"
        return _check("views", state, out, "share", *LEFT_OUT, said, "see why each was left out, and take them again")
    state = state_of(gap_deg, *GAP_DEG)
    said = f"{used} views, the largest step between neighbours {gap_deg:.0f} degrees"
    return _check("views", state, gap_deg, "deg", *GAP_DEG, said, "" if state == "good" else "take more views, evenly round the turn")


def _check(name: Any, state: Any, value: float | None, unit: str, fair: float | None, bad: float | None, found: str, advice: str) -> Check:
    return Check(name=name, state=state, value=value, unit=unit, fair=fair, bad=bad, found=found, advice=advice)
