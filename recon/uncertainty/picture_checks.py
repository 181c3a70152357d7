"""Checks of a scan and its pictures.

They cover completeness, exposure, linearity, sharpness, markers, canister, resolution and number of views.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.canister_pose import CanisterPose
from rhizotwin.recon.calibration.curve import MOST_BEND
from rhizotwin.recon.calibration.exposure import Exposures
from rhizotwin.recon.read_pictures import CurveFound
from rhizotwin.recon.settings import TrustSettings
from rhizotwin.recon.uncertainty.checks import Check, State, judge, make_check, make_unknown, worst
from rhizotwin.scenes.dataset import Frame
from rhizotwin.scenes.model import Scene


def check_scan(origin: dict[str, Any], frames: Sequence[Frame]) -> Check:
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
    return make_check("scan", state, float(len(frames)), "pictures", None, found, advice)


def check_exposure(found: Exposures | None, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that the panel is bright enough, not overexposed, and of constant brightness.

    The brightness must be constant across the panel, and from picture to picture.
    """
    if found is None or not np.isfinite(found.level).any():
        finding = "no empty panel is visible beside the canister, so that the exposure could not be measured"
        return make_unknown("exposure", finding, "use a panel wider than the canister, or fix the exposure")
    clipped, level, wander = float(found.clipped.max()), float(np.nanmin(found.level)), found.wander
    full = f"{100.0 * clipped:.3g} % of the panel is at full scale in the worst picture"
    dim = f"the panel reaches only {100.0 * level:.2g} % of full scale"
    finding = f"the exposure varies by {100.0 * wander:.2g} % between pictures, which was corrected"
    uneven, bands = float(found.uneven.max(initial=0.0)), found.bands
    patchy = f"the brightness of the panel varies by {100.0 * uneven:.2g} % across the panel and between pictures"
    evened = f"the brightness of the panel varies by {100.0 * bands:.2g} % within a picture, which was corrected row by row"
    lamp = "use a lamp on direct current, and keep shadows off the panel"
    return worst(
        judge("exposure", clipped, "share", trust.clipped, full, "reduce the exposure, so that the panel is at 0.8 of full scale"),
        judge("exposure", level, "share", trust.dim, dim, "increase the exposure, so that the panel is at 0.8 of full scale"),
        judge("exposure", uneven, "share", trust.uneven, patchy, lamp),
        judge("exposure", bands, "share", trust.wander, evened, lamp),
        judge("exposure", wander, "share", trust.wander, finding, "set exposure and gain manually"),
    )


def check_curve(found: CurveFound | None) -> Check:
    """Check that the grey levels of the pictures are proportional to light.

    The check uses the grey levels at the edges of the markers.
    """
    if found is None or found.bend is None:
        finding = "too few markers were measured to test whether the pictures are linear in light"
        return make_unknown("curve", finding, "set the camera's transfer in the scene, or calibrate it")
    advice = "set the correct transfer of the camera in the scene; rhizotwin calibrate transfer measures it"
    bend, limits = abs(found.bend), (0.5 * MOST_BEND, MOST_BEND)
    finding = f"greys at the marker edges deviate by {100.0 * found.bend:.1f} % of the contrast, with the curve {found.curve.name}"
    if bend > MOST_BEND:
        return judge("curve", bend, "share", limits, finding, advice)
    if not found.is_known:
        finding = f"the pictures match neither the stated nor a known curve; {found.curve.name} was used instead"
        return make_check("curve", "bad", bend, "share", limits, finding, advice)
    if not found.curve.same(found.stated):
        finding = f"the stated curve, {found.stated.name}, contradicts the marker edges: the pictures were read with {found.curve.name}"
        return make_check("curve", "fair", bend, "share", limits, finding, advice)
    return judge("curve", bend, "share", limits, finding, advice)


