"""The arm on a fake bus: its moves, how it is prepared, its health, and every way in which these may go wrong."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rhizotwin.rig.errors import LostError, NoAnswerError, RigError, UnsafeError
from rhizotwin.rig.rig_file import Joint
from tests.rig.arm.fake_bus import BOTH, COUNTS_PER_DEG, IDS, MIDDLE, MIDDLE_COUNTS, PART, arm_and_bus


@BOTH
def test_moves_all_joints_by_one_command_and_asks_nothing(tells: bool) -> None:
    arm, bus = arm_and_bus(tells=tells)
    wanted = (30.0, 24.0, -60.0, 12.0, 0.0)
    read = arm.move_to(wanted)
    targets = {6: 625, 5: 410, 4: 250, 3: 540, 2: 500}
    assert bus.moves == [(targets, pytest.approx(1.0))]
    np.testing.assert_allclose(read, wanted, atol=0.121)
    np.testing.assert_allclose(arm.read_joints(), wanted, atol=0.121)
    assert bus.polled_in_motion == 0
    assert bus.names() == ["move"]


REFUSED = {
    "above": ((0, 91.3, 0, 0, 0), r"servo 5\) cannot be set to 91\.30 deg, because its limits are -86 to 91"),
    "not a number": ((0, 0, float("nan"), 0, 0), "elbow .* cannot be set to nan"),
    "counts": ((0, 0, 0, -118.5, 0), r"wrist pitch .* would be at -4 counts, outside 0 to 1000"),
    "too few": ((0, 0, 0, 0), "4 joint angles are given but the arm has 5 joints"),
}


@pytest.mark.parametrize(("joints_deg", "says"), REFUSED.values(), ids=REFUSED)
def test_refuses_before_anything_is_sent(joints_deg: tuple[float, ...], says: str) -> None:
    arm, bus = arm_and_bus()
    with pytest.raises(UnsafeError, match=says):
        arm.move_to(joints_deg)
    assert bus.log == []


def test_refuses_to_move_unprepared_or_relaxed() -> None:
    arm, bus = arm_and_bus(prepared=False)
    with pytest.raises(LostError, match="prepare the arm"):
        arm.move_to(MIDDLE)
    arm.prepare()
    arm.relax()
    assert not any(bus.on.values())
    with pytest.raises(LostError, match="prepare the arm"):
        arm.move_to(MIDDLE)


def test_a_filter_wheel_that_is_blocked_is_stopped() -> None:
    arm, bus = arm_and_bus(part=replace(PART, filter=Joint(servo=1)))
    bus.at[1] = 500.0
    arm.turn_filter(45.0)
    assert bus.log[-1] == ("positions", None)
    bus.blocked = {1: 550.0}
    with pytest.raises(UnsafeError, match=r"filter wheel \(servo 1\) was commanded to 45 deg but is at 12\.0 deg"):
        arm.turn_filter(45.0)
    assert bus.log[-1] == ("stop", (1,))


@settings(max_examples=40)
@given(st.tuples(*[st.floats(joint.min_deg, joint.max_deg) for joint in PART.joints]), st.floats(1.0, 270.0))
def test_no_joint_is_ever_faster_than_allowed(joints_deg: tuple[float, ...], speed_deg_per_s: float) -> None:
    arm, bus = arm_and_bus(part=replace(PART, max_speed_deg_per_s=speed_deg_per_s))
    if abs(joints_deg[3]) > 117.0:
        return
    arm.move_to(joints_deg)
    at = dict(MIDDLE_COUNTS)
    for targets, duration_s in bus.moves:
        assert duration_s >= 0.2 - 1e-9 or len(bus.moves) > 1
        ways = {servo: abs(counts - at[servo]) for servo, counts in targets.items()}
        assert max(ways.values()) / COUNTS_PER_DEG <= speed_deg_per_s * duration_s + 0.25
        at = dict(targets)
    wanted = {j.servo: j.zero_counts + j.sign * a * j.counts_per_deg for j, a in zip(PART.joints, joints_deg, strict=True)}
    assert all(abs(at[servo] - wanted[servo]) <= 0.5 + 1e-9 for servo in IDS)


def test_a_long_move_in_parts_and_a_bus_that_demands_slow_ones() -> None:
    arm, bus = arm_and_bus(part=replace(PART, max_speed_deg_per_s=1.0))
    arm.move_to((90.0, -45.0, 0.0, 0.0, 0.0))
    assert [duration_s for _, duration_s in bus.moves] == [pytest.approx(30.0)] * 3
    assert [targets[6] for targets, _ in bus.moves] == [625, 750, 875]
    assert [targets[5] for targets, _ in bus.moves] == pytest.approx([572.5, 635, 697.5], abs=0.5)
    arm, bus = arm_and_bus(tells=False)
    bus.least_move_s = 2.0
    arm.move_to((3.0, 0.0, 0.0, 0.0, 0.0))
    assert bus.moves[0][1] == 2.0


def test_sag_within_the_tolerance_counts_as_arrived() -> None:
    arm, bus = arm_and_bus()
    bus.sag = {5: -12}
    read = arm.move_to((0.0, 24.0, 0.0, 0.0, 0.0))
    assert read[1] == pytest.approx(24.0 + 12 * 0.24)
    assert bus.names() == ["move"]


@BOTH
def test_a_blocked_joint_stops_the_arm_and_is_named(tells: bool) -> None:
    arm, bus = arm_and_bus(tells=tells)
    bus.blocked = {4: 560.0}
    with pytest.raises(UnsafeError, match=r"elbow \(servo 4\) was commanded to 60\.0 deg but is at 14\.4 deg: it is blocked"):
        arm.move_to((10.0, 0.0, 60.0, 0.0, 0.0))
    assert bus.names() == ["move", "stop"]
    assert arm.holds()
    bus.blocked = {}
    arm.move_to(MIDDLE)  # from where it stands


@BOTH
def test_a_lost_command_is_repeated_once(tells: bool) -> None:
    arm, bus = arm_and_bus(tells=tells)
    bus.lose_moves = 1
    np.testing.assert_allclose(arm.move_to((2.0, 0.0, 0.0, 0.0, 0.0)), (2.0, 0.0, 0.0, 0.0, 0.0), atol=0.13)
    assert len(bus.moves) == 2
    bus.moves.clear()
    bus.lose_moves = 5
    with pytest.raises(UnsafeError, match=r"base .* was commanded to 30"):
        arm.move_to((30.0, 0.0, 0.0, 0.0, 0.0))
    assert len(bus.moves) == 2


@pytest.mark.parametrize(("error", "stop_fails"), [(NoAnswerError("x"), False), (KeyboardInterrupt(), True)])
def test_an_error_in_a_move_is_followed_by_one_attempt_to_stop(error: RigError | KeyboardInterrupt, stop_fails: bool) -> None:
    arm, bus = arm_and_bus()
    bus.fail = {"move": error}
    if stop_fails:
        bus.fail["stop"] = NoAnswerError("y")
    with pytest.raises(type(error)) as raised:
        arm.move_to((60.0, 0.0, 0.0, 0.0, 0.0))
    assert raised.value is error
    assert bus.log[-1] == ("stop", IDS)
    assert bus.names().count("stop") == 1


def test_lost_torque_is_named_or_the_heat_that_caused_it() -> None:
    for celsius, error, says in ((30, LostError, "has lost its torque.*voltage drop"), (86, UnsafeError, "is at 86 °C")):
        arm, bus = arm_and_bus()
        bus.limp_on_move = 5
        bus.celsius[5] = celsius
        with pytest.raises(error, match=rf"shoulder \(servo 5\) {says}"):
            arm.move_to((60.0, 0.0, 0.0, 0.0, 0.0))
        assert bus.names() == ["move", "stop"]
    assert not arm.holds()


def test_where_torque_cannot_be_read_a_fallen_joint_tells_it() -> None:
    arm, bus = arm_and_bus(tells=False)
    arm.move_to((0.0, 30.0, 0.0, 0.0, 0.0))
    assert arm.holds()
    bus.moves.clear()
    bus._to = {}
    bus.at[5] -= 40
    assert not arm.holds()
    with pytest.raises(LostError, match=r"shoulder \(servo 5\) has lost its torque"):
        arm.move_to(MIDDLE)
    assert bus.moves == []
    arm.prepare()
    arm.move_to(MIDDLE)


@BOTH
def test_prepare_commands_the_present_place_before_the_torque(tells: bool) -> None:
    arm, bus = arm_and_bus(tells=tells, prepared=False)
    bus.at = {6: 437.0, 5: 520.0, 4: 611.0, 3: 480.0, 2: 502.0}
    present = {servo: round(at) for servo, at in bus.at.items()}
    arm.prepare()
    assert [(name, what) for name, what in bus.log if name != "positions"] == [("move", present), ("load", True)]
    assert bus.moves[0][1] >= 1.0
    assert bus.at == present
    assert arm.holds()


STANDS_WRONG = [
    (4, -3, r"elbow \(servo 4\) is at -120\.7 deg \(-3 counts\).*by hand"),
    (6, 60, r"base \(servo 6\) is at -105\.6 deg.*-90 to 90 deg"),
]


@pytest.mark.parametrize(("servo", "counts", "says"), STANDS_WRONG)
def test_prepare_refuses_a_servo_that_stands_where_it_may_not(servo: int, counts: int, says: str) -> None:
    arm, bus = arm_and_bus(prepared=False)
    bus.at[servo] = counts
    with pytest.raises(UnsafeError, match=says):
        arm.prepare()
    assert bus.names() == []
    assert not arm.holds()
    bus.at[servo] = 500
    bus.at[6] = 500 + 92.0 * COUNTS_PER_DEG  # sagged just beyond its limit
    arm.prepare()
    assert arm.holds()


def test_prepare_refuses_supply_motion_and_torque_that_stays_off() -> None:
    arm, bus = arm_and_bus(prepared=False)
    for volt in (6.4, 8.6):
        bus.volt = volt
        with pytest.raises(UnsafeError, match=rf"{volt:.2f} V, outside 6\.5 to 8\.4 V"):
            arm.prepare()
    assert bus.log == []
    bus.volt = 7.5
    bus.drift = {4: 2.0}
    with pytest.raises(UnsafeError, match=r"elbow .* does not come to rest"):
        arm.prepare()
    assert bus.names() == []
    arm, bus = arm_and_bus(prepared=False)
    bus.limp_always = {3}
    with pytest.raises(LostError, match=r"wrist pitch \(servo 3\) has lost its torque"):
        arm.prepare()
    assert not arm.holds()


def test_prepare_stops_when_a_joint_leaves_its_place() -> None:
    arm, bus = arm_and_bus(prepared=False)
    bus.blocked = {5: 550.0}
    with pytest.raises(UnsafeError, match=r"shoulder \(servo 5\) moved from 0\.0 to -9\.6 deg"):
        arm.prepare()
    assert bus.names()[-1] == "stop"
    assert not arm.holds()


def test_health_watches_temperature_supply_and_torque() -> None:
    arm, bus = arm_and_bus()
    arm.health()
    for servo, celsius, volt, on, error, says in (
        (3, 66, 7.5, True, UnsafeError, r"wrist pitch \(servo 3\) is at 66 °C, above 65 °C"),
        (3, 65, 6.0, True, UnsafeError, r"6\.00 V"),
        (6, 41, 7.0, False, LostError, r"base \(servo 6\)"),
    ):
        bus.celsius[servo], bus.volt, bus.on[servo] = celsius, volt, on
        with pytest.raises(error, match=says):
            arm.health()
    arm.relax()
    arm.health()  # that a limp arm has no torque is no fault
    assert not any(bus.on.values())
