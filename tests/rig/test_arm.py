"""The arm on servos that misbehave in every way that they can."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.arm import ServoArm, open_arm
from rig.devices import Arm
from rig.errors import LostError, NoAnswerError, RigError, UnsafeError
from rig.rig_file import ArmPart, Joint

IDS = (6, 5, 4, 3, 2)
PART = ArmPart(
    joints=(
        Joint(servo=6, min_deg=-90.0, max_deg=90.0),
        Joint(servo=5, min_deg=-86.0, max_deg=91.0, sign=-1, zero_counts=510.0),
        Joint(servo=4, min_deg=-88.0, max_deg=88.0),
        Joint(servo=3, min_deg=-119.0, max_deg=119.0, zero_counts=490.0),
        Joint(servo=2, min_deg=-112.0, max_deg=112.0),
    ),
    max_speed_deg_per_s=60.0,
    tolerance_deg=3.0,
)
MIDDLE = (0.0, 0.0, 0.0, 0.0, 0.0)
MIDDLE_COUNTS = {6: 500, 5: 510, 4: 500, 3: 490, 2: 500}
COUNTS_PER_DEG = 1000.0 / 240.0


class _Clock:
    def __init__(self) -> None:
        self.time_s = 0.0

    def now_s(self) -> float:
        return self.time_s

    def sleep(self, seconds: float) -> None:
        self.time_s += seconds


class _Bus:
    """Servos that run at uniform speed and do what the tests set; everything that changes something is in ``log``."""

    least_move_s = 0.2

    def __init__(self, clock: _Clock, *, tells: bool = True) -> None:
        self.clock = clock
        self.tells = tells
        self.at: dict[int, float] = dict(MIDDLE_COUNTS)
        self.on = dict.fromkeys(IDS, False)
        self.celsius = dict.fromkeys(IDS, 30)
        self.volt = 7.5
        self.log: list[tuple[str, object]] = []
        self.moves: list[tuple[dict[int, int], float]] = []
        self.polled_in_motion = 0
        self.lose_moves = 0
        self.blocked: dict[int, float] = {}
        self.drift: dict[int, float] = {}
        self.sag: dict[int, int] = {}
        self.fail: dict[str, RigError | KeyboardInterrupt] = {}
        self.limp_on_move: int | None = None
        self._from: dict[int, float] = {}
        self._to: dict[int, float] = {}
        self._began_s = self._ends_s = 0.0

    def move(self, targets: Mapping[int, int], duration_s: float) -> None:
        self._call("move", dict(targets))
        assert 0.0 <= duration_s <= 30.0
        assert all(0 <= counts <= 1000 for counts in targets.values())
        self.moves.append((dict(targets), duration_s))
        if self.lose_moves:
            self.lose_moves -= 1
            return
        self._settle()
        self._from = dict(self.at)
        self._to = {servo: self.blocked.get(servo, counts) for servo, counts in targets.items()}
        self._began_s, self._ends_s = self.clock.time_s, self.clock.time_s + duration_s
        self.on = dict.fromkeys(IDS, True)
        if self.limp_on_move is not None:
            self.on[self.limp_on_move] = False
            self._to[self.limp_on_move] = self.at[self.limp_on_move] - 60.0

    def positions(self, ids: Collection[int]) -> dict[int, int]:
        self._call("positions")
        self.polled_in_motion += self.clock.time_s < self._ends_s - 1e-9
        self._settle()
        for servo, counts_per_read in self.drift.items():
            self.at[servo] += counts_per_read
        return {servo: round(self.at[servo]) + self.sag.get(servo, 0) for servo in ids}

    def voltage_v(self, ids: Collection[int]) -> float:
        assert tuple(ids) == IDS
        return self.volt

    def temperatures_c(self, ids: Collection[int]) -> dict[int, int] | None:
        return {servo: self.celsius[servo] for servo in ids} if self.tells else None

    def loaded(self, ids: Collection[int]) -> dict[int, bool] | None:
        return {servo: self.on[servo] for servo in ids} if self.tells else None

    def load(self, ids: Collection[int], on: bool) -> None:
        self._call("load", on)
        self.on.update(dict.fromkeys(ids, on))

    def stop(self, ids: Collection[int]) -> None:
        self._call("stop", tuple(ids))
        self._settle()
        self._to = {}

    def describe(self) -> str:
        return "servos"

    def close(self) -> None:
        self._call("close")

    def names(self) -> list[str]:
        return [name for name, _ in self.log if name != "positions"]

    def _call(self, name: str, what: object = None) -> None:
        self.log.append((name, what))
        if name in self.fail:
            raise self.fail[name]

    def _settle(self) -> None:
        duration_s = self._ends_s - self._began_s
        part = 1.0 if duration_s <= 0.0 else min((self.clock.time_s - self._began_s) / duration_s, 1.0)
        for servo, to in self._to.items():
            self.at[servo] = self._from[servo] + (to - self._from[servo]) * part


def arm_and_bus(*, tells: bool = True, prepared: bool = True, part: ArmPart = PART) -> tuple[ServoArm, _Bus]:
    clock = _Clock()
    bus = _Bus(clock, tells=tells)
    arm = ServoArm(bus, part, clock)
    if prepared:
        arm.prepare()
        bus.log.clear()
        bus.moves.clear()
    return arm, bus


BOTH = pytest.mark.parametrize("tells", [True, False], ids=["tells torque", "cannot tell"])


def test_satisfies_the_protocol() -> None:
    arm: Arm = arm_and_bus()[0]
    assert arm.describe()


# ---------------------------------------------------------------------------------------------------------------- preparing


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


@pytest.mark.parametrize(
    ("servo", "counts", "says"),
    [
        (4, -3, r"elbow \(servo 4\) stands at -120\.7 deg \(-3 counts\).*by hand"),
        (4, 1004, r"elbow \(servo 4\).*1004 counts"),
        (6, 60, r"base \(servo 6\) stands at -105\.6 deg.*-90 to 90 deg"),
    ],
)
def test_prepare_refuses_a_servo_that_stands_where_it_may_not(servo: int, counts: int, says: str) -> None:
    arm, bus = arm_and_bus(prepared=False)
    bus.at[servo] = counts
    with pytest.raises(UnsafeError, match=says):
        arm.prepare()
    assert bus.names() == []
    assert not arm.holds()


def test_prepare_accepts_a_joint_that_sagged_just_beyond_its_limit() -> None:
    arm, bus = arm_and_bus(prepared=False)
    bus.at[6] = 500 + 92 * COUNTS_PER_DEG
    arm.prepare()
    assert arm.holds()


@pytest.mark.parametrize(("volt", "shown"), [(6.4, "6.40 V"), (8.6, "8.60 V")])
def test_prepare_refuses_a_wrong_supply(volt: float, shown: str) -> None:
    arm, bus = arm_and_bus(prepared=False)
    bus.volt = volt
    with pytest.raises(UnsafeError, match=rf"{shown}, outside 6\.5 to 8\.4 V"):
        arm.prepare()
    assert bus.log == []


def test_prepare_refuses_an_arm_that_is_being_moved() -> None:
    arm, bus = arm_and_bus(prepared=False)
    bus.drift = {4: 2.0}
    with pytest.raises(UnsafeError, match=r"elbow .* does not come to rest"):
        arm.prepare()
    assert bus.names() == []


@BOTH
def test_prepare_stops_when_a_joint_leaves_its_place(tells: bool) -> None:
    arm, bus = arm_and_bus(tells=tells, prepared=False)
    bus.blocked = {5: 550.0}
    with pytest.raises(UnsafeError, match=r"shoulder \(servo 5\) went from 0\.0 to -9\.6 deg"):
        arm.prepare()
    assert bus.names()[-1] == "stop"
    assert not arm.holds()


def test_prepare_names_a_servo_whose_torque_stays_off() -> None:
    arm, bus = arm_and_bus(prepared=False)
    bus.load = lambda ids, on: bus.on.update({3: False})  # type: ignore[method-assign] # noqa: ARG005
    with pytest.raises(LostError, match=r"wrist pitch \(servo 3\) has lost its torque"):
        arm.prepare()
    assert not arm.holds()


# ---------------------------------------------------------------------------------------------------------------- moving


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
        clock.time_s += seconds if seconds < 0.2 else seconds - 0.5

    clock.sleep = late  # type: ignore[method-assign]
    np.testing.assert_allclose(arm.move_to((60.0, 0.0, 0.0, 0.0, 0.0)), (60.0, 0.0, 0.0, 0.0, 0.0), atol=0.13)


def test_an_arm_that_never_rests_is_stopped() -> None:
    arm, bus = arm_and_bus()

    def start_drifting(targets: Mapping[int, int], duration_s: float) -> None:  # noqa: ARG001
        bus.log.append(("move", None))
        bus._to = {}
        bus.drift = {3: 2.0}

    bus.move = start_drifting  # type: ignore[method-assign]
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


# ---------------------------------------------------------------------------------------------------------------- health


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


def test_health_watches_temperature_supply_and_torque() -> None:
    arm, bus = arm_and_bus()
    arm.health()
    bus.celsius[3] = 66
    with pytest.raises(UnsafeError, match=r"wrist pitch \(servo 3\) is at 66 °C, above 65 °C"):
        arm.health()
    bus.celsius[3] = 65
    bus.volt = 6.0
    with pytest.raises(UnsafeError, match=r"6\.00 V"):
        arm.health()
    bus.volt = 7.0
    bus.on[6] = False
    with pytest.raises(LostError, match=r"base \(servo 6\)"):
        arm.health()


def test_health_of_a_limp_arm_is_no_matter_of_torque() -> None:
    arm, bus = arm_and_bus()
    arm.relax()
    arm.health()
    assert not any(bus.on.values())


def test_a_servo_that_grew_too_warm_on_the_way_is_the_cause_that_is_told() -> None:
    arm, bus = arm_and_bus()
    bus.limp_on_move = 5
    bus.celsius[5] = 86
    with pytest.raises(UnsafeError, match=r"shoulder \(servo 5\) is at 86 °C"):
        arm.move_to((60.0, 0.0, 0.0, 0.0, 0.0))


def test_describe_tells_voltage_and_the_warmest_servo() -> None:
    arm, bus = arm_and_bus()
    bus.celsius[4] = 41
    assert arm.describe() == "servos, 5 servos, 7.5 V, warmest elbow (servo 4) 41 °C"
    assert arm_and_bus(tells=False)[0].describe() == "servos, 5 servos, 7.5 V, temperatures unknown"


# ---------------------------------------------------------------------------------------------------------------- on the wire


class _Wire:
    """A line on which nothing answers; keeps what was written."""

    def __init__(self) -> None:
        self.clock = _Clock()
        self.sent = b""
        self.closed = False

    def write(self, data: bytes) -> None:
        self.sent += data

    def read(self, timeout_s: float) -> bytes:
        self.clock.sleep(timeout_s)
        return b""

    def discard_input(self) -> None:
        pass

    def close(self) -> None:
        self.closed = True


@pytest.mark.parametrize(
    ("part", "first_frame", "says"),
    [
        (replace(PART, protocol="lx"), "55 55 06 03 1c da", "servo 6 does not answer"),
        (replace(PART, protocol="lx", echo="yes"), "55 55 06 03 1c da", "adapter's echo"),
        (replace(PART, protocol="lsc"), "55 55 08 15 05 06 05 04 03 02", "board does not answer"),
    ],
    ids=["lx", "lx with echo", "lsc"],
)
def test_open_arm_talks_the_protocol_of_the_rig_file(part: ArmPart, first_frame: str, says: str) -> None:
    wire = _Wire()
    arm = open_arm(wire, part, wire.clock)
    assert wire.sent == b""
    with pytest.raises(NoAnswerError, match=says):
        arm.read_joints()
    assert wire.sent.startswith(bytes.fromhex(first_frame))
    arm.close()
    assert wire.closed
