"""A scan: every view of a plan taken on real or emulated devices, so that it survives faults, Ctrl-C and power cuts.

A frame's angle is what the turntable answered after the move and again after the picture. A turntable that was reset or
plugged out is connected again and its angle found anew by the markers; a camera that fails is opened again; all else
stops the scan with its cause. What was taken stays, and a later run takes only what is missing.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from rhizotwin.rig import bands
from rhizotwin.rig.devices import LEAST_DEG, MOST_DEG, Shot
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.open import Devices
from rhizotwin.rig.scanning import preflight
from rhizotwin.rig.scanning.arm_stand import ArmStand
from rhizotwin.rig.scanning.audience import Audience
from rhizotwin.rig.scanning.eye import Eye
from rhizotwin.rig.scanning.resting import choose
from rhizotwin.rig.scanning.safety import make_safe
from rhizotwin.rig.scanning.session import Session, file_of, take_up
from rhizotwin.rig.scanning.stand import Stand, Tripod
from rhizotwin.rig.scanning.turning import BoardFaultError, Taken, Turning
from rhizotwin.rig.scanning.watch import Watch
from rhizotwin.scenes import plan
from rhizotwin.scenes.dataset import Dataset, Frame
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import held
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.pictures import Grey
from rhizotwin.scenes.plan import View

MOST_FAULTS = 3
"""So many faults of the board one after the other, without a picture between them, end the scan."""
DIMMER, BRIGHTER = 0.6, 1.6
"""A picture whose panel is beyond this factor of its ring's first one was taken with failing lights."""

T = TypeVar("T")
Picture: TypeAlias = tuple[Frame, Grey]


def scan(
    devices: Devices,
    scene: Scene,
    folder: Path | str,
    *,
    resume: bool = False,
    settings: Mapping[str, Any] | None = None,
    seed: int | None = None,
    table_angle_deg: float | None = None,
    audience: Audience | None = None,
) -> Dataset:
    """Take every view of a scene's plan that the folder does not have yet.

    Parameters
    ----------
    devices : Devices
        Open; they stay open, but are left safe: lights off, arm parked and let go, the table's motor off after a
        finished scan and on after a stopped one, so that its angle is not lost.
    scene : Scene
        Rig and plan as given, with the calibrated lens.
    folder : path
        New or empty, or left by a stopped scan.
    resume : bool
        Whether a stopped scan is taken up.
    settings : mapping of object or None
        What else the scan is made with; written to the dataset, and compared when it is taken up.
    seed : int or None
        Of the twin's errors.
    table_angle_deg : float or None
        The table's present angle as a person says, for a strip that cannot be read at the start.
    audience : Audience or None
        Who hears of it, and can be asked.

    Returns
    -------
    Dataset
        The finished dataset.

    Raises
    ------
    RigError
        When a device failed; the scan can be taken up.
    UserError
        For a folder, plan or scene that does not fit, or a full disk.
    """
    folder, audience = Path(folder), audience or Audience()
    planned = plan.views(scene)
    _refuse_plan(scene, planned)
    bands.refuse_unknown(devices.rig, scene)
    with held(folder):
        session = take_up(folder, scene, planned, rig=devices.rig, settings=settings or {}, seed=seed, resume=resume)
        try:
            audience.begun()
            return _Scan(devices, scene, session, audience, table_angle_deg=table_angle_deg).run(planned)
        finally:
            session.close()


