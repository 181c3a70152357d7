"""The checks of the scan and its pictures.

Finished, exposed, linear, sharp, with markers and a canister that are where they should be.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.canister_pose import CanisterPose
from rhizotwin.recon.calibration.curve import MOST_BEND
from rhizotwin.recon.calibration.exposure import Exposures
from rhizotwin.recon.pictures import CurveFound
from rhizotwin.recon.settings import TrustSettings
from rhizotwin.recon.uncertainty.checks import Check, State, foremost, judged, stated, untold
from rhizotwin.scenes.dataset import Frame
from rhizotwin.scenes.model import Scene


def of_scan(origin: dict[str, Any], frames: Sequence[Frame]) -> Check:
    """Check that the pictures are those of a finished scan, and pictures at all."""
    twin = (origin.get("settings") or {}).get("twin") or {}
    planned = origin.get("planned_views")
    state: State = "good"
    found, advice = f"the scan has all of its {len(frames)} pictures", ""
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
    return stated("scan", state, float(len(frames)), "pictures", None, found, advice)


def of_exposure(found: Exposures | None, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that the panel is bright, not clipped, and equally exposed."""
    if found is None or not np.isfinite(found.level).any():
        said = "no bare panel is seen beside the canister, so that the pictures' exposure cannot be told"
        return untold("exposure", said, "use a panel wider than the canister, or fix the exposure")
    clipped, level, wander = float(found.clipped.max()), float(np.nanmin(found.level)), found.wander
    full = f"{100.0 * clipped:.3g} % of the panel are at full scale in the worst picture"
    dim = f"the panel reaches only {100.0 * level:.2g} % of full scale"
    said = f"the exposure wanders by {100.0 * wander:.2g} % from picture to picture, which was divided out"
    uneven, bands = float(found.uneven.max(initial=0.0)), found.bands
    patchy = f"the panel's brightness wanders by {100.0 * uneven:.2g} % from place to place and picture to picture"
    evened = f"the panel's brightness wanders by {100.0 * bands:.2g} % within a picture, which was divided out row by row"
    lamp = "use a lamp on direct current, and keep shadows off the panel"
    return foremost(
        judged("exposure", clipped, "share", trust.clipped, full, "expose less: the panel at 0.8 of full scale"),
        judged("exposure", level, "share", trust.dim, dim, "expose longer: the panel at 0.8 of full scale"),
        judged("exposure", uneven, "share", trust.uneven, patchy, lamp),
        judged("exposure", bands, "share", trust.wander, evened, lamp),
        judged("exposure", wander, "share", trust.wander, said, "set exposure and gain by hand"),
    )


def of_curve(found: CurveFound | None) -> Check:
    """Check that edges have the greys that light makes."""
    if found is None or found.bend is None:
        said = "too few markers were measured to tell whether the pictures' numbers are light"
        return untold("curve", said, "state the camera's transfer in the scene, or calibrate it")
    advice = "state the right transfer in the scene's camera; rhizotwin calibrate transfer measures it"
    bend, limits = abs(found.bend), (0.5 * MOST_BEND, MOST_BEND)
    said = f"greys of the markers' edges are off by {100.0 * found.bend:.1f} % of the contrast, read by {found.curve.name}"
    if bend > MOST_BEND:
        return judged("curve", bend, "share", limits, said, advice)
    if not found.is_known:
        said = f"the pictures follow no curve that was stated or is known; {found.curve.name} was taken in its place"
        return stated("curve", "bad", bend, "share", limits, said, advice)
    if not found.curve.same(found.stated):
        said = f"the stated curve, {found.stated.name}, is wrong: the pictures were read by {found.curve.name}, as the markers' edges tell"
        return stated("curve", "fair", bend, "share", limits, said, advice)
    return judged("curve", bend, "share", limits, said, advice)