def check_sharpness(blur_px: float | None, refocus_px: float | None = None, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that the markers are sharp, and equally sharp in all pictures."""
    if blur_px is None:
        return make_unknown("sharpness", "no markers were measured, so that the blur is unknown", unit="px", limits=trust.blur_px)
    advice = "focus on the canister's axis, stop down the lens, or wait longer after each step of the table"
    sharp = judge("sharpness", blur_px, "px", trust.blur_px, f"edges are blurred by {blur_px:.2f} px", advice)
    if refocus_px is None:
        return sharp
    finding = f"some pictures are blurred by {refocus_px:.2f} px more than others"
    return worst(
        judge("sharpness", refocus_px, "px", trust.refocus_px, finding, "focus once, manually, and wait longer after each step"), sharp
    )


def check_markers(inset_px: float | None, corners_px: float | None, trust: TrustSettings = TrustSettings()) -> Check:
    """Check the size of the markers and their reprojection error."""
    if inset_px is None or corners_px is None:
        return make_unknown("markers", "the cameras were given: no markers were measured", unit="px", limits=trust.inset_px)
    apart = f"the reprojection error of the marker corners is {corners_px:.2f} px"
    scene = "check strip, net pot and lens in the scene; print the strip to scale and attach it without a gap"
    larger = "larger" if inset_px > 0 else "smaller"
    finding = f"the markers appear {abs(inset_px):.3f} px {larger} on each side than printed"
    advice = "set the camera's transfer, switch off its sharpening, and measure the print with a ruler"
    return worst(
        judge("markers", corners_px, "px", trust.corners_px, apart, scene),
        judge("markers", abs(inset_px), "px", trust.inset_px, finding, advice),
    )


def check_canister(pose: CanisterPose | None, scene: Scene, trust: TrustSettings = TrustSettings()) -> Check:
    """Compare the edges of the canister in the pictures with its drawing.

    In a tank, the edges must be visible, since they determine the rotation of the tank.
    """
    canister = scene.canister
    if pose is None and scene.tank is not None:
        finding = "the canister's edges are not visible in the tank, so that its rotation is unknown: one degree moves outlines by 0.4 mm"
        return make_check(
            "canister", "bad", None, "mm", trust.edge_mm, finding, "scan without the tank, or with a panel that leaves the edges dark"
        )
    if pose is None:
        finding = "the canister's edges are not visible in front of the panel, so that its radius and position are those of the drawing"
        return make_unknown("canister", finding, "use a panel wider than the canister", unit="mm", limits=trust.edge_mm)
    share = abs(pose.radius_excess_mm) / canister.outer_radius_mm
    other = f"the radius of the canister's edges differs from its drawing by {pose.radius_excess_mm:+.2f} mm"
    measure = "measure its outer diameter (and its wall) with callipers and enter them in the scene"
    oval = f"the canister is oval: its radius varies by +-{pose.oval_mm:.2f} mm"
    finding = f"the canister's edges deviate by {pose.after_mm:.3f} mm (median) from an oval of +-{pose.oval_mm:.2f} mm"
    return worst(
        judge("canister", share, "share", trust.radius_share, other, measure),
        judge("canister", pose.oval_mm, "mm", trust.oval_mm, oval, "use another tube, or stiffen it with a ring"),
        judge("canister", pose.after_mm, "mm", trust.edge_mm, finding, "the tube is deformed: use another"),
    )


def check_resolution(width_px: float | None, image_wh: tuple[int, int], trust: TrustSettings = TrustSettings()) -> Check:
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
        return make_unknown("resolution", "no roots were found in the pictures", unit="px")
    finding = f"a quarter of the roots' length is thinner than {width_px:.1f} px"
    enough = round(image_wh[0] / max(width_px, 1e-6), -1)
    advice = f"take pictures at least {enough:.0f} pixels wide, in which these roots are a pixel wide, or move the camera nearer"
    return judge("resolution", width_px, "px", trust.resolution_px, finding, advice)


def check_views(azimuth_deg: Sequence[float] | NDArray[np.float64], pictures: int, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that there are enough views, and that they are distributed all around the canister.

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
    finding = f"{used} views, with a largest step of {gap_deg:.0f} degrees between neighbours"
    return worst(
        judge("views", out, "share", trust.left_out, lost, "check why each was left out, and take them again"),
        judge("views", gap_deg, "deg", trust.gap_deg, finding, "take more views, evenly spaced around the turn"),
    )
