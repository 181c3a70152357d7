"""The arm's moves on a fake bus: what is sent, what is refused, every way a move may go wrong."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rhizotwin.rig.errors import LostError, NoAnswerError, RigError, UnsafeError
from tests.rig.arm.fake_bus import BOTH, COUNTS_PER_DEG, IDS, MIDDLE, MIDDLE_COUNTS, PART, arm_and_bus


@BOTH
def test_moves_all_joints_with_one_command_and_asks_nothing_meanwhile(tells: bool) -> None:
    arm, bus = arm_and_bus(tells=tells)
    wanted = (30.0, 24.0, -60.0, 12.0, 0.0)
    read = arm.move_to(wanted)
    targets = {6: 625, 5: 410, 4: 250, 3: 540, 2: 500}
    assert bus.moves == [(targets, pytest.approx(1.0))]
    np.testing.assert_allclose(read, wanted, atol=0.121)
    np.testing.assert_allclose(arm.read_joints(), wanted, atol=0.121)
    assert bus.polled_in_motion == 0
    assert bus.names() == ["move"]


@dataclass(frozen=True, kw_only=True)
class _Refused:
    name: str
    joints_deg: tuple[float, ...]
    says: str


@pytest.mark.parametrize(
    "case",
    [
        _Refused(name="above", joints_deg=(0, 91.3, 0, 0, 0), says=r"servo 5\) cannot go to 91\.30 deg, its limits are -86 to 91"),
        _Refused(name="below", joints_deg=(-90.01, 0, 0, 0, 0), says=r"base \(servo 6\) cannot go to -90\.01 deg"),
        _Refused(name="not a number", joints_deg=(0, 0, float("nan"), 0, 0), says="elbow .* cannot go to nan"),
        _Refused(name="endless", joints_deg=(0, 0, 0, float("inf"), 0), says="wrist pitch .* cannot go to inf"),
        _Refused(name="counts", joints_deg=(0, 0, 0, -118.5, 0), says=r"wrist pitch .* would be at -4 counts, outside 0 to 1000"),
        _Refused(name="too few", joints_deg=(0, 0, 0, 0), says="4 joint angles were given but it has 5 joints"),
        _Refused(name="too many", joints_deg=(0, 0, 0, 0, 0, 0), says="6 joint angles"),
    ],
    ids=lambda case: case.name,
)
def test_refuses_before_anything_is_sent(case: _Refused) -> None:
    arm, bus = arm_and_bus()
    with pytest.raises(UnsafeError, match=case.says):
        arm.move_to(case.joints_deg)
    assert bus.log == []


def test_refuses_to_move_unprepared_or_relaxed() -> None:
    arm, bus = arm_and_bus(prepared=False)
    with pytest.raises(LostError, match="prepare it"):
        arm.move_to(MIDDLE)
    arm.prepare()
    arm.relax()
    assert not any(bus.on.values())
    with pytest.raises(LostError, match="prepare it"):
        arm.move_to(MIDDLE)


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


def test_a_long_move_is_made_in_parts_on_one_straight_way() -> None:
    arm, bus = arm_and_bus(part=replace(PART, max_speed_deg_per_s=1.0))
    arm.move_to((90.0, -45.0, 0.0, 0.0, 0.0))
    assert [duration_s for _, duration_s in bus.moves] == [pytest.approx(30.0)] * 3
    assert [targets[6] for targets, _ in bus.moves] == [625, 750, 875]
    assert [targets[5] for targets, _ in bus.moves] == pytest.approx([572.5, 635, 697.5], abs=0.5)


def test_a_bus_may_ask_for_slower_moves() -> None:
    arm, bus = arm_and_bus(tells=False)
    bus.least_move_s = 2.0
    arm.move_to((3.0, 0.0, 0.0, 0.0, 0.0))
    assert bus.moves[0][1] == 2.0


def test_sag_and_dead_band_within_the_tolerance_count_as_arrived() -> None:
    arm, bus = arm_and_bus()
    bus.sag = {5: -12}
    read = arm.move_to((0.0, 24.0, 0.0, 0.0, 0.0))
    assert read[1] == pytest.approx(24.0 + 12 * 0.24)
    assert bus.names() == ["move"]
    bus.sag = {5: -13}
    with pytest.raises(UnsafeError, match=r"shoulder \(servo 5\) was sent to 48\.0 deg but stands at 51\.1 deg"):
        arm.move_to((0.0, 48.0, 0.0, 0.0, 0.0))


@BOTH
def test_a_blocked_joint_stops_the_arm_and_is_named(tells: bool) -> None:
    arm, bus = arm_and_bus(tells=tells)
    bus.blocked = {4: 560.0}
    with pytest.raises(UnsafeError, match=r"elbow \(servo 4\) was sent to 60\.0 deg but stands at 14\.4 deg: it is blocked"):
        arm.move_to((10.0, 0.0, 60.0, 0.0, 0.0))
    assert bus.names() == ["move", "stop"]
    assert arm.holds()
    # From where it stands the caller may go elsewhere.
    bus.blocked = {}
    arm.move_to(MIDDLE)


@BOTH
def test_a_lost_command_is_repeated_once(tells: bool) -> None:
    arm, bus = arm_and_bus(tells=tells)
    bus.lose_moves = 1
    np.testing.assert_allclose(arm.move_to((2.0, 0.0, 0.0, 0.0, 0.0)), (2.0, 0.0, 0.0, 0.0, 0.0), atol=0.13)
    assert len(bus.moves) == 2
    bus.moves.clear()
    bus.lose_moves = 5
    with pytest.raises(UnsafeError, match=r"base .* was sent to 30"):
        arm.move_to((30.0, 0.0, 0.0, 0.0, 0.0))
    assert len(bus.moves) == 2


def test_a_joint_in_its_dead_band_is_not_commanded_again_and_again() -> None:
    arm, bus = arm_and_bus()
    bus.lose_moves = 1
    arm.move_to((0.5, 0.0, 0.0, 0.0, 0.0))
    assert len(bus.moves) == 1


def test_an_arm_that_still_creeps_when_its_time_is_over_is_waited_for() -> None:
    arm, bus = arm_and_bus()
    clock = bus.clock

    def late(seconds: float) -> None:
        clock.at_s += seconds if seconds < 0.2 else seconds - 0.5

    clock.sleep = late
    np.testing.assert_allclose(arm.move_to((60.0, 0.0, 0.0, 0.0, 0.0)), (60.0, 0.0, 0.0, 0.0, 0.0), atol=0.13)


def test_an_arm_that_never_rests_is_stopped() -> None:
    arm, bus = arm_and_bus()

    def start_drifting(targets: Mapping[int, int], duration_s: float) -> None:  # noqa: ARG001
        bus.log.append(("move", None))
        bus._to = {}
        bus.drift = {3: 2.0}

    bus.move = start_drifting
    with pytest.raises(UnsafeError, match=r"wrist pitch .* does not come to rest"):
        arm.move_to((60.0, 0.0, 0.0, 0.0, 0.0))
    assert bus.names() == ["move", "stop"]


@pytest.mark.parametrize("error", [NoAnswerError("x"), LostError("x"), KeyboardInterrupt()], ids=["silent", "unplugged", "Ctrl-C"])
@pytest.mark.parametrize("stop_fails", [False, True], ids=["stops", "stop fails, too"])
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


def test_torque_lost_on_the_way_is_told_as_such() -> None:
    arm, bus = arm_and_bus()
    bus.limp_on_move = 5
    with pytest.raises(LostError, match=r"shoulder \(servo 5\) has lost its torque.*brown-out"):
        arm.move_to((60.0, 0.0, 0.0, 0.0, 0.0))
    assert bus.names() == ["move", "stop"]
    assert not arm.holds()


def test_torque_lost_at_rest_is_found_before_the_next_move() -> None:
    arm, bus = arm_and_bus()
    assert arm.holds()
    bus.on[2] = False
    assert not arm.holds()
    with pytest.raises(LostError, match=r"wrist roll \(servo 2\)"):
        arm.move_to((60.0, 0.0, 0.0, 0.0, 0.0))
    assert bus.moves == []


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
