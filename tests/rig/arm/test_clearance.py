"""The arm's joints for the plan's rings, and its paths between obstacles: distances by brute force, nothing missed between samples."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rhizotwin.rig.arm.clearance import FINE_MM, check_path, pairs, plan_path, solids
from rhizotwin.rig.arm.kinematics import arm_from_cam, cam_from_rig, rig_from_arm
from rhizotwin.rig.arm.placement import Joints, compute_joints, compute_joints_from_direction, correct_joints, planned_camera_pose
from rhizotwin.rig.arm.solids import Box, Cylinder, Floor, minimum_distance, point_to_segment
from rhizotwin.rig.arm.tangency import azimuth_rad, rotate_to_azimuth
from rhizotwin.rig.errors import UnsafeError
from rhizotwin.rig.rig_file import ArmPart, Bar, Clearance, RigFile
from rhizotwin.scenes import frames
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import Ring, Scene, Tank

ARM = ArmPart(position_mm=(650.0, 0.0, -100.0))  # on a stand so low that it reaches the floor
RIG = RigFile(arm=ARM)
SCENE = Scene()
RING = compute_joints(RIG, planned_camera_pose(Ring()))
SOLIDS = (Cylinder("can", 76.2, -152.4, 0.0), Box("bar", (-30.0, -20.0, 5.0), (40.0, 60.0, 25.0)), Floor("floor", -195.0))
point = st.lists(st.floats(-250.0, 250.0), min_size=3, max_size=3).map(np.array)


def near(x_mm: float = 330.0, **clearance: object) -> RigFile:
    """Return a rig whose arm stands so near that it reaches everything."""
    return replace(RIG, arm=replace(ARM, position_mm=(x_mm, 0.0, -100.0)), clearance=replace(Clearance(), **clearance))


def camera_mm(rig: RigFile, joints_deg: Joints) -> Array:
    assert rig.arm is not None
    return frames.apply(rig_from_arm(rig.arm), arm_from_cam(rig.arm, joints_deg)[:3, 3])


def distance_of(rig: RigFile, piece: str, other: str, joints_deg: Joints) -> float:
    found = pairs(rig, SCENE, np.array([joints_deg]))
    return float(found.distance_mm[0, found.names.index((piece, other))])


@given(at=point, begin=point, end=point)
@settings(max_examples=60)
def test_distance_of_a_link_is_the_least_of_its_points(at: Array, begin: Array, end: Array) -> None:
    along = begin + np.linspace(0.0, 1.0, 2001)[:, None] * (end - begin)
    coarse = np.linalg.norm(end - begin) / 4000.0 + 1e-6
    for solid in SOLIDS:
        sampled = solid.distance_mm(along).min()
        assert sampled - coarse <= float(minimum_distance(solid, begin[None], end[None])[0]) <= sampled + 1e-4
    sampled = np.linalg.norm(along - at, axis=1).min()
    assert sampled - coarse <= float(point_to_segment(at[None], begin[None], end[None])[0]) <= sampled + 1e-6


def test_distances_of_a_pose_by_hand() -> None:
    """Stretched toward the table: shoulder at x = 650 and z = -39, camera 293 mm before it, on the canister's side."""
    stretched, folded = (0.0, 90.0, 0.0, 0.0, 0.0), (0.0, 0.0, 88.0, 112.0, 0.0)
    for piece, other, distance_mm in (
        ("camera", "the canister", 650 - 293 - 76.2 - 35),
        ("last link", "the canister", 650 - 293 - 76.2 - 32),
        ("forearm", "the floor", 195 - 39 - 32),
        ("base", "the table", np.hypot(650 - 110, 52.4) - 32),
        ("camera", "the arm's own upper arm", 96.4 + 95 - 35 - 32),
    ):
        assert distance_of(RIG, piece, other, stretched) == pytest.approx(distance_mm)
    assert distance_of(RIG, "camera", "the arm's own upper arm", folded) < 0.0


