"""The turntable of a scan.

Its angle is found at the start, verified about every picture, and found anew when the board was lost.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rhizotwin.rig import bands
from rhizotwin.rig.errors import LostError, NoAnswerError, RigError
from rhizotwin.rig.open import Devices
from rhizotwin.rig.scanning.eye import Eye
from rhizotwin.rig.scanning.homing import DISAGREE_DEG, Angle, Ask, Reference, angle_against, facing_angle, find_angle, wrapped
from rhizotwin.rig.scanning.markers import Sighting, read_strip, why_unread
from rhizotwin.rig.scanning.session import Session
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.pictures import Grey, decode_grey

WAIT_S = 20.0
"""How long a lost board is waited for: time to plug it in again."""
PAUSE_S = 1.0
MOST_REFERENCES = 6
BESIDE_DEG = 20.0
"""A camera may stand beside the x axis by this much: a tripod put up by hand."""
FINE_DEG = 0.02
"""What a pair of pictures can tell."""
LOST_STEPS = 4
"""A motor of two windings that loses its field falls back by whole periods of it, which are four full steps."""
MOST_SLIPPED_DEG = 1.0
"""A picture that shows another angle than commanded by more than this was not taken where the table was told to go,
whatever its motor."""
UNSURE_DEG = 0.1
"""What the markers of single pictures may be off (0.6 px across 350 px of strip's radius at 400x300): less is no
slip."""

Taken = tuple[float, Path]
"""Commanded angle and file of a picture."""


class BoardFaultError(Exception):
    """The board of table and lights failed in a way that connecting it anew may cure."""

    def __init__(self, cause: RigError) -> None:
        super().__init__(str(cause))
        self.cause = cause


@contextmanager
def board_watched() -> Iterator[None]:
    """Tell failures of the board from those of other devices."""
    try:
        yield
    except (LostError, NoAnswerError) as error:
        raise BoardFaultError(error) from error


class Turning:
    """The table with what is known about its angle."""

    def __init__(
        self, devices: Devices, scene: Scene, eye: Eye, *, ask: Ask | None, given_deg: float | None, note: Callable[[str, str], None]
    ) -> None:
        self._devices = devices
        self._scene = scene
        self._eye = eye
        self._ask = ask
        self._given_deg = given_deg
        self._note = note
        self._looks: list[Reference] = []
        self.pictures: list[Taken] = []
        """Pictures of the scan that the camera took where it stands."""
        self._acceleration: float | None = None  # chosen; None: as the rig file says
        self.band = ""
        """The band that the lamps are set for."""
        self.lost = False
        """Whether the board was lost and has not come back."""

    @property
    def slip_deg(self) -> float:
        """Difference between the angle that a picture shows and the commanded one beyond which steps were lost.

        Half of the least loss.
        """
        return max(UNSURE_DEG, min(MOST_SLIPPED_DEG, LOST_STEPS / 2.0 * self._devices.rig.turntable.full_step_deg))

    def off_deg(self, table_deg: float, seen: Sighting) -> float:
        """Return by how much a picture shows another angle than commanded.

        The first one asked about is what the others are held to.
        """
        if not self._looks:
            self._looks.append(Reference(table_deg=table_deg, cam_from_canister=seen.cam_from_canister))
        return wrapped(angle_against(seen.cam_from_canister, self._looks, self._scene) - table_deg)

    def camera_moved(self) -> None:
        """Forget the pictures by which the angle could be found anew: the camera stands elsewhere now."""
        self._looks.clear()
        self.pictures.clear()

    def remember_sighting(self, seen: Sighting | None) -> None:
        """Remember what the strip says while the angle is known."""
        if seen is not None:
            self._looks.append(Reference(table_deg=self.angle_deg(), cam_from_canister=seen.cam_from_canister))

    @staticmethod
    def pictures_of(session: Session) -> list[Taken]:
        """Return the pictures that the camera took from its last place in an earlier run.

        Nobody may have compared them yet.
        """
        return [(frame.table_deg or 0.0, session.folder / frame.file) for frame in session.last_station()]

    def remember_picture(self, table_deg: float, path: Path) -> None:
        """Remember a picture of the scan that the camera took where it stands."""
        self.pictures.append((table_deg, path))

    def start(self, seen: Sighting | None, image: Grey, *, earlier: list[Taken], near_deg: float) -> None:
        """Make the table's angle known before the first picture of a run.

        Parameters
        ----------
        seen, image : Sighting or None, uint8 or uint16 array
            What the strip says now, and in which picture.
        earlier : list of Taken
            Angles and pictures of the same ring from an earlier run; a table that kept its angle is compared with them.
        near_deg : float
            The angle that is wanted next.
        """
        references = self._read(earlier)
        kept_deg = self._kept_deg()
        if kept_deg is not None and (seen is not None or self._given_deg is None):
            shown_deg, most_deg = kept_deg, DISAGREE_DEG
            if seen is not None and references:
                shown_deg = angle_against(seen.cam_from_canister, references, self._scene)
            elif seen is not None:
                shown_deg, most_deg = facing_angle(seen, self._scene), BESIDE_DEG
            if abs(wrapped(shown_deg - kept_deg)) <= most_deg:
                checked = "not checked by markers" if seen is None else f"the markers show {shown_deg % 360.0:.2f} deg"
                self._note("angle", f"turntable: kept its angle, {kept_deg:.2f} deg ({checked})")
                return
            self._note("angle", f"turntable: says {kept_deg:.2f} deg, but the markers show {shown_deg % 360.0:.2f} deg: it was turned")
        self._declare(self._found(seen, image, references, near_deg, given_deg=self._given_deg))

    def angle_deg(self) -> float:
        """Read the angle back."""
        kept_deg = self._kept_deg()
        if kept_deg is None:
            raise BoardFaultError(LostError("turntable: was reset and does not know its angle any more"))
        return kept_deg

    def check_board(self) -> None:
        """Make sure that the board is still there.

        One that was reset has put the lights out, which is not the camera's fault.
        """
        with board_watched():
            self._devices.table.position_deg()

    def turn(self, angle_deg: float) -> float:
        """Turn the table; return the angle read back, which is the commanded one within its tolerance."""
        with board_watched():
            read_deg = self._devices.table.move_to(angle_deg)
        self._compare(angle_deg, read_deg)
        return read_deg

    def accelerate(self, deg_per_s2: float) -> None:
        """Let the table speed up and slow down so from now on."""
        with board_watched():
            self._devices.table.accelerate(deg_per_s2)
        self._acceleration = deg_per_s2

    def verify(self, angle_deg: float) -> None:
        """Ask again, after a picture: a board that was reset since the move has forgotten the angle."""
        with board_watched():
            read_deg = self._devices.table.position_deg()
        self._compare(angle_deg, read_deg)

    def light(self, band: str | None = None) -> None:
        """Switch the lights on as a band of the camera needs them; None: as before."""
        self.band = self.band if band is None else band
        with board_watched():
            bands.light(self._devices.lights, self._devices.rig, self.band)

    def recover(self, fault: BoardFaultError, *, near_deg: float, again: bool) -> bool:
        """Connect the board anew and make the angle known again; return whether it had to be found anew.

        Parameters
        ----------
        fault : BoardFaultError
            What failed.
        near_deg : float
            The angle that is wanted next.
        again : bool
            Whether this was tried before; a board that only failed to answer is not connected anew the first time,
            since many boards start anew when they are, and forget the angle.

        Returns
        -------
        bool
            Whether the angle had to be found anew.

        Raises
        ------
        RigError
            When the board does not come back, or the angle cannot be found.
        """
        if not again and not isinstance(fault.cause, LostError):
            self._note("fault", f"{fault.cause}; asking again")
            self.angle_deg()
            return False
        self.lost = True
        self._note("fault", f"{fault.cause}; connecting again")
        self._reconnect(fault.cause)
        shot, seen = self._eye.look()
        references = [*self._looks, *self._read(self.pictures)]
        kept_deg = self._kept_deg()
        if kept_deg is not None:
            shown_deg = angle_against(seen.cam_from_canister, references, self._scene) if seen is not None and references else kept_deg
            if abs(wrapped(shown_deg - kept_deg)) <= self.slip_deg:
                self._note("angle", f"turntable: is back and kept its angle, {kept_deg:.2f} deg")
                self.lost = False
                return False
        self._declare(self._found(seen, shot.image, references, near_deg, given_deg=None))
        if seen is not None and references:
            self._refine(references, near_deg)
        self.lost = False
        return True

    def slipped(self, pictures: list[Taken]) -> list[Path]:
        """Return the pictures whose markers show another angle than the table was commanded to.

        They are read from the last one back to the first that agrees, since steps that were lost stay lost. What they
        are compared with is what was seen from the same place before, or else the first of them.
        """
        references = self._looks or self._read(pictures[:1])
        found: list[Path] = []
        for table_deg, path in reversed(pictures):
            shown = self._read([(table_deg, path)])
            if not references or not shown:
                break
            if abs(wrapped(angle_against(shown[0].cam_from_canister, references, self._scene) - table_deg)) <= self.slip_deg:
                break
            found.append(path)
        return found[::-1]

    def _refine(self, references: list[Reference], angle_deg: float) -> None:
        """Look again once the table has arrived from its usual side.

        Where it stood when the board was lost, its play was anywhere.
        """
        read_deg = self.turn(angle_deg)
        self._devices.clock.sleep(self._devices.rig.turntable.settle_s)
        _, seen = self._eye.look()
        if seen is None:
            return
        off_deg = wrapped(angle_against(seen.cam_from_canister, references, self._scene) - read_deg)
        if abs(off_deg) > FINE_DEG:
            self._declare(Angle(table_deg=read_deg + off_deg, source=f"{seen.markers} markers, play taken up"))

    def _kept_deg(self) -> float | None:
        """Return the angle that the board still holds, or None."""
        table = self._devices.table
        with board_watched():
            return table.position_deg() if table.knows_zero() else None

    def _found(self, seen: Sighting | None, image: Grey, references: list[Reference], near_deg: float, *, given_deg: float | None) -> Angle:
        why = "" if seen is not None else why_unread(image, self._scene)
        return find_angle(seen, references, self._scene, near_deg=near_deg, given_deg=given_deg, ask=self._ask, why=why)

    def _declare(self, angle: Angle) -> None:
        with board_watched():
            self._devices.table.declare(angle.table_deg)
        self._note("homed", f"turntable: stands at {angle.table_deg:.2f} deg ({angle.source})")

    def _compare(self, wanted_deg: float, read_deg: float) -> None:
        if not abs(read_deg - wanted_deg) <= self._devices.rig.turntable.tolerance_deg:
            raise BoardFaultError(LostError(f"turntable: stands at {read_deg:.3f} deg instead of {wanted_deg:.3f} deg"))

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
                    raise type(cause)(f"{cause}; it did not come back within {WAIT_S:.0f} s ({error})") from error
                clock.sleep(PAUSE_S)
            else:
                return

    def _read(self, pictures: list[Taken]) -> list[Reference]:
        """Read the strip in some of the pictures, spread over all of them."""
        step = max(1, -(-len(pictures) // MOST_REFERENCES))
        found: list[Reference] = []
        for table_deg, path in pictures[::step]:
            seen = read_strip(decode_grey(path.read_bytes(), where=str(path)), self._scene)
            if seen is not None:
                found.append(Reference(table_deg=table_deg, cam_from_canister=seen.cam_from_canister))
        return found
