"""Checks of the scan and its pictures.

They cover completeness, exposure, linearity, sharpness, markers, canister, resolution and views.
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
    """Check that the pictures are those of a finished scan, and not sketches."""
    twin = (origin.get("settings") or {}).get("twin") or {}
    planned = origin.get("planned_views")
    state: State = "good"
    found, advice = f"the scan is complete ({len(frames)} pictures)", ""
    if twin.get("fidelity") == "sketch":
        state, found = "bad", "the pictures are sketches of the twin, which show markers but no water"
        advice = "scan with --fidelity render"
    elif origin.get("complete") is False:
        of = f" of {planned}" if planned else ""
        state, found = "bad", f"the scan was stopped after {len(frames)}{of} pictures"
        advice = "finish it with scan --resume"
    elif unchecked := [str(event.get("text")) for event in origin.get("log") or [] if event.get("event") == "unchecked"]:
        state, found = "fair", unchecked[-1]
        advice = "illuminate and focus the strip, so that the markers confirm the angles"
    return stated("scan", state, float(len(frames)), "pictures", None, found, advice)


def of_exposure(found: Exposures | None, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that the panel is bright, not clipped, and uniformly exposed."""
    if found is None or not np.isfinite(found.level).any():
        said = "no empty panel is visible beside the canister, so that the exposure could not be measured"
        return untold("exposure", said, "use a panel wider than the canister, or fix the exposure")
    clipped, level, wander = float(found.clipped.max()), float(np.nanmin(found.level)), found.wander
    full = f"{100.0 * clipped:.3g} % of the panel is at full scale in the worst picture"
    dim = f"the panel reaches only {100.0 * level:.2g} % of full scale"
    said = f"the exposure varies by {100.0 * wander:.2g} % between pictures, which was corrected"
    uneven, bands = float(found.uneven.max(initial=0.0)), found.bands
    patchy = f"the brightness of the panel varies by {100.0 * uneven:.2g} % across the panel and between pictures"
    evened = f"the brightness of the panel varies by {100.0 * bands:.2g} % within a picture, which was corrected row by row"
    lamp = "use a lamp on direct current, and keep shadows off the panel"
    return foremost(
        judged("exposure", clipped, "share", trust.clipped, full, "reduce the exposure, so that the panel is at 0.8 of full scale"),
        judged("exposure", level, "share", trust.dim, dim, "increase the exposure, so that the panel is at 0.8 of full scale"),
        judged("exposure", uneven, "share", trust.uneven, patchy, lamp),
        judged("exposure", bands, "share", trust.wander, evened, lamp),
        judged("exposure", wander, "share", trust.wander, said, "set exposure and gain manually"),
    )


def of_curve(found: CurveFound | None) -> Check:
    """Check that the pictures are linear in light, from the greys of edges."""
    if found is None or found.bend is None:
        said = "too few markers were measured to test whether the pictures are linear in light"
        return untold("curve", said, "set the camera's transfer in the scene, or calibrate it")
    advice = "set the correct transfer of the camera in the scene; rhizotwin calibrate transfer measures it"
    bend, limits = abs(found.bend), (0.5 * MOST_BEND, MOST_BEND)
    said = f"greys at the marker edges deviate by {100.0 * found.bend:.1f} % of the contrast, with the curve {found.curve.name}"
    if bend > MOST_BEND:
        return judged("curve", bend, "share", limits, said, advice)
    if not found.is_known:
        said = f"the pictures match neither the stated nor a known curve; {found.curve.name} was used instead"
        return stated("curve", "bad", bend, "share", limits, said, advice)
    if not found.curve.same(found.stated):
        said = f"the stated curve, {found.stated.name}, contradicts the marker edges: the pictures were read with {found.curve.name}"
        return stated("curve", "fair", bend, "share", limits, said, advice)
    return judged("curve", bend, "share", limits, said, advice)