def test_default_arm_is_clear_at_rest_and_to_the_rings() -> None:
    arm = ArmPart()
    rig = RigFile(arm=arm)
    at_rest = pairs(rig, SCENE, np.array([arm.park_deg]))
    assert (at_rest.distance_mm > at_rest.margin_mm + 20.0).all()
    at: Joints = arm.park_deg
    for ring in (Ring(), Ring(height_mm=120.0, distance_mm=420.0, tilt_deg=10.0, kind="shoot"), Ring(height_mm=-65.0)):
        goal = compute_joints(rig, planned_camera_pose(ring))
        assert max(frames.pose_error(cam_from_rig(arm, goal), planned_camera_pose(ring))) < 1e-6
        assert plan_path(rig, SCENE, at, goal) == [goal]
        at = goal
    assert plan_path(rig, SCENE, at, arm.park_deg) == [arm.park_deg]


BAR = Clearance(bars=(Bar(low_mm=(300.0, -300.0, 0.0), high_mm=(340.0, 300.0, 20.0)),))
CRASHES = {
    "canister": (near(), ((0, 0, 0, 0, 0), (0, 90, 0, 0, 0)), r"^arm: the (camera|last link) would touch the canister at the end"),
    "second leg": (near(), ((60, 0, 0, 0, 0), (60, 80, 0, 0, 0), (-60, 80, 0, 0, 0)), r"touch the net pot 75 % along the path"),
    "bar": (replace(RIG, clearance=BAR), ((0, 0, 0, 0, 0), (0, 75, 0, 0, 0)), r"the bar 1"),
    "base": (near(100.0), (ARM.park_deg, (0.0, 0.0, 0.0, 0.0, 0.0)), r"^arm: the base would"),
    "its own upper arm": (RIG, ((0, -30, 0, 0, 0), (0, -30, 88, 112, 0)), r"the camera would touch the arm's own upper arm"),
    "touches": (near(), ((0, 90, 0, 0, 0), ARM.park_deg), r"the canister in its present position; move it away by hand"),
}


@pytest.mark.parametrize(("rig", "path", "match"), CRASHES.values(), ids=CRASHES)
def test_crash_is_refused_with_what_where_and_how_near(rig: RigFile, path: tuple[Joints, ...], match: str) -> None:
    with pytest.raises(UnsafeError, match=match):
        check_path(rig, SCENE, path)


def test_margin_is_kept_at_the_end_of_the_path() -> None:
    way = [(0.0,) * 5, (0.0, 30.0, 60.0, 0.0, 0.0)]  # comes nearer all the way
    spare = pairs(near(380.0, margin_mm=0.0), SCENE, np.array(way[1:])).distance_mm.min()
    assert 5.0 < spare < 40.0
    check_path(near(380.0, margin_mm=spare - 0.01), SCENE, way)
    says = rf"within {spare:.1f} mm of the \w+.* \(minimum {spare + 0.6:.0f} mm\) at the end of the path"
    with pytest.raises(UnsafeError, match=says):
        check_path(near(380.0, margin_mm=spare + 0.6), SCENE, way)


def past_cube(part: float, low_mm: float) -> None:
    """Check half a turn of a thin arm past a cube of 1 mm at a height above a place of the camera."""
    begin, end = (-90.0, 90.0, 0.0, 0.0, 0.0), (90.0, 90.0, 0.0, 0.0, 0.0)
    at = camera_mm(RIG, tuple(np.add(begin, part * np.subtract(end, begin))))
    cube = Bar(low_mm=tuple(np.add(at, (-0.5, -0.5, low_mm))), high_mm=tuple(np.add(at, (0.5, 0.5, low_mm + 1.0))))
    thin = Clearance(margin_mm=0.0, arm_radius_mm=1.0, camera_radius_mm=1.0, bars=(cube,))
    check_path(replace(RIG, clearance=thin), SCENE, [begin, end])


@pytest.mark.parametrize("part", [0.03, 0.4, 0.97])
def test_thin_bar_between_samples_is_not_missed(part: float) -> None:
    with pytest.raises(UnsafeError, match=rf"the bar 1 {100 * part:.0f} % along the path"):
        past_cube(part, -0.5)
    past_cube(part, 1.6)


