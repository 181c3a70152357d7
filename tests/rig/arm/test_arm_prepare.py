"""The arm on a fake bus: how it is prepared, its health, and how it is opened."""

from dataclasses import replace

import pytest

from rhizotwin.rig.arm.arm import open_arm
from rhizotwin.rig.devices import Arm
from rhizotwin.rig.errors import LostError, NoAnswerError, UnsafeError
from rhizotwin.rig.rig_file import ArmPart
from tests.rig.arm.fake_bus import BOTH, COUNTS_PER_DEG, PART, arm_and_bus
from tests.rig.fake_time import Time


def test_satisfies_the_protocol() -> None:
    arm: Arm = arm_and_bus()[0]
    assert arm.describe()


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
    bus.limp_always = {3}
    with pytest.raises(LostError, match=r"wrist pitch \(servo 3\) has lost its torque"):
        arm.prepare()
    assert not arm.holds()


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


class _Wire:
    """A line on which nothing answers; keeps what was written."""

    def __init__(self) -> None:
        self.clock = Time()
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
