"""The table of what was calibrated from the pictures, and its errors against the truth."""

import numpy as np
import pytest

from rhizotwin.recon.calibration.cameras import Camera, Cameras, MarkerCalibration, RootCalibration
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.results.calibration_summary import summarize_cameras
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.truth import TrueView, Truth
from rhizotwin.scoring.score_rig import compare_rig
from rhizotwin.stored import calibration_table
from tests.recon.hull.exact_pictures import rows

SEAT = frames.from_rotvec(np.deg2rad([0.1, -0.05, 0.0]), np.array([0.2, 0.3, 0.0]))
INDEX = {"n_water": 1.3341, "n_water_given": 1.333, "n_water_found": 1.3341, "n_water_sigma": 0.0002}
FOCUS = {"focal_scale": 1.0, "focal_scale_found": 1.0002, "focal_scale_sigma": 0.0001, "table_correction_deg": 0.04}
PLACE = {"canister_from_strip": SEAT.tolist(), "canister_from_strip_sigma": [0.001, 0.001, 0.002, 0.002]}
EDGES = {"canister_edges": {"count": 900, "before_mm": 0.21, "after_mm": 0.01, "radius_excess_mm": 0.0}}
LEFT = {"reprojection_before_px": 0.8, "reprojection_after_px": 0.05, "roots": {"nodes": 700, "before_px": 0.09, "after_px": 0.05}}
RIG = INDEX | FOCUS | PLACE | EDGES | LEFT


def truth(**drawn: object) -> Truth:
    pose = rows(frames.translation(0.004, 0.0, 0.0) @ SEAT)
    views = tuple(TrueView(file=f"v{k}.png", cam_from_canister=pose, table_deg=90.0 * k) for k in range(4))
    extents = {"extents_min_mm": (0.0, 0.0, 0.0), "extents_max_mm": (1.0, 1.0, 1.0)}
    return Truth(volume_mm3=1.0, **extents, n_water=1.334, canister_from_strip=pose, views=views, drawn=dict(drawn))


def test_the_table_tells_what_was_taken_and_what_was_not() -> None:
    by_name = {row.quantity: row for row in calibration_table.rows(RIG)}
    assert by_name["refractive index of the water"].taken
    assert not by_name["focal length relative to the given value"].taken
    text = "\n".join(calibration_table.table(RIG))
    assert "focal length relative to the given value: given 1, found 1.0002 +- 0.0001 (too uncertain, the given value was used)" in text
    assert calibration_table.table({}) == [], "cameras that were given leave none"


@pytest.mark.parametrize(("markers", "found", "taken"), [(1.0, 1.002, False), (1.002, 1.00205, True)])
def test_a_focal_length_of_the_roots_is_not_that_of_the_markers(markers: float, found: float, taken: bool) -> None:
    unknown = dict.fromkeys(("table_sigma", "table_correction_deg", "canister"))
    by_markers = MarkerCalibration(focal_scale=markers, focal_found=1.002, focal_sigma=0.001, **unknown)
    index = {"n_water": 1.334, "n_water_sigma": 1e-4, "n_water_given": 1.333}
    by_roots = RootCalibration(**index, focal_scale=1.00205 / 1.002, believed=True, nodes=700, before_px=0.09, after_px=0.05)
    scene = Scene()
    cameras = Cameras(lens=scene.camera, optics=Optics.from_scene(scene), all=(), order=(), markers=by_markers, roots=by_roots)
    rig = summarize_cameras(cameras)
    row = next(row for row in calibration_table.rows(rig) if row.quantity == "focal length relative to the given value")
    assert (row.found, row.taken) == (pytest.approx(found, abs=1e-9), taken)


def test_each_quantity_is_judged_in_its_own_standard_deviations() -> None:
    views = [Camera(file=f"v{k}.png", ring=0, used=True, table_deg=90.0 * k + 0.5 + (0.01 if k % 2 else -0.01)) for k in range(4)]
    errors = {error.quantity: error for error in compare_rig(RIG, views, truth(focal_error=0.0))}
    assert errors["refractive index of the water"].error == pytest.approx(1e-4)
    assert "0.5 standard deviations" in errors["refractive index of the water"].text
    assert errors["canister relative to the marker strip: offset x"].error == pytest.approx(-0.004)
    assert errors["focal length relative to the given value"].true == 1.0
    assert errors["table angles (rms)"].found == pytest.approx(0.01)
    assert compare_rig({"mm_per_px": 0.1}, views, truth()) == (), "angles without markers are the commanded ones"
    unknown = "focal length relative to the given value"
    assert unknown not in {error.quantity for error in compare_rig(RIG, [], truth())}, "the truth does not know it"
