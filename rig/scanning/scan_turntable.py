"""Turntable of a scan.

The table angle is determined at the start, verified for every picture, and restored after the connection was lost.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rhizotwin.rig import bands
from rhizotwin.rig.errors import LostError, NoAnswerError, RigError
from rhizotwin.rig.open import Devices
from rhizotwin.rig.scanning.homing import (
    DISAGREE_DEG,
    Angle,
    Reference,
    angle_against,
    angle_from_markers,
    angle_from_user,
    facing_angle,
    nearest_turn,
    wrap_angle,
)
from rhizotwin.rig.scanning.markers import Sighting, read_strip, unread_reason
from rhizotwin.rig.scanning.observers import Observers
from rhizotwin.rig.scanning.scan_camera import ScanCamera
from rhizotwin.rig.scanning.session import Session
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import Grey, decode_grey

WAIT_S = 20.0
"""Maximum waiting time for the board to reply again after its connection was lost, s."""
PAUSE_S = 1.0
MOST_REFERENCES = 6
BESIDE_DEG = 20.0
"""Maximum azimuth of a camera on a tripod, measured from the x axis about the table's axis, deg."""
FINE_DEG = 0.02
"""Accuracy of a rotation angle that is measured by comparing the markers in two pictures, deg."""
LOST_STEPS = 4
"""Number of full steps by which the motor slips if it loses synchronism. The number is always a multiple of four,
because the magnetic field has a period of four full steps."""
MOST_SLIPPED_DEG = 1.0
"""Maximum difference between the measured and the commanded table angle, deg, at which a picture is accepted for any
motor."""
UNSURE_DEG = 0.1
"""Error of the table angle measured from the markers of a single picture, deg. It displaces the markers nearest to the
camera by about 0.3 px in pictures of 400x300 pixels. Smaller deviations do not count as slip."""

Taken = tuple[float, Path]
"""Commanded table angle, deg, and path of a picture."""


class BoardFaultError(Exception):
    """Raised if the board of the table and the lights fails. Reconnecting may correct the fault."""

    def __init__(self, cause: RigError) -> None:
        super().__init__(str(cause))
        self.cause = cause


@contextmanager
def convert_board_errors() -> Iterator[None]:
    """Convert failures of the board to `BoardFaultError`, which distinguishes them from failures of other devices."""
    try:
        yield
    except (LostError, NoAnswerError) as error:
        raise BoardFaultError(error) from error