def test_verdicts_agree_with_dense_samples() -> None:
    """Of 45 random ways on a crowded rig, clear ones are clear at 200 samples, refused ones too near at one of them."""
    rig = near(bars=(Bar(low_mm=(200.0, 80.0, 20.0), high_mm=(420.0, 110.0, 60.0)),))
    low, high = (np.array([getattr(joint, name) for joint in ARM.joints]) for name in ("min_deg", "max_deg"))
    rng = np.random.default_rng(0)
    verdicts = []
    for _ in range(45):
        begin, end = rng.uniform(low, high, (2, 5))
        samples = pairs(rig, SCENE, begin + np.linspace(0.0, 1.0, 201)[:, None] * (end - begin))
        spare = float((samples.distance_mm - samples.margin_mm).min())
        if (samples.distance_mm[0] < samples.margin_mm).any():  # how it may leave is another test
            continue
        try:
            check_path(rig, SCENE, [tuple(begin), tuple(end)])
            assert spare > -FINE_MM
            verdicts.append(True)
        except UnsafeError:
            assert spare < 2.0
            verdicts.append(False)
    assert 8 < sum(verdicts) < len(verdicts) - 8


def test_arm_within_a_margin_may_move_away_but_not_nearer() -> None:
    sagged = (0.0, 84.0, 30.0, 0.0, 0.0)
    floor = distance_of(RIG, "camera", "the floor", sagged)
    rig = replace(RIG, clearance=Clearance(margin_mm=floor + 5.0))
    check_path(rig, SCENE, [sagged, ARM.park_deg])
    for path in ([ARM.park_deg, sagged], [sagged, (0.0, 88.0, 30.0, 0.0, 0.0), ARM.park_deg]):
        with pytest.raises(UnsafeError, match="the floor"):
            check_path(rig, SCENE, path)
    lying = (0.0, 90.0, 62.0, -25.0, 0.0)
    assert -32.0 < distance_of(RIG, "camera", "the floor", lying) < 0.0
    check_path(RIG, SCENE, [lying, ARM.park_deg])


def test_way_round_goes_through_a_drawn_in_arm() -> None:
    begin, end = (60.0, 80.0, 0.0, 0.0, 0.0), (-60.0, 80.0, 0.0, 0.0, 0.0)
    path = plan_path(near(), SCENE, begin, end)
    assert len(path) > 1
    assert path[-1] == end
    check_path(near(), SCENE, [begin, *path])
    with pytest.raises(UnsafeError, match=r"the canister at the end of the path; .*a path with a retracted arm is not clear"):
        plan_path(near(), SCENE, ARM.park_deg, (0.0, 90.0, 0.0, 0.0, 0.0))


def test_a_tank_is_kept_clear_of_however_it_is_turned() -> None:
    scene = replace(Scene(), tank=Tank(front_mm=100.0, half_width_mm=130.0, level_mm=-8.0, turn_deg=5.0))
    box = next(solid for solid in solids(RIG, scene) if solid.name == "tank")
    turn = np.deg2rad(5.0)
    flat = np.array([[x, y] for x in (-100.0, 100.0) for y in (-130.0, 130.0)])
    turned = flat @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    assert np.all(box.distance_mm(np.insert(turned, 2, -50.0, axis=1)) <= 1e-9)
    assert box.distance_mm(np.array([0.0, 0.0, 10.0])) == pytest.approx(18.0)


def with_arm(**changes: object) -> RigFile:
    return replace(RIG, arm=replace(ARM, **changes))


def test_elbow_is_up() -> None:
    pose = planned_camera_pose(Ring(height_mm=60.0))
    joints_deg = compute_joints(RIG, pose)
    below = tuple(replace(joint, max_deg=-1.0) if i == 2 else joint for i, joint in enumerate(ARM.joints))
    forced = compute_joints(with_arm(joints=below, park_deg=(0.0, 0.0, -10.0, 0.0, 0.0)), pose)
    assert joints_deg[2] > 0.0 > forced[2]
    np.testing.assert_allclose(cam_from_rig(ARM, forced), cam_from_rig(ARM, joints_deg), atol=1e-6)


