"""Driver of the robot arm, which has five joints and can use either servo protocol.

Angles are in degrees. The driver enforces limits, controls the speed, verifies every move, and stops the arm on errors.
Servos report neither the end nor the failure of a move. Therefore the driver computes the duration of each move from
its distance, waits for that time without communication, and then compares the position of every joint with the
commanded position. This detects joints that are blocked, too warm, or without torque.
"""

import math

from rhizotwin.rig.arm.lsc_board import LscBoard
from rhizotwin.rig.arm.lx_bus import LxBus
from rhizotwin.rig.arm.servo_bus import MAX_COUNTS, MAX_MOVE_S, MIN_COUNTS, ServoBus
from rhizotwin.rig.clock import Clock
from rhizotwin.rig.errors import LostError, RigError, UnsafeError
from rhizotwin.rig.rig_file import JOINT_NAMES, JOINTS, ArmPart, Joint
from rhizotwin.rig.serial_line.port import Wire

_HOLD_S = 1.0
"""Duration of the move to the measured position that switches the torque on, s. The arm may have sagged since the
measurement, and a slow move lifts it gently."""
_STILL_COUNTS = 1
_STILL_PAUSE_S = 0.1
_STILL_LIMIT_S = 5.0
_COMMAND_TRIES = 2
_UNMOVED_COUNTS = 2
_DEAD_COUNTS = 4
"""Maximum distance between a servo and its target, in counts of 0.24 deg, at which the dead band and the sag can
prevent a motion. If a target is farther away and no servo has moved, the command is repeated."""

Counts = dict[int, int]


def open_arm(port: Wire, part: ArmPart, clock: Clock) -> "ServoArm":
    """Create the driver of the arm for the protocol given in the rig file, without sending anything.

    Parameters
    ----------
    port : Wire
        Port of the arm.
    part : ArmPart
        Protocol, joints and limits.
    clock : Clock
        Clock for waiting times.

    Returns
    -------
    ServoArm
        Driver of the arm.
    """
    bus: ServoBus = LxBus(port, echo=part.echo) if part.protocol == "lx" else LscBoard(port)
    return ServoArm(bus, part, clock)


