"""The arm as five joints in degrees, with either servo protocol.

Limits, speed, verification, and stopping where something is wrong.

Servos say neither that a move is done nor that it failed. So a move is given a duration that follows from its distance,
the arm waits for that long without asking anything, and then compares where every joint stands with where it was sent.
A joint that is blocked, too warm, or has lost its torque shows there.
"""

import math

from rhizotwin.rig.arm.lsc_board import LscBoard
from rhizotwin.rig.arm.lx_bus import LxBus
from rhizotwin.rig.arm.servo_bus import MAX_COUNTS, MAX_MOVE_S, MIN_COUNTS, ServoBus
from rhizotwin.rig.clock import Clock
from rhizotwin.rig.errors import LostError, RigError, UnsafeError
from rhizotwin.rig.rig_file import JOINTS, ArmPart, Joint
from rhizotwin.rig.serial_line.port import Wire

JOINT_NAMES = ("base", "shoulder", "elbow", "wrist pitch", "wrist roll")

_HOLD_S = 1.0
"""Torque comes on with a move to the present position; if the arm sagged since it was read, it is lifted in this time,
not in a jerk."""
_STILL_COUNTS = 1
_STILL_PAUSE_S = 0.1
_STILL_LIMIT_S = 5.0
_COMMAND_TRIES = 2
_UNMOVED_COUNTS = 2
_DEAD_COUNTS = 4
"""A joint with a smaller remaining distance may not move, because of dead band and sag."""

Counts = dict[int, int]


def open_arm(port: Wire, part: ArmPart, clock: Clock) -> "ServoArm":
    """Return the arm on an open port, with the protocol that the rig file names; nothing is sent yet.

    Parameters
    ----------
    port : Wire
        Its line.
    part : ArmPart
        Protocol, joints and limits.
    clock : Clock
        For the waits.

    Returns
    -------
    ServoArm
        The arm.
    """
    bus: ServoBus = LxBus(port, echo=part.echo) if part.protocol == "lx" else LscBoard(port)
    return ServoArm(bus, part, clock)