ASIDE = with_arm(position_mm=(600.0, 180.0, -100.0), rotation_deg=(0.0, 0.0, -160.0))
REFUSED = {
    "too far": (RIG, Ring(distance_mm=350.0), r"is out of reach: .* 205 mm from the shoulder, but the links permit 5 to 198 mm; move"),
    "elbow": (RIG, Ring(distance_mm=450.0), r"within the joints' limits: elbow 116\.0 deg \(limits -88 to 88\); move"),
    "far aside": (ASIDE, Ring(), r"16\.7 deg from the rig's x axis, but at more than 15 deg it does not face the backlight"),
}


@pytest.mark.parametrize(("rig", "ring", "match"), REFUSED.values(), ids=REFUSED)
def test_refused_with_the_numbers(rig: RigFile, ring: Ring, match: str) -> None:
    with pytest.raises(UnsafeError, match=match):
        compute_joints(rig, planned_camera_pose(ring))


def test_an_askew_arm_turns_the_camera_round_the_table() -> None:
    rig = with_arm(position_mm=(650.0, 25.0, -100.0), rotation_deg=(2.0, 3.0, 178.0))
    ring = Ring(height_mm=-20.0, tilt_deg=4.0)
    camera = cam_from_rig(rig.arm, compute_joints(rig, planned_camera_pose(ring)))
    assert max(frames.pose_error(camera, rotate_to_azimuth(planned_camera_pose(ring), camera))) < 1e-5
    assert 0.01 < abs(np.rad2deg(azimuth_rad(camera))) < 5.0


def test_corrections_that_cannot_be_are_refused() -> None:
    wanted = planned_camera_pose(Ring())
    joints_deg = compute_joints(RIG, wanted)
    with pytest.raises(UnsafeError, match=r"the markers require the .* more than the maximum correction of 25 deg; check joints, links_mm"):
        correct_joints(RIG, joints_deg, cam_from_rig(ARM, np.add(joints_deg, (0, 0, 0, 0, 40))), wanted)
    with pytest.raises(UnsafeError, match=r"distance 300 mm, .* cannot be reached; the nearest position is \d+\.\d mm away"):
        correct_joints(RIG, joints_deg, cam_from_rig(ARM, joints_deg), planned_camera_pose(Ring(distance_mm=300.0)))


def test_a_pose_by_position_and_direction_is_held() -> None:
    position, direction = (420.0, 30.0, -20.0), (-230.0, 30.0, -40.0)  # through the base's axis at x = 650
    found = frames.invert(cam_from_rig(ARM, compute_joints_from_direction(RIG, position, direction)))
    np.testing.assert_allclose(found[:3, 3], position, atol=1e-6)
    np.testing.assert_allclose(found[:3, 2], np.array(direction) / np.linalg.norm(direction), atol=1e-6)
    assert found[2, 1] < 0.0  # the picture's down is down


def test_what_five_joints_cannot_hold_is_said_with_the_nearest() -> None:
    with pytest.raises(UnsafeError, match=r"the nearest direction that the five joints can reach is \((.*)\)") as refused:
        compute_joints_from_direction(RIG, (400.0, 30.0, -42.0), (-1.0, 0.5, 0.0))
    nearest = tuple(float(word) for word in str(refused.value).rpartition("(")[2].rstrip(")").split(","))
    compute_joints_from_direction(RIG, (400.0, 30.0, -42.0), nearest)  # which can be had
    with pytest.raises(UnsafeError, match=r"out of reach .* the nearest reachable position is \((.*)\) mm"):
        compute_joints_from_direction(RIG, (100.0, 0.0, -42.0), (-1.0, 0.0, 0.0))
    with pytest.raises(UnsafeError, match="straight up or down"):
        compute_joints_from_direction(RIG, (400.0, 0.0, -42.0), (0.0, 0.0, -1.0))