class ServoArm:
    """Robot arm that positions the camera.

    It implements `rig.devices.Arm`.

    Parameters
    ----------
    bus
        Bus with the servos.
    part
        Section of the rig file that describes the arm.
    clock
        Clock for waiting times.
    """

    def __init__(self, bus: ServoBus, part: ArmPart, clock: Clock) -> None:
        self._bus = bus
        self._part = part
        self._clock = clock
        self._ids = tuple(joint.servo for joint in part.joints)
        self._prepared = False
        self._rests_at: Counts | None = None
        """Servo positions at the end of the last completed move, in counts, keyed by servo number. It is None if the
        torque is off or the last move failed."""

    def describe(self) -> str:
        """Return a description of the bus, including its voltage and the warmest servo."""
        words = f"{self._bus.describe()}, {len(self._ids)} servos, {self._bus.voltage_v(self._ids):.1f} V"
        temperatures_c = self._bus.temperatures_c(self._ids)
        if temperatures_c is None:
            return words + ", temperatures unknown"
        warmest = max(temperatures_c, key=temperatures_c.__getitem__)
        return words + f", warmest {self._name(warmest)} {temperatures_c[warmest]} °C"

    def prepare(self) -> None:
        """Check that all servos reply and are within their limits, and switch the torque on without moving the arm.

        Every servo is commanded to its measured position before its torque is switched on, so that the arm does not
        jump.

        Raises
        ------
        NoAnswerError
            If a servo does not answer.
        UnsafeError
            If the supply or a temperature is out of range, a joint is outside its limits, or the arm moved during the
            procedure.
        """
        self._prepared = False
        self._rests_at = None
        self._check_supply_and_warmth()
        present = self._still()
        for joint in self._part.joints:
            self._check_standing(joint, present[joint.servo])
        try:
            duration_s = max(_HOLD_S, self._bus.least_move_s)
            self._bus.move(present, duration_s)
            self._clock.sleep(duration_s)
            self._bus.load(self._ids, True)
            now = self._still()
            if worst := self._off_target(present, now):
                raise UnsafeError(
                    f"arm: the {self._name(worst.servo)} moved from {_to_deg(worst, present[worst.servo]):.1f} to"
                    f" {_to_deg(worst, now[worst.servo]):.1f} deg while its torque was switched on; support the arm, then try again"
                )
            self._prepared = True
            self._rests_at = now
            self._check_torque()
        except BaseException:
            self._stop_once(self._ids)
            raise

    def read_joints(self) -> tuple[float, ...]:
        """Return the measured joint angles, deg."""
        return self._joints_deg(self._bus.positions(self._ids))

    def holds(self) -> bool:
        """Return whether the torque of every joint is still on.

        If the protocol does not report the torque, the measured position is compared with that at the end of the last
        move, because an arm without torque drops.
        """
        return self._prepared and self._limp() is None

    def move_to(self, joints_deg: tuple[float, ...]) -> tuple[float, ...]:
        """Move all joints simultaneously along a straight line in joint space, and verify the result.

        The method waits for the end of the move and returns the measured angles. A command that caused no motion at all
        may have been lost in transmission, and is repeated once. Moves longer than the protocols permit are divided. On
        any error the arm is stopped in its present position, with its torque on.

        Raises
        ------
        UnsafeError
            If an angle is beyond its joint's limits (nothing is sent in this case). After the move, if a joint has not
            reached its target or is too warm, or if the supply voltage is out of range.
        LostError
            If the arm was not prepared, or a servo has lost its torque.
        """
        target = self._checked_counts(joints_deg)
        if not self._prepared:
            raise LostError("arm: its torque is off; prepare the arm before it is moved")
        self._check_torque()
        here = start = self._still()
        way_deg = max(abs(target[j.servo] - start[j.servo]) / j.counts_per_deg for j in self._part.joints)
        total_s = max(way_deg / self._part.max_speed_deg_per_s, self._bus.least_move_s)
        parts = math.ceil(total_s / MAX_MOVE_S)
        self._rests_at = None
        try:
            for k in range(1, parts + 1):
                to = {servo: round(start[servo] + (target[servo] - start[servo]) * k / parts) for servo in self._ids}
                here = self._move_one(here, to, total_s / parts)
        except BaseException:
            self._stop_once(self._ids)
            raise
        self._rests_at = here
        return self._joints_deg(here)

    def turn_filter(self, angle_deg: float) -> None:
        """Rotate the filter wheel in front of the lens to an angle, and check that the angle was reached.

        A wheel that does not reach it is stopped.

        Raises
        ------
        UnsafeError
            If the angle is beyond the wheel's limits (nothing is sent), or the wheel does not reach its target.
        LostError
            If the arm was not prepared.
        """
        wheel = self._part.filter
        if wheel is None or not wheel.min_deg <= angle_deg <= wheel.max_deg:
            raise UnsafeError(f"arm: the filter wheel cannot be set to {angle_deg:g} deg; correct [arm.filter] or filter_deg of the band")
        if not self._prepared:
            raise LostError("arm: its torque is off; prepare the arm before the filter wheel is turned")
        goal = round(wheel.zero_counts + wheel.sign * angle_deg * wheel.counts_per_deg)
        way_deg = abs(goal - self._bus.positions((wheel.servo,))[wheel.servo]) / wheel.counts_per_deg
        duration_s = min(MAX_MOVE_S, max(way_deg / self._part.max_speed_deg_per_s, self._bus.least_move_s))
        try:
            self._bus.move({wheel.servo: goal}, duration_s)
            self._clock.sleep(duration_s + _STILL_PAUSE_S)
            there = self._bus.positions((wheel.servo,))[wheel.servo]
            if abs(there - goal) / wheel.counts_per_deg > self._part.tolerance_deg:
                raise UnsafeError(
                    f"arm: the filter wheel (servo {wheel.servo}) was commanded to {angle_deg:g} deg but is at "
                    f"{_to_deg(wheel, there):.1f} deg; check that the wheel can move freely and that its cable is connected"
                )
        except BaseException:
            self._stop_once((wheel.servo,))  # a blocked servo overloads the supply
            raise

    def health(self) -> None:
        """Check the supply voltage and the temperatures of the servos, and that the torque of every servo is still on.

        Raises
        ------
        UnsafeError
            If a servo is too warm or the supply voltage is out of range.
        LostError
            If the torque of a servo is off although it was switched on.
        """
        self._check_supply_and_warmth()
        self._check_torque()

    def relax(self) -> None:
        """Switch the torque off. An arm that is not supported drops."""
        self._prepared = False
        self._rests_at = None
        wheel = self._part.filter
        self._bus.load(self._ids if wheel is None else (*self._ids, wheel.servo), False)

    def close(self) -> None:
        """Close the port without changing the torque."""
        self._bus.close()

    def _move_one(self, start: Counts, to: Counts, duration_s: float) -> Counts:
        """Execute a move that is short enough for one command.

        Return the servo positions at its end, in counts.
        """
        tries = 0
        while True:
            self._bus.move(to, duration_s)
            self._clock.sleep(duration_s)
            now = self._still()
            tries += 1
            unmoved = all(abs(now[servo] - start[servo]) <= _UNMOVED_COUNTS for servo in self._ids)
            ignored = unmoved and any(abs(to[servo] - start[servo]) > _DEAD_COUNTS for servo in self._ids)
            worst = self._off_target(to, now)
            if worst is not None:
                # report the cause, if it can be determined, rather than the symptom
                self.health()
            if ignored and tries < _COMMAND_TRIES:
                continue
            if worst is None:
                return now
            raise UnsafeError(
                f"arm: the {self._name(worst.servo)} was commanded to {_to_deg(worst, to[worst.servo]):.1f} deg but is at"
                f" {_to_deg(worst, now[worst.servo]):.1f} deg: it is blocked or overloaded, or its command was damaged."
                " The arm was stopped; clear its path before moving it again"
            )

    def _still(self) -> Counts:
        """Read the servo positions repeatedly until the arm is at rest, and return them in counts."""
        deadline_s = self._clock.now_s() + _STILL_LIMIT_S
        before = self._bus.positions(self._ids)
        while True:
            self._clock.sleep(_STILL_PAUSE_S)
            now = self._bus.positions(self._ids)
            moving = [servo for servo in self._ids if abs(now[servo] - before[servo]) > _STILL_COUNTS]
            if not moving:
                return now
            if self._clock.now_s() > deadline_s:
                raise UnsafeError(
                    f"arm: the {self._name(moving[0])} does not come to rest; let go of the arm, or find the cause of the motion"
                )
            before = now

    def _stop_once(self, servos: tuple[int, ...]) -> None:
        """Try to stop servos after an error. A failure to stop is ignored, so that the original error is reported."""
        try:
            self._bus.stop(servos)
        except RigError:
            return

    def _off_target(self, target: Counts, now: Counts) -> Joint | None:
        """Return the joint with the largest deviation from its target.

        It is None if all joints are within the tolerance.
        """
        off_deg = [abs(now[joint.servo] - target[joint.servo]) / joint.counts_per_deg for joint in self._part.joints]
        worst = max(range(JOINTS), key=off_deg.__getitem__)
        return self._part.joints[worst] if off_deg[worst] > self._part.tolerance_deg else None

    def _check_supply_and_warmth(self) -> None:
        part = self._part
        volt = self._bus.voltage_v(self._ids)
        if not part.min_volt <= volt <= part.max_volt:
            raise UnsafeError(
                f"arm: the servos' supply voltage is {volt:.2f} V, outside {part.min_volt:g} to {part.max_volt:g} V; "
                "check the supply and its cable"
            )
        for servo, celsius in (self._bus.temperatures_c(self._ids) or {}).items():
            if celsius > part.max_celsius:
                raise UnsafeError(
                    f"arm: the {self._name(servo)} is at {celsius} °C, above {part.max_celsius:g} °C; let it cool with the arm at rest"
                )

    def _limp(self) -> int | None:
        """Return the number of a servo whose torque is off.

        It is None if there is none. If the protocol does not report the torque, a servo counts as without torque if it
        has left its position at the end of the last move.
        """
        loaded = self._bus.loaded(self._ids)
        if loaded is not None:
            return next((servo for servo, on in loaded.items() if not on), None)
        fallen = None if self._rests_at is None else self._off_target(self._rests_at, self._bus.positions(self._ids))
        return None if fallen is None else fallen.servo

    def _check_torque(self) -> None:
        if not self._prepared:
            return
        limp = self._limp()
        if limp is not None:
            self._prepared = False
            raise LostError(
                f"arm: the {self._name(limp)} has lost its torque, possibly because of a voltage drop or its overload protection;"
                " check the supply, then prepare the arm again"
            )

    def _check_standing(self, joint: Joint, counts: int) -> None:
        """Raise an error if a joint is outside its limits before it is moved for the first time."""
        angle_deg = _to_deg(joint, counts)
        slack_deg = self._part.tolerance_deg
        if MIN_COUNTS <= counts <= MAX_COUNTS and joint.min_deg - slack_deg <= angle_deg <= joint.max_deg + slack_deg:
            return
        raise UnsafeError(
            f"arm: the {self._name(joint.servo)} is at {angle_deg:.1f} deg ({counts} counts), outside its {joint.min_deg:g} to"
            f" {joint.max_deg:g} deg or {MIN_COUNTS} to {MAX_COUNTS} counts; switch the torque off and move the joint by hand into its "
            "range"
        )

    def _checked_counts(self, joints_deg: tuple[float, ...]) -> Counts:
        if len(joints_deg) != JOINTS:
            raise UnsafeError(f"arm: {len(joints_deg)} joint angles are given but the arm has {JOINTS} joints; nothing was moved")
        counts = {}
        for joint, angle_deg in zip(self._part.joints, joints_deg, strict=True):
            name = self._name(joint.servo)
            if not joint.min_deg <= angle_deg <= joint.max_deg:
                raise UnsafeError(
                    f"arm: the {name} cannot be set to {angle_deg:.2f} deg, because its limits are {joint.min_deg:g} to {joint.max_deg:g} "
                    "deg;"
                    " nothing was moved"
                )
            place = joint.zero_counts + joint.sign * angle_deg * joint.counts_per_deg
            if not MIN_COUNTS <= round(place) <= MAX_COUNTS:
                raise UnsafeError(
                    f"arm: the {name} at {angle_deg:.1f} deg would be at {place:.0f} counts, outside {MIN_COUNTS} to {MAX_COUNTS};"
                    " nothing was moved. Check zero_counts and the limits of the joint in the rig file"
                )
            counts[joint.servo] = round(place)
        return counts

    def _joints_deg(self, counts: Counts) -> tuple[float, ...]:
        return tuple(_to_deg(joint, counts[joint.servo]) for joint in self._part.joints)

    def _name(self, servo: int) -> str:
        return f"{JOINT_NAMES[self._ids.index(servo)]} (servo {servo})"


def _to_deg(joint: Joint, counts: int) -> float:
    return joint.sign * (counts - joint.zero_counts) / joint.counts_per_deg + 0.0  # avoids -0.0