class ScanTurntable:
    """Turntable of a scan, with the information from which its angle is determined."""

    def __init__(
        self,
        devices: Devices,
        scene: Scene,
        camera: ScanCamera,
        user: Observers,
        *,
        note: Callable[[str, str], None],
    ) -> None:
        self._devices = devices
        self._scene = scene
        self._camera = camera
        self._user = user
        self._note = note
        self._looks: list[Reference] = []
        self.pictures: list[Taken] = []
        """Pictures of the scan from the camera's present position."""
        self._acceleration: float | None = None  # chosen acceleration; None for that of the rig file
        self.band = ""
        """Name of the band to which the lamps are set."""
        self.lost = False
        """Whether the connection to the board was lost and has not been restored."""

    @property
    def slip_deg(self) -> float:
        """Minimum difference between the measured and the commanded angle that indicates lost steps, deg.

        It is half the smallest angle by which the motor can slip.
        """
        return max(UNSURE_DEG, min(MOST_SLIPPED_DEG, LOST_STEPS / 2.0 * self._devices.rig.turntable.full_step_deg))

    def off_deg(self, table_deg: float, seen: Sighting) -> float:
        """Return the difference between the measured and the commanded table angle of a picture, deg.

        The measurement is relative to the first picture.
        """
        if not self._looks:
            self._looks.append(Reference(table_deg=table_deg, cam_from_canister=seen.cam_from_canister))
        return wrap_angle(angle_against(seen.cam_from_canister, self._looks, self._scene) - table_deg)

    def forget_references(self) -> None:
        """Discard the reference pictures of the table angle, because the camera has moved."""
        self._looks.clear()
        self.pictures.clear()

    def add_sighting(self, seen: Sighting | None) -> None:
        """Store a measurement of the strip, together with the present table angle, as a reference."""
        if seen is not None:
            self._looks.append(Reference(table_deg=self.angle_deg(), cam_from_canister=seen.cam_from_canister))

    @staticmethod
    def pictures_of(session: Session) -> list[Taken]:
        """Return the pictures that an earlier run took from the camera's last position.

        Their angles may not have been verified.
        """
        return [(frame.table_deg or 0.0, session.folder / frame.file) for frame in session.last_station()]

    def add_picture(self, table_deg: float, path: Path) -> None:
        """Store a picture of the scan from the camera's present position."""
        self.pictures.append((table_deg, path))

    def start(self, seen: Sighting | None, image: Grey, *, earlier: list[Taken], near_deg: float) -> Sighting | None:
        """Determine the table angle before the first picture of a run, and rotate the table to the first target angle.

        If the strip cannot be read, the table is not rotated.

        Parameters
        ----------
        seen, image : Sighting or None, uint8 or uint16 array
            Present measurement of the strip, and the picture in which it was made.
        earlier : list of Taken
            Angles and pictures of the same ring from an earlier run. They are used to verify the angle if the board
            still knows it.
        near_deg : float
            Next target angle, deg.

        Returns
        -------
        Sighting or None
            Measurement of the strip at the target angle; None if the strip cannot be read.
        """
        references = self._read(earlier)
        given_deg = self._user.table_angle_deg
        given = seen is None and given_deg is not None
        if not given and self._is_kept(seen, references, most_deg=DISAGREE_DEG):
            references = []  # the camera may have moved since
        else:
            self._declare(self._find_angle(seen, image, references, near_deg, given_deg=given_deg))
        return None if seen is None else self._approach(seen, references, near_deg)

    def angle_deg(self) -> float:
        """Return the measured table angle, deg."""
        kept_deg = self._kept_deg()
        if kept_deg is None:
            raise BoardFaultError(LostError("turntable: the board was reset, so that the table angle is unknown"))
        return kept_deg

    def check_board(self) -> None:
        """Verify that the board is connected and was not reset.

        A reset switches the lights off, and the dark picture would otherwise be reported as a fault of the camera.
        """
        with convert_board_errors():
            self._devices.table.position_deg()

    def turn(self, angle_deg: float) -> float:
        """Rotate the table to an angle, and return the measured angle, deg.

        An error is raised if the angles differ by more than the tolerance.
        """
        with convert_board_errors():
            read_deg = self._devices.table.move_to(angle_deg)
        self._compare(angle_deg, read_deg)
        return read_deg

    def accelerate(self, deg_per_s2: float) -> None:
        """Set the acceleration of subsequent moves, deg/s2."""
        with convert_board_errors():
            self._devices.table.accelerate(deg_per_s2)
        self._acceleration = deg_per_s2

    def verify(self, angle_deg: float) -> None:
        """Verify that the board has not lost the table angle, after a picture was taken.

        A reset of the board deletes the angle.
        """
        with convert_board_errors():
            read_deg = self._devices.table.position_deg()
        self._compare(angle_deg, read_deg)

    def light(self, band: str | None = None) -> None:
        """Switch the lamps on with the settings of a band. If ``band`` is None, the previous band is used."""
        self.band = self.band if band is None else band
        with convert_board_errors():
            bands.light(self._devices.lights, self._devices.rig, self.band)

    def recover(self, fault: BoardFaultError, *, near_deg: float, again: bool) -> bool:
        """Restore the connection to the board, and the table angle, after a failure.

        Parameters
        ----------
        fault : BoardFaultError
            Failure from which the board must recover.
        near_deg : float
            Next target angle, deg.
        again : bool
            Whether this is a repeated attempt. A board that only failed to reply is not reconnected at the first
            attempt, because many boards reset on connection and lose the angle.

        Returns
        -------
        bool
            Whether the angle had to be determined again.

        Raises
        ------
        RigError
            If the board does not reappear, or the angle cannot be determined.
        """
        if not again and not isinstance(fault.cause, LostError):
            self._note("fault", f"{fault.cause}; trying again")
            self.angle_deg()
            return False
        self.lost = True
        self._note("fault", f"{fault.cause}; reconnecting")
        self._reconnect(fault.cause)
        shot, seen = self._camera.look()
        references = [*self._looks, *self._read(self.pictures)]
        # without references, the angle is not compared: it was verified at the start, maybe from another azimuth
        kept = self._is_kept(seen if references else None, references, most_deg=self.slip_deg)
        if not kept:
            self._declare(self._find_angle(seen, shot.image, references, near_deg, given_deg=None))
            if seen is not None:
                self._approach(seen, references, near_deg)
        self.lost = False
        return not kept

    def find_slipped(self, pictures: list[Taken]) -> list[Path]:
        """Return the pictures whose measured table angle differs from the commanded angle.

        The measurement uses the markers. Pictures are checked from the last picture backwards until one agrees, because
        lost steps affect all subsequent pictures. They are compared with earlier measurements from the same position
        or, if there are none, with the first picture.
        """
        references = self._looks or self._read(pictures[:1])
        found: list[Path] = []
        for table_deg, path in reversed(pictures):
            shown = self._read([(table_deg, path)])
            if not references or not shown:
                break
            if abs(wrap_angle(angle_against(shown[0].cam_from_canister, references, self._scene) - table_deg)) <= self.slip_deg:
                break
            found.append(path)
        return found[::-1]

    def _is_kept(self, seen: Sighting | None, references: list[Reference], *, most_deg: float) -> bool:
        """Return whether the board still knows the table angle, and the markers do not contradict it.

        They contradict it if they differ from the references by more than ``most_deg``. Without references, only the
        side of the strip that faces the camera is compared.
        """
        kept_deg = self._kept_deg()
        if kept_deg is None:
            return False
        shown_deg = kept_deg
        if seen is not None and references:
            shown_deg = angle_against(seen.cam_from_canister, references, self._scene)
        elif seen is not None:
            shown_deg, most_deg = facing_angle(seen, self._scene), BESIDE_DEG
        if abs(wrap_angle(shown_deg - kept_deg)) <= most_deg:
            checked = "not verified with markers" if seen is None else f"the markers show {shown_deg % 360.0:.2f} deg"
            self._note("angle", f"turntable: the angle is still known, {kept_deg:.2f} deg ({checked})")
            return True
        self._note(
            "angle",
            f"turntable: the board reports {kept_deg:.2f} deg, but the markers show {shown_deg % 360.0:.2f} deg, because the table "
            "was turned by hand or slipped",
        )
        return False

    def _approach(self, seen: Sighting, references: list[Reference], angle_deg: float) -> Sighting | None:
        """Approach a table angle from the usual side, and correct the angle of the board with a new measurement.

        At the start, and after the connection to the board was lost, it is unknown on which side of the backlash the
        table is.

        Parameters
        ----------
        seen : Sighting
            Measurement of the strip before the move.
        references : list of Reference
            Measurements at known angles. If there are none, the new measurement is compared with that before the move.
            The difference then includes the backlash, so that only large differences are corrected.
        angle_deg : float
            Target angle, deg.

        Returns
        -------
        Sighting or None
            New measurement of the strip; None if the strip cannot be read.
        """
        most_deg = FINE_DEG
        if not references:
            references = [Reference(table_deg=self.angle_deg(), cam_from_canister=seen.cam_from_canister)]
            most_deg = DISAGREE_DEG
        read_deg = self.turn(angle_deg)
        self._devices.clock.sleep(self._devices.rig.turntable.settle_s)
        _, after = self._camera.look()
        if after is not None:
            off_deg = wrap_angle(angle_against(after.cam_from_canister, references, self._scene) - read_deg)
            if abs(off_deg) > most_deg:
                shown_deg = nearest_turn(read_deg + off_deg, angle_deg)
                self._declare(Angle(table_deg=shown_deg, source=f"{after.markers} markers, without backlash"))
        return after

    def _kept_deg(self) -> float | None:
        """Return the table angle that the board reports, deg, or None if the board has lost it."""
        table = self._devices.table
        with convert_board_errors():
            return table.position_deg() if table.knows_zero() else None

    def _find_angle(
        self, seen: Sighting | None, image: Grey, references: list[Reference], near_deg: float, *, given_deg: float | None
    ) -> Angle:
        if seen is not None:
            return angle_from_markers(seen, references, self._scene, near_deg=near_deg, given_deg=given_deg)
        return angle_from_user(near_deg=near_deg, given_deg=given_deg, ask=self._user.ask, why=unread_reason(image, self._scene))

    def _declare(self, angle: Angle) -> None:
        with convert_board_errors():
            self._devices.table.declare(angle.table_deg)
        self._note("homed", f"turntable: the table is at {angle.table_deg:.2f} deg ({angle.source})")

    def _compare(self, wanted_deg: float, read_deg: float) -> None:
        rig = self._devices.rig
        # the hat stops at the nearest microstep
        rounded_deg = rig.turntable.full_step_deg / rig.hat.microsteps / 2.0 if rig.turntable.kind == "hat" else 0.0
        if not abs(read_deg - wanted_deg) <= rig.turntable.tolerance_deg + rounded_deg:
            raise BoardFaultError(LostError(f"turntable: the table is at {read_deg:.3f} deg instead of {wanted_deg:.3f} deg"))

    def _reconnect(self, cause: RigError) -> None:
        clock = self._devices.clock
        until_s = clock.now_s() + WAIT_S
        while True:
            try:
                self._devices.reconnect_board()
                self._devices.table.prepare()
                if self._acceleration is not None:
                    self._devices.table.accelerate(self._acceleration)
                bands.light(self._devices.lights, self._devices.rig, self.band)
            except RigError as error:
                if clock.now_s() >= until_s:
                    raise type(cause)(f"{cause}; reconnecting the board failed for {WAIT_S:.0f} s ({error})") from error
                clock.sleep(PAUSE_S)
            else:
                return

    def _read(self, pictures: list[Taken]) -> list[Reference]:
        """Read the strip in some of the pictures as references. They are distributed evenly over the list."""
        step = max(1, -(-len(pictures) // MOST_REFERENCES))
        found: list[Reference] = []
        for table_deg, path in pictures[::step]:
            seen = read_strip(decode_grey(path.read_bytes(), where=str(path)), self._scene)
            if seen is not None:
                found.append(Reference(table_deg=table_deg, cam_from_canister=seen.cam_from_canister))
        return found