class _Scan:
    """One run of a scan."""

    def __init__(self, devices: Devices, scene: Scene, session: Session, audience: Audience, *, table_angle_deg: float | None) -> None:
        self._devices = devices
        self._scene = scene
        self._session = session
        self._to_person = audience.say
        self._onlooker = audience.onlooker
        self._monitor = audience.monitor
        self._identify = audience.identify
        self._begun_s = devices.clock.now_s()
        self._eye = Eye(devices.camera, devices.clock, scene, note=self._note)
        self._turning = Turning(devices, scene, self._eye, ask=audience.ask, given_deg=table_angle_deg, note=self._note)
        self._watch = Watch(self._turning, scene, audience.onlooker)
        self._stand: Stand = Tripod(scene, self._eye, ask=audience.ask, note=self._note)
        if devices.arm is not None and devices.rig.arm is not None:
            self._stand = ArmStand(devices, devices.arm, devices.rig.arm, scene, self._eye, note=self._note)
        self._board_used = self._arm_used = self._homed = False
        self._placement = 0
        self._rest_s = devices.rig.turntable.settle_s
        self._rest_known = devices.rig.turntable.rest == "given"
        self._bright = 0.0
        """How bright the ring's pictures are."""

    def run(self, planned: list[View]) -> Dataset:
        """Take what is missing, and leave the rig safe whatever happens."""
        self._drop_slipped(self._turning.pictures_of(self._session))
        remaining = self._session.remaining()
        if not remaining:
            self._say(f"{self._session.folder}: all {len(planned)} pictures are there")
            return self._session.save(complete=True)
        rings = sorted({view.ring for view in remaining})
        self._stand.refuse([self._scene.plan.rings[ring] for ring in rings])
        finished = False
        try:
            self._onlooker.on_plan(len(planned), len(planned) - len(remaining))
            with self._monitor.stage("devices"):
                self._preflight(sum(len(plan.bands_of(self._scene, view.ring)) for view in remaining))
            with self._monitor.stage("pictures"), self._monitor.steps("pictures", len(remaining), "view") as step:
                for ring in rings:
                    self._take_ring(ring, [view for view in remaining if view.ring == ring], step)
            self._say_unchecked(len(planned))
            dataset = self._session.save(complete=True)
            finished = True
        except BoardFaultError as fault:  # one that came while another was being cured, or before the first picture
            self._turning.lost = True
            self._stopped(fault.cause)
            raise fault.cause from fault
        except BaseException as error:
            self._stopped(error)
            raise
        finally:
            self._watch.close()
            make_safe(
                self._devices,
                self._scene,
                say=self._say,
                board=self._board_used,
                arm=self._arm_used,
                finished=finished,
                board_lost=self._turning.lost,
                arm_failed=self._stand.failed,
            )
        return dataset

    def _preflight(self, pictures: int) -> None:
        """Look at every device, one line each; the first that is not well stops the scan before it begins."""
        devices = self._devices
        self._report("disk", preflight.check_disk(self._session.folder, pictures, self._scene.camera))
        self._report("turntable", preflight.check_table(devices.table))
        self._board_used = True
        self._report("lights", preflight.check_lights(devices.lights, devices.rig.lights))
        if devices.arm is not None:
            self._arm_used = self._stand.failed = True
            self._report("arm", preflight.check_arm(devices.arm))
            self._stand.failed = False
        self._report("camera", preflight.check_camera(devices.camera))

    def _take_ring(self, index: int, views: list[View], step: Callable[[], None]) -> None:
        ring = self._scene.plan.rings[index]
        self._select(plan.main_band(self._scene, index))
        self._turning.camera_moved()
        self._stand.place(ring)
        self._cured(lambda: self._look_about(index, views[0].table_deg), near_deg=views[0].table_deg)
        self._cured(lambda: self._measure_rest(views), near_deg=views[0].table_deg)
        self._placement = self._session.next_placement(index)
        self._watch.begin_ring()
        for view in views:
            self._wait()
            (frame, image), others, again = self._cured(partial(self._shoot, view), near_deg=view.table_deg)
            self._refuse_still()
            for one in ((frame, image), *others):
                self._session.record(*one)
            self._turning.remember_picture(view.table_deg, self._session.folder / frame.file)
            self._watch.begin_look(frame, image, again)
            step()
        self._refuse_still()

    def _wait(self) -> None:
        """Wait for as long as the onlooker holds the scan; the arm is watched meanwhile."""
        while self._onlooker.holds():
            self._stand.joints()

    def _refuse_still(self) -> None:
        """Stop where the picture before does not show that the table turned as it says.

        That picture is taken out, the others stay.
        """
        wrong = self._watch.wrong()
        if wrong is None:
            return
        file, why = wrong
        if not self._drop_slipped(self._turning.pictures):
            self._session.drop([file])
            self._onlooker.on_drop([file])
        raise RigError(
            f"turntable: {why}, so that the table slipped or stands still, or the camera was pushed or hangs; this picture is taken out: "
            "free the table, look at the camera, then finish the scan with --resume"
        )

    def _measure_rest(self, views: Sequence[View]) -> None:
        """Choose acceleration and rest by how long the picture moves after a turn."""
        if self._rest_known or len(views) < 2:
            return
        devices = self._devices
        angles_deg = [view.table_deg for view in views]
        chosen = choose(
            self._turning, lambda: devices.camera.capture().image, devices.clock, angles_deg=angles_deg, part=devices.rig.turntable
        )
        self._rest_s, self._rest_known = chosen.rest_s, True
        self._note("rest", f"turntable: {chosen.text()}")

    def _say_unchecked(self, planned: int) -> None:
        """Say of what nobody knows that it is right."""
        unread = len(self._watch.unread)
        if unread:
            self._note(
                "unchecked",
                f"the markers of {unread} of {planned} pictures could not be read: that they show the commanded angles is the turntable's "
                "word alone; only that each differs from the one before was looked at",
            )

    def _look_about(self, index: int, near_deg: float) -> None:
        """Judge the picture, make the table's angle known, and correct the camera's place."""
        shot, seen = self._stand.search(self._scene.plan.rings[index])
        self._turning.check_board()
        self._report("picture", preflight.check_picture(shot.image, self._scene.camera))
        self._bright = preflight.exposure_of(shot.image).bright
        if not self._homed:
            self._identify(shot.image)
            before = self._session.frames_of(index)
            earlier = [(frame.table_deg or 0.0, self._session.folder / frame.file) for frame in before]
            self._turning.start(seen, shot.image, earlier=earlier, near_deg=near_deg)
            self._homed = True
        seen = self._stand.correct(self._scene.plan.rings[index], seen, self._turning.angle_deg)
        self._turning.remember_sighting(seen)
        self._report("markers", "cannot be read from here" if seen is None else f"{seen.markers} read, {seen.reprojection_px:.2f} px off")

    def _cured(self, action: Callable[[], T], *, near_deg: float) -> T:
        """Do something; where the board of table and lights fails in it, cure that and do it again."""
        faults = 0
        fault: BoardFaultError | None = None
        while True:
            try:
                if fault is not None:
                    self._session.flush()  # the pictures tell the angle
                    if self._turning.recover(fault, near_deg=near_deg, again=faults > 1):
                        self._placement += 1
                return action()
            except BoardFaultError as another:
                fault, faults = another, faults + 1
                if faults > MOST_FAULTS:
                    self._turning.lost = True
                    raise

    def _select(self, band: str) -> None:
        """Set lamps and filter as a band of the camera needs them, unless they are."""
        if band == self._turning.band:
            return
        self._turning.light(band)
        part = bands.part_of(self._devices.rig, band)
        if part is not None and part.filter_deg is not None and self._devices.arm is not None:
            self._devices.arm.turn_filter(part.filter_deg)

    def _shoot(self, view: View) -> tuple[Picture, list[Picture], Grey | None]:
        """Turn, wait, take the picture, and make sure that the table still stands where it went.

        Then the same view in the camera's other bands, and again for one who watches motion.
        """
        main = plan.main_band(self._scene, view.ring)
        clock = self._devices.clock
        read_deg = self._turning.turn(view.table_deg)
        moved_s = clock.now_s()
        joints_deg, joints_read_deg = self._stand.joints()  # while the water comes to rest
        clock.sleep(self._rest_s - (clock.now_s() - moved_s))
        shot = self._lit_picture(view.table_deg)
        frame = Frame(
            file=file_of(view, main),
            sha256="",
            kind=view.kind,
            band=main,
            view=view.index if main else None,
            ring=view.ring,
            table_deg=view.table_deg,
            table_read_deg=read_deg,
            placement=self._placement,
            joints_deg=joints_deg,
            joints_read_deg=joints_read_deg,
            exposure_s=shot.exposure_s,
            gain=shot.gain,
            time_s=round(self._now_s(), 6),
        )
        again = self._eye.picture().image if self._onlooker.watches_motion else None
        return (frame, shot.image), self._other_bands(view, frame), again

    def _other_bands(self, view: View, frame: Frame) -> list[Picture]:
        """Take the same view in the camera's other bands, and set the first one again."""
        taken: list[Picture] = []
        for band in plan.bands_of(self._scene, view.ring):
            if band == frame.band:
                continue
            self._select(band)
            shot = self._eye.picture()
            self._turning.verify(view.table_deg)
            now_s = round(self._now_s(), 6)
            own = replace(frame, file=file_of(view, band), band=band, exposure_s=shot.exposure_s, gain=shot.gain, time_s=now_s)
            taken.append((own, shot.image))
        if taken:
            self._select(frame.band)
        return taken

    def _lit_picture(self, angle_deg: float) -> Shot:
        """Take a picture; prove that the table still stands, and that the lamps are as bright as they were.

        Lamps cannot be read back.
        """
        bright = 0.0
        for again in (False, True):
            if again:
                self._note("lights", f"lights: the panel went from {self._bright:.2f} to {bright:.2f} of full scale; switched on again")
                self._turning.light()
            shot = self._eye.picture(table_deg=angle_deg)
            self._turning.verify(angle_deg)
            bright = preflight.exposure_of(shot.image).bright
            if DIMMER * self._bright <= bright <= BRIGHTER * self._bright:
                return shot
        raise RigError(
            f"lights: the panel is at {100.0 * bright:.0f} % of full scale, but was at {100.0 * self._bright:.0f} %; check the lamps, "
            "their supply and what stands before the camera, then finish the scan with --resume"
        )

    def _drop_slipped(self, pictures: list[Taken]) -> str:
        """Take pictures out that show another angle than commanded, and say which.

        Lost steps cannot be read back, but stay lost.
        """
        self._session.flush()
        slipped = self._turning.slipped(pictures)
        if not slipped:
            return ""
        files = [f"images/{path.name}" for path in slipped]
        self._session.drop(files)
        self._onlooker.on_drop(files)
        names = slipped[0].name if len(slipped) == 1 else f"{slipped[0].name} to {slipped[-1].name}"
        text = (
            f"turntable: the markers of {names} show other angles than commanded, so that the table slipped or the camera was pushed, and "
        )
        text += "these pictures are taken out"
        self._note("slipped", text)
        return text

    def _stopped(self, error: BaseException) -> None:
        """Write the log, and say how the scan goes on; the first error is what counts."""
        with suppress(Exception):
            self._drop_slipped(self._turning.pictures)
        with suppress(Exception):
            self._note("stopped", str(error) or type(error).__name__, quiet=True)
            done = len(self._session.save().frames)
            motor = "" if self._turning.lost else "; the table's motor stays on, so that its angle is kept"
            if done:
                self._say(f"{done} pictures are kept{motor}: finish the scan with --resume")

    def _say(self, text: str) -> None:
        self._to_person(text)
        self._onlooker.on_line(text)

    def _note(self, event: str, text: str, *, quiet: bool = False) -> None:
        """Say what happened, and keep it in the dataset's log."""
        self._session.note(event, text, time_s=self._now_s())
        if not quiet:
            self._say(text)

    def _report(self, name: str, text: str) -> None:
        self._say(f"{name:<10} {text}")

    def _now_s(self) -> float:
        return self._session.begun_s + self._devices.clock.now_s() - self._begun_s


def _refuse_plan(scene: Scene, planned: list[View]) -> None:
    """Refuse what a plan may hold for the renderer, but not for a rig."""
    for i, ring in enumerate(scene.plan.rings, start=1):
        if ring.jitter_mm or ring.jitter_deg:
            raise UserError(f"plan.rings {i}: jitter_mm and jitter_deg must be 0 for a scan: its camera stands still")
    for view in planned:
        if not LEAST_DEG <= view.table_deg <= MOST_DEG:
            raise UserError(
                f"plan.rings {view.ring + 1}: first_deg brings the table to {view.table_deg:g} deg, but a scan's angles lie between "
                f"{LEAST_DEG:g} and {MOST_DEG:g}: add or take away 360"
            )
