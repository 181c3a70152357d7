"""Turntable that is driven as the X axis of a Marlin board, whose unit is then the degree."""

import math

from rhizotwin.rig.clock import Clock
from rhizotwin.rig.devices import check_angle
from rhizotwin.rig.errors import LostError, NoAnswerError
from rhizotwin.rig.rig_file import TurntablePart
from rhizotwin.rig.table.marlin import MarlinLink
from rhizotwin.rig.table.marlin_lines import POSITION
from rhizotwin.rig.table.ramp import move_s

ZERO_X_DEG = 360.0
"""Value of the coordinate X in the firmware at table angle 0, deg. After a reset the board reports X = 0, which
corresponds to no permitted table angle. Thus the board itself stores whether its angle was declared."""
KNOWN_X_DEG = 200.0
"""Minimum value of X that shows that a table angle was declared after the last reset, deg."""
_ROUNDED_DEG = 0.0051
"""Maximum rounding error of a reported angle, deg. M114 prints a single-precision number with two decimals."""
_START_S = 2.0
"""Time that is added to the computed duration of a move to obtain its timeout, s."""
_LOOKS = 3
_PAUSE_S = 0.2
"""Pause before the position is read again, s. Late replies arrive during the pause and are discarded."""
_READINGS = 6


class MarlinTurntable:
    """Turntable driven by a Marlin board.

    It implements `rig.devices.Turntable`.
    """

    def __init__(self, link: MarlinLink, part: TurntablePart, clock: Clock) -> None:
        self._link = link
        self._part = part
        self._clock = clock
        self._verified: tuple[int, float] | None = None  # session of the link, and X as verified in it
        self._seated = False  # whether the last move arrived from the usual side
        self._acceleration = part.acceleration_deg_per_s2

    def describe(self) -> str:
        """Return a description of the firmware and the table angle."""
        x_deg = self._x_deg()
        where = f"table at {_table_deg(x_deg):.2f} deg" if x_deg >= KNOWN_X_DEG else "table angle unknown"
        return f"{self._link.firmware}, {where}"

    def prepare(self) -> None:
        """Connect to the board, switch the motor on permanently, and select absolute angles."""
        self._verified, self._seated = None, False
        self._link.start()
        self._link.command("M17")
        self._link.command("G90")
        self._link.command(f"M204 T{_plain(self._acceleration)}")
        # causes no motion; a halted firmware reports its state here
        self._link.command(f"G1 F{_plain(self._feed())}")
        self._link.ask("M114", POSITION)

    def position_deg(self) -> float:
        """Read the table angle from the board, deg.

        If no angle was declared after the last reset, the result is below -90.

        A reply has no checksum. It is accepted if it equals the last verified reply, or if two successive replies
        agree.
        """
        return _table_deg(self._x_deg())

    def declare(self, angle_deg: float) -> None:
        """Declare that the table is at the given angle, without moving it.

        Raises
        ------
        UnsafeError
            If the angle is below -90 deg.
        """
        check_angle(angle_deg)
        self._verified, self._seated = None, False
        self._link.command("M400")
        self._link.command(f"G92 X{_plain(angle_deg + ZERO_X_DEG)}")
        self._verify(angle_deg)

    def knows_zero(self) -> bool:
        """Return whether the board still stores the declared angle.

        It is lost when the board is switched off or reset.
        """
        return self._x_deg() >= KNOWN_X_DEG

    def accelerate(self, deg_per_s2: float) -> None:
        """Set the acceleration of subsequent moves, deg/s2.

        It is sent with M204 T, which applies to moves without extrusion.
        """
        self._acceleration = deg_per_s2
        self._link.command(f"M204 T{_plain(deg_per_s2)}")

    def move_to(self, angle_deg: float) -> float:
        """Rotate the table to an angle and return the measured angle, deg.

        The final angle is always approached from below: a downward move overshoots by ``approach_deg`` and returns, so
        that the backlash is always on the same side. The same applies to the first move after the motor was switched on
        or an angle declared.

        Raises
        ------
        LostError
            If the board was reset, or reports an angle after the move that differs from the commanded angle.
        UnsafeError
            If the angle is below -90 deg.
        """
        check_angle(angle_deg)
        here = _table_deg(self._known_x_deg())
        room_deg = self._part.approach_deg
        way = [angle_deg]
        if room_deg > 0.0 and angle_deg < (here if self._seated else here + room_deg) - _ROUNDED_DEG:
            way.insert(0, angle_deg - room_deg)
        lengths = [abs(b - a) for a, b in zip([here, *way], way, strict=False)]
        expect_s = _START_S + sum(move_s(length, speed=self._part.speed_deg_per_s, acceleration=self._acceleration) for length in lengths)
        self._verified, self._seated = None, False
        for goal_deg in way:
            self._link.command(f"G1 X{_plain(goal_deg + ZERO_X_DEG)} F{_plain(self._feed())}")
        self._link.command("M400", expect_s=expect_s)
        read_deg = self._verify(angle_deg, expect_s=expect_s)
        self._seated = True
        return read_deg

    def release(self) -> None:
        """Switch the motor off.

        The angle stored in the board is cleared first, because the rotor may turn when the motor is off.
        """
        self._verified, self._seated = None, False
        if not self._link.ready:
            self._link.start()
        self._link.command("M400")
        self._link.command("G92 X0")
        self._link.command("M18")
        self._link.ask("M114", POSITION)

    def close(self) -> None:
        """Close the port, which the turntable and the lights share."""
        self._link.close()

    def _feed(self) -> float:
        """Return the speed in degrees per minute, which is the unit of G1."""
        return 60.0 * self._part.speed_deg_per_s

    def _verify(self, angle_deg: float, *, expect_s: float = 0.0) -> float:
        """Read the table angle from the board and return it if it agrees with the commanded angle, deg.

        If it differs, it is read again, and an error is raised after the last attempt.
        """
        read_deg = before_deg = math.nan
        for look in range(_LOOKS):
            if look:
                self._clock.sleep(_PAUSE_S)
            x_deg = self._look(expect_s=expect_s)
            before_deg, read_deg = read_deg, _table_deg(x_deg)
            off_deg = abs(read_deg - angle_deg)
            if off_deg <= _ROUNDED_DEG or (off_deg <= self._part.tolerance_deg and read_deg == before_deg):
                self._verified = (self._link.sessions, x_deg)
                return read_deg
        raise LostError(
            f"{self._link.name}: the board reports {read_deg:.2f} deg after a move to {angle_deg:.2f} deg; check the axis limits "
            "of the firmware, then determine the table angle again"
        )

    def _known_x_deg(self) -> float:
        """Return the coordinate X of the firmware, deg.

        If X was verified after the last move, the board is not asked again.
        """
        if self._verified is not None and self._link.ready and self._verified[0] == self._link.sessions:
            return self._verified[1]
        x_deg = self._x_deg()
        if x_deg < KNOWN_X_DEG:
            raise LostError(f"{self._link.name}: the table's angle is unknown; determine it from the markers, or declare it")
        return x_deg

    def _x_deg(self) -> float:
        """Read the coordinate X of the firmware, deg.

        It is accepted if it equals the verified value or the previous reading.
        """
        verified = self._verified[1] if self._verified is not None else math.nan
        before = math.nan
        for _ in range(_READINGS):
            x_deg = self._look()
            if x_deg in (verified, before):
                return x_deg
            before = x_deg
        raise NoAnswerError(f"{self._link.name}: the board reports a different angle at every reading; check the cable, then start again")

    def _look(self, *, expect_s: float = 0.0) -> float:
        return float(self._link.ask("M114", POSITION, expect_s=expect_s)[1])


def _table_deg(x_deg: float) -> float:
    return round(x_deg - ZERO_X_DEG, 6)


def _plain(value: float) -> str:
    """Format a number for G-code, without an exponent and without trailing zeros."""
    return f"{value:.4f}".rstrip("0").rstrip(".")