class ServoArm:
    """The arm that holds the camera; satisfies `rig.devices.Arm`.

    Parameters
    ----------
    bus
        The servos.
    part
        The arm's section of the rig file.
    clock
        Where time comes from.
    """

    def __init__(self, bus: ServoBus, part: ArmPart, clock: Clock) -> None:
        self._bus = bus
        self._part = part
        self._clock = clock
        self._ids = tuple(joint.servo for joint in part.joints)
        self._prepared = False
        self._rests_at: Counts | None = None
        """End position of the last move; None after anything else."""

    def describe(self) -> str:
        """Describe the arm: bus, voltage, warmest servo."""
        words = f"{self._bus.describe()}, {len(self._ids)} servos, {self._bus.voltage_v(self._ids):.1f} V"
        temperatures_c = self._bus.temperatures_c(self._ids)
        if temperatures_c is None:
            return words + ", temperatures unknown"
        warmest = max(temperatures_c, key=temperatures_c.__getitem__)
        return words + f", warmest {self._name(warmest)} {temperatures_c[warmest]} °C"

    def prepare(self) -> None:
        """Find the servos, check them, and switch the torque on where the arm stands.

        Every servo is commanded to the position that it was read at before its torque comes on, so that nothing jumps.

        Raises
        ------
        NoAnswerError
            When a servo does not answer.
        UnsafeError
            When the supply or a temperature is out of its range, a joint stands where it may not, or the arm moved
            meanwhile.
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
                    f"arm: the {self._name(worst.servo)} went from {_to_deg(worst, present[worst.servo]):.1f} to"
                    f" {_to_deg(worst, now[worst.servo]):.1f} deg while its torque came on; support the arm, then try again"
                )
            self._prepared = True
            self._rests_at = now
            self._check_torque()
        except BaseException:
            self._stop_once()
            raise

    def read_joints(self) -> tuple[float, ...]:
        """Read the joint angles."""
        return self._joints_deg(self._bus.positions(self._ids))

    def holds(self) -> bool:
        """Whether all joints are powered.

        Where the protocol cannot tell, whether the arm still stands where it came to rest: without torque it drops.
        """
        return self._prepared and self._limp() is None

    def move_to(self, joints_deg: tuple[float, ...]) -> tuple[float, ...]:
        """Move all joints at once along a straight line in joint space; wait, verify; return the angles read back.

        A command that moved nothing at all may have been lost on the wire and is repeated once. A move that takes
        longer than the protocols allow is made in parts. On any error the arm is stopped where it is, with its torque
        on.

        Raises
        ------
        UnsafeError
            Before anything is sent: for an angle beyond its joint's limits. Afterwards: when a joint does not arrive,
            is too warm, or the supply is out of its range.
        LostError
            When the arm was not prepared, or a servo has lost its torque.
        """
        target = self._checked_counts(joints_deg)
        if not self._prepared:
            raise LostError("arm: the servos are unpowered; prepare the arm before moving it")
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
            self._stop_once()
            raise
        self._rests_at = here
        return self._joints_deg(here)

    def turn_filter(self, angle_deg: float) -> None:
        """Turn the filter wheel before the lens and check that it is there.

        Raises
        ------
        UnsafeError
            For an angle beyond the wheel's limits, before anything is sent, or when the wheel does not arrive.
        LostError
            When the arm was not prepared.
        """
        wheel = self._part.filter
        if wheel is None or not wheel.min_deg <= angle_deg <= wheel.max_deg:
            raise UnsafeError(f"arm: the filter wheel cannot go to {angle_deg:g} deg; correct [arm.filter] or the band's filter_deg")
        if not self._prepared:
            raise LostError("arm: its torque is off; prepare it before its filter wheel is turned")
        goal = round(wheel.zero_counts + wheel.sign * angle_deg * wheel.counts_per_deg)
        way_deg = abs(goal - self._bus.positions((wheel.servo,))[wheel.servo]) / wheel.counts_per_deg
        duration_s = min(MAX_MOVE_S, max(way_deg / self._part.max_speed_deg_per_s, self._bus.least_move_s))
        self._bus.move({wheel.servo: goal}, duration_s)
        self._clock.sleep(duration_s + _STILL_PAUSE_S)
        there = self._bus.positions((wheel.servo,))[wheel.servo]
        if abs(there - goal) / wheel.counts_per_deg > self._part.tolerance_deg:
            raise UnsafeError(
                f"arm: the filter wheel (servo {wheel.servo}) was sent to {angle_deg:g} deg but stands at {_to_deg(wheel, there):.1f} deg: "
                "it is blocked, or its cable is loose"
            )

    def health(self) -> None:
        """Check supply and temperatures, and that all servos are powered.

        Raises
        ------
        UnsafeError
            When a servo is too warm or the voltage out of its range.
        LostError
            When a servo's torque is off though it was switched on.
        """
        self._check_supply_and_warmth()
        self._check_torque()

    def relax(self) -> None:
        """Unpower the servos: the arm drops unless it is supported."""
        self._prepared = False
        self._rests_at = None
        wheel = self._part.filter
        self._bus.load(self._ids if wheel is None else (*self._ids, wheel.servo), False)

    def close(self) -> None:
        """Close the port; the torque is not changed."""
        self._bus.close()

    def _move_one(self, start: Counts, to: Counts, duration_s: float) -> Counts:
        """Execute one move that fits into one command, and return its end position."""
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
                # The cause rather than the symptom, where there is one.
                self.health()
            if ignored and tries < _COMMAND_TRIES:
                continue
            if worst is None:
                return now
            raise UnsafeError(
                f"arm: the {self._name(worst.servo)} was commanded to {_to_deg(worst, to[worst.servo]):.1f} deg but is at"
                f" {_to_deg(worst, now[worst.servo]):.1f} deg: it is blocked, overloaded, or its command was damaged;"
                " the arm was stopped, clear its way before it is moved again"
            )

    def _still(self) -> Counts:
        """Read positions until the arm is at rest."""
        deadline_s = self._clock.now_s() + _STILL_LIMIT_S
        before = self._bus.positions(self._ids)
        while True:
            self._clock.sleep(_STILL_PAUSE_S)
            now = self._bus.positions(self._ids)
            moving = [servo for servo in self._ids if abs(now[servo] - before[servo]) > _STILL_COUNTS]
            if not moving:
                return now
            if self._clock.now_s() > deadline_s:
                raise UnsafeError(f"arm: the {self._name(moving[0])} does not come to rest; release the arm, or find what moves it")
            before = now

    def _stop_once(self) -> None:
        """Try to stop after an error; failures are ignored in favour of that error."""
        try:
            self._bus.stop(self._ids)
        except RigError:
            return

    def _off_target(self, target: Counts, now: Counts) -> Joint | None:
        """Return the joint with the largest deviation from its target, if it exceeds the tolerance."""
        off_deg = [abs(now[joint.servo] - target[joint.servo]) / joint.counts_per_deg for joint in self._part.joints]
        worst = max(range(JOINTS), key=off_deg.__getitem__)
        return self._part.joints[worst] if off_deg[worst] > self._part.tolerance_deg else None

    def _check_supply_and_warmth(self) -> None:
        part = self._part
        volt = self._bus.voltage_v(self._ids)
        if not part.min_volt <= volt <= part.max_volt:
            raise UnsafeError(
                f"arm: the servos' supply is {volt:.2f} V, outside {part.min_volt:g} to {part.max_volt:g} V; check the supply and its cable"
            )
        for servo, celsius in (self._bus.temperatures_c(self._ids) or {}).items():
            if celsius > part.max_celsius:
                raise UnsafeError(
                    f"arm: the {self._name(servo)} is at {celsius} °C, above {part.max_celsius:g} "
                    "°C; let it cool down in the parking position"
                )

    def _limp(self) -> int | None:
        """Return an unpowered servo, if this can be read."""
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
                f"arm: the {self._name(limp)} has lost its torque, as after a voltage drop or self-protection;"
                " check the supply, then prepare the arm again"
            )

    def _check_standing(self, joint: Joint, counts: int) -> None:
        """Refuse to energise a joint where it must not be commanded to: there its first move could go anywhere."""
        angle_deg = _to_deg(joint, counts)
        slack_deg = self._part.tolerance_deg
        if MIN_COUNTS <= counts <= MAX_COUNTS and joint.min_deg - slack_deg <= angle_deg <= joint.max_deg + slack_deg:
            return
        raise UnsafeError(
            f"arm: the {self._name(joint.servo)} stands at {angle_deg:.1f} deg ({counts} counts), outside its {joint.min_deg:g} to"
            f" {joint.max_deg:g} deg or {MIN_COUNTS} to {MAX_COUNTS} counts; with the torque off, move it by hand into its range"
        )

    def _checked_counts(self, joints_deg: tuple[float, ...]) -> Counts:
        if len(joints_deg) != JOINTS:
            raise UnsafeError(f"arm: {len(joints_deg)} joint angles are given but the arm has {JOINTS} joints; nothing was moved")
        counts = {}
        for joint, angle_deg in zip(self._part.joints, joints_deg, strict=True):
            name = self._name(joint.servo)
            if not joint.min_deg <= angle_deg <= joint.max_deg:
                raise UnsafeError(
                    f"arm: the {name} cannot go to {angle_deg:.2f} deg, its limits are {joint.min_deg:g} to {joint.max_deg:g} deg;"
                    " nothing was moved"
                )
            place = joint.zero_counts + joint.sign * angle_deg * joint.counts_per_deg
            if not MIN_COUNTS <= round(place) <= MAX_COUNTS:
                raise UnsafeError(
                    f"arm: the {name} at {angle_deg:.1f} deg would be at {place:.0f} counts, outside {MIN_COUNTS} to {MAX_COUNTS};"
                    " nothing was moved, check zero_counts and the limits in the rig file"
                )
            counts[joint.servo] = round(place)
        return counts

    def _joints_deg(self, counts: Counts) -> tuple[float, ...]:
        return tuple(_to_deg(joint, counts[joint.servo]) for joint in self._part.joints)

    def _name(self, servo: int) -> str:
        return f"{JOINT_NAMES[self._ids.index(servo)]} (servo {servo})"


def _to_deg(joint: Joint, counts: int) -> float:
    return joint.sign * (counts - joint.zero_counts) / joint.counts_per_deg + 0.0  # no -0.0