def of_sharpness(blur_px: float | None, refocus_px: float | None = None, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that the markers are sharp, and equally sharp in all pictures."""
    if blur_px is None:
        return untold("sharpness", "no markers were measured, so that the blur is unknown", unit="px", limits=trust.blur_px)
    advice = "focus on the canister's axis, stop down the lens, or wait longer after each step of the table"
    sharp = judged("sharpness", blur_px, "px", trust.blur_px, f"edges are blurred by {blur_px:.2f} px", advice)
    if refocus_px is None:
        return sharp
    said = f"some pictures are blurred by {refocus_px:.2f} px more than others"
    return foremost(
        judged("sharpness", refocus_px, "px", trust.refocus_px, said, "focus once, manually, and wait longer after each step"), sharp
    )


def of_markers(inset_px: float | None, corners_px: float | None, trust: TrustSettings = TrustSettings()) -> Check:
    """Check the size of the markers and their reprojection error."""
    if inset_px is None or corners_px is None:
        return untold("markers", "the cameras were given: no markers were measured", unit="px", limits=trust.inset_px)
    apart = f"the reprojection error of the marker corners is {corners_px:.2f} px"
    scene = "check strip, net pot and lens in the scene; print the strip to scale and attach it without a gap"
    larger = "larger" if inset_px > 0 else "smaller"
    said = f"the markers appear {abs(inset_px):.3f} px {larger} on each side than printed"
    advice = "set the camera's transfer, switch off its sharpening, and measure the print with a ruler"
    return foremost(
        judged("markers", corners_px, "px", trust.corners_px, apart, scene),
        judged("markers", abs(inset_px), "px", trust.inset_px, said, advice),
    )


def of_canister(pose: CanisterPose | None, scene: Scene, trust: TrustSettings = TrustSettings()) -> Check:
    """Check the canister's edges against its drawing; in a tank they must be visible, to determine its rotation."""
    canister = scene.canister
    if pose is None and scene.tank is not None:
        said = "the canister's edges are not visible in the tank, so that its rotation is unknown: one degree moves outlines by 0.4 mm"
        return stated(
            "canister", "bad", None, "mm", trust.edge_mm, said, "scan without the tank, or with a panel that leaves the edges dark"
        )
    if pose is None:
        said = "the canister's edges are not visible in front of the panel, so that its radius and position are those of the drawing"
        return untold("canister", said, "use a panel wider than the canister", unit="mm", limits=trust.edge_mm)
    share = abs(pose.radius_excess_mm) / canister.outer_radius_mm
    other = f"the radius of the canister's edges differs from its drawing by {pose.radius_excess_mm:+.2f} mm"
    measure = "measure its outer diameter (and its wall) with callipers and enter them in the scene"
    oval = f"the canister is oval: its radius varies by +-{pose.oval_mm:.2f} mm"
    said = f"the canister's edges deviate by {pose.after_mm:.3f} mm (median) from an oval of +-{pose.oval_mm:.2f} mm"
    return foremost(
        judged("canister", share, "share", trust.radius_share, other, measure),
        judged("canister", pose.oval_mm, "mm", trust.oval_mm, oval, "use another tube, or stiffen it with a ring"),
        judged("canister", pose.after_mm, "mm", trust.edge_mm, said, "the tube is deformed: use another"),
    )


def of_resolution(width_px: float | None, image_wh: tuple[int, int], trust: TrustSettings = TrustSettings()) -> Check:
    """Check that roots are wide enough in the pictures.

    Parameters
    ----------
    width_px : float or None
        Width of thin roots (`root_width.thin_width_px`); None if there are no lines.
    image_wh : (int, int)
        Size of the pictures.
    trust : TrustSettings
        The limits.
    """
    if width_px is None:
        return untold("resolution", "no roots were found in the pictures", unit="px")
    said = f"a quarter of the roots' length is thinner than {width_px:.1f} px"
    enough = round(image_wh[0] / max(width_px, 1e-6), -1)
    advice = f"take pictures at least {enough:.0f} pixels wide, in which these roots are a pixel wide, or move the camera nearer"
    return judged("resolution", width_px, "px", trust.resolution_px, said, advice)


def of_views(azimuth_deg: Sequence[float] | NDArray[np.float64], pictures: int, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that there are enough views, all around.

    Parameters
    ----------
    azimuth_deg : (V,) float64 array
        Azimuths of the used cameras about the canister.
    pictures : int
        Number of all pictures.
    trust : TrustSettings
        The limits.
    """
    used, out = len(azimuth_deg), 1.0 - len(azimuth_deg) / max(1, pictures)
    order = np.sort(np.mod(np.asarray(azimuth_deg, np.float64), 360.0))
    gap_deg = float(np.max(np.diff(np.append(order, order[0] + 360.0)))) if used else 360.0
    lost = f"{pictures - used} of {pictures} pictures could not be used"
    said = f"{used} views, with a largest step of {gap_deg:.0f} degrees between neighbours"
    return foremost(
        judged("views", out, "share", trust.left_out, lost, "check why each was left out, and take them again"),
        judged("views", gap_deg, "deg", trust.gap_deg, said, "take more views, evenly spaced around the turn"),
    )