def of_sharpness(blur_px: float | None, refocus_px: float | None = None, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that the markers are sharp, and alike in all pictures."""
    if blur_px is None:
        return untold("sharpness", "no markers were measured to tell the blur", unit="px", limits=trust.blur_px)
    advice = "focus on the canister's axis, close the lens's opening, or let the table come to rest"
    sharp = judged("sharpness", blur_px, "px", trust.blur_px, f"edges are blurred by {blur_px:.2f} px", advice)
    if refocus_px is None:
        return sharp
    said = f"some pictures are blurred by {refocus_px:.2f} px more than others"
    return foremost(
        judged("sharpness", refocus_px, "px", trust.refocus_px, said, "focus once, by hand, and let the table come to rest"), sharp
    )


def of_markers(inset_px: float | None, corners_px: float | None, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that the markers are as large as they were printed, and where the cameras put them."""
    if inset_px is None or corners_px is None:
        return untold("markers", "the cameras were given: no markers were measured", unit="px", limits=trust.inset_px)
    apart = f"the markers' corners lie {corners_px:.2f} px from where the cameras put them"
    scene = "check strip, net pot and lens in the scene; print the strip to scale and put it on without a gap"
    larger = "larger" if inset_px > 0 else "smaller"
    said = f"the markers look {abs(inset_px):.3f} px {larger} on each side than they were printed"
    advice = "state the camera's transfer, switch its sharpening off, and measure the print with a ruler"
    return foremost(
        judged("markers", corners_px, "px", trust.corners_px, apart, scene),
        judged("markers", abs(inset_px), "px", trust.inset_px, said, advice),
    )


def of_canister(pose: CanisterPose | None, scene: Scene, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that the canister's edges fit its drawing; in a tank they must be seen, as nothing else tells its turn."""
    canister = scene.canister
    if pose is None and scene.tank is not None:
        said = "the canister's edges are not seen in the tank, and nothing else tells how it is turned: a degree moves outlines by 0.4 mm"
        return stated(
            "canister", "bad", None, "mm", trust.edge_mm, said, "scan without the tank, or with a panel that leaves the edges dark"
        )
    if pose is None:
        said = "the canister's edges are not seen before the panel, so that its radius and place are those of the drawing"
        return untold("canister", said, "use a panel wider than the canister", unit="mm", limits=trust.edge_mm)
    share = abs(pose.radius_excess_mm) / canister.outer_radius_mm
    other = f"the canister's edges lie {pose.radius_excess_mm:+.2f} mm from its drawing"
    measure = "measure its outer diameter (and its wall) with callipers and put them into the scene"
    oval = f"the canister is an oval whose radius is {pose.oval_mm:.2f} mm larger one way and smaller across"
    said = f"the canister's edges lie {pose.after_mm:.3f} mm (median) about a circle, {pose.oval_mm:.2f} mm of oval taken off"
    return foremost(
        judged("canister", share, "share", trust.radius_share, other, measure),
        judged("canister", pose.oval_mm, "mm", trust.oval_mm, oval, "take another tube, or stiffen it with a ring"),
        judged("canister", pose.after_mm, "mm", trust.edge_mm, said, "the tube is out of shape: take another"),
    )


def of_resolution(width_px: float | None, image_wh: tuple[int, int], trust: TrustSettings = TrustSettings()) -> Check:
    """Check that roots are wide enough in the pictures.

    Parameters
    ----------
    width_px : float or None
        Of thin roots (`root_width.thin_width_px`); None where there are no lines.
    image_wh : (int, int)
        Size of the pictures.
    trust : TrustSettings
        The limits.
    """
    if width_px is None:
        return untold("resolution", "no roots were found as lines in the pictures", unit="px")
    said = f"a quarter of the roots' length is thinner than {width_px:.1f} px"
    enough = round(image_wh[0] / max(width_px, 1e-6), -1)
    advice = f"take pictures of at least {enough:.0f} pixels across, in which it is a pixel wide, or stand nearer"
    return judged("resolution", width_px, "px", trust.resolution_px, said, advice)


def of_views(azimuth_deg: Sequence[float] | NDArray[np.float64], pictures: int, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that the views are enough and go all the way round.

    Parameters
    ----------
    azimuth_deg : (V,) float64 array
        Of the cameras about the canister, of the views that are used.
    pictures : int
        All that were taken.
    trust : TrustSettings
        The limits.
    """
    used, out = len(azimuth_deg), 1.0 - len(azimuth_deg) / max(1, pictures)
    order = np.sort(np.mod(np.asarray(azimuth_deg, np.float64), 360.0))
    gap_deg = float(np.max(np.diff(np.append(order, order[0] + 360.0)))) if used else 360.0
    lost = f"{pictures - used} of {pictures} pictures could not be used"
    said = f"{used} views, the largest step between neighbours {gap_deg:.0f} degrees"
    return foremost(
        judged("views", out, "share", trust.left_out, lost, "see why each was left out, and take them again"),
        judged("views", gap_deg, "deg", trust.gap_deg, said, "take more views, evenly round the turn"),
    )
