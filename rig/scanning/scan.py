"""Scan, which takes every view of a plan with real or emulated devices.

The scan recovers from faults, Ctrl-C and power cuts. The angle of a frame is read from the turntable after the move and
again after the picture. If the turntable was reset or unplugged, it is reconnected, and its angle is determined again
from the markers. If the camera fails, it is reopened. Any other error stops the scan and is reported. Pictures already
taken are kept, and a later run takes only the missing pictures.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TypeVar

from rhizotwin.rig import bands
from rhizotwin.rig.devices import LEAST_DEG
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.open import Devices
from rhizotwin.rig.scanning import preflight
from rhizotwin.rig.scanning.acceleration_choice import choose_acceleration
from rhizotwin.rig.scanning.arm_stand import ArmStand
from rhizotwin.rig.scanning.canister_check import other_canister
from rhizotwin.rig.scanning.observers import Observers
from rhizotwin.rig.scanning.safety import ArmState, BoardState, make_safe
from rhizotwin.rig.scanning.scan_camera import ScanCamera
from rhizotwin.rig.scanning.scan_log import ScanLog
from rhizotwin.rig.scanning.scan_turntable import BoardFaultError, ScanTurntable, Taken
from rhizotwin.rig.scanning.session import Origin, Session, open_session
from rhizotwin.rig.scanning.stand import Stand, Tripod
from rhizotwin.rig.scanning.turn_check import TurnCheck
from rhizotwin.rig.scanning.view_pictures import ViewPictures
from rhizotwin.scenes import plan
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import lock_folder
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.plan import View

MOST_FAULTS = 3
"""Maximum number of successive faults of the board. The number is reset by every picture taken."""

T = TypeVar("T")


def scan(
    devices: Devices,
    scene: Scene,
    folder: Path | str,
    *,
    resume: bool = False,
    origin: Origin = Origin(),
    observers: Observers | None = None,
) -> Dataset:
    """Take every view of a scene's plan that is missing in a folder.

    Parameters
    ----------
    devices : Devices
        Open devices. They remain open, but are left in a safe state: lights off, and arm parked without torque. The
        table's motor is switched off after a finished scan, and remains on after an interrupted scan, so that the
        table's angle is not lost.
    scene : Scene
        Scene with rig, plan and calibrated camera.
    folder : path
        New or empty folder, or the folder of an interrupted scan.
    resume : bool
        Whether to resume an interrupted scan.
    origin : Origin
        Further settings of the scan, and random seed. They are written to the dataset, and compared when the scan is
        resumed.
    observers : Observers or None
        Observers of the scan, and callbacks for the user.

    Returns
    -------
    Dataset
        Complete dataset.

    Raises
    ------
    RigError
        If a device failed; the scan can be resumed.
    UserError
        If folder, plan or scene are unsuitable, or the disk is full.
    """
    folder, observers = Path(folder), observers or Observers()
    planned = plan.views(scene)
    _check_plan(scene, planned)
    bands.check_bands(devices.rig, scene)
    with lock_folder(folder):
        session = open_session(folder, scene, planned, rig=devices.rig, origin=origin, resume=resume)
        try:
            observers.begun()
            return _Scan(devices, scene, session, observers).run(planned)
        finally:
            session.close()


class _Scan:
    """Procedure of one run of a scan, with its devices, dataset and observers."""

    def __init__(self, devices: Devices, scene: Scene, session: Session, observers: Observers) -> None:
        self._devices = devices
        self._scene = scene
        self._session = session
        self._observer = observers.observer
        self._monitor = observers.monitor
        self._identify = observers.identify
        self._log = ScanLog(session, devices.clock, observers)
        self._camera = ScanCamera(devices.camera, devices.clock, scene, note=self._log.note)
        self._turntable = ScanTurntable(devices, scene, self._camera, observers, note=self._log.note)
        self._watch = TurnCheck(self._turntable, scene, observers.observer)
        self._stand: Stand = Tripod(scene, self._camera, ask=observers.ask, note=self._log.note)
        if devices.arm is not None and devices.rig.arm is not None:
            self._stand = ArmStand(devices, devices.arm, devices.rig.arm, self._camera, note=self._log.note)
        self._board_used = self._arm_used = self._homed = False
        self._views = ViewPictures(devices, self._camera, self._turntable, self._stand, self._log)
        self._rest_known = devices.rig.turntable.rest == "given"

    def run(self, planned: list[View]) -> Dataset:
        """Take the missing pictures and return the dataset. The rig is always left in a safe state."""
        self._remove_slipped(self._turntable.pictures_of(self._session))
        remaining = self._session.remaining()
        if not remaining:
            self._log.say(f"{self._session.folder}: all {len(planned)} pictures exist")
            return self._session.save(complete=True)
        rings = sorted({view.ring for view in remaining})
        self._stand.check_rings([self._scene.plan.rings[ring] for ring in rings])
        finished = False
        try:
            self._observer.on_plan(len(planned), len(planned) - len(remaining))
            with self._monitor.stage("devices"):
                self._preflight(sum(len(plan.ring_bands(self._scene, view.ring)) for view in remaining))
            with self._monitor.stage("pictures"), self._monitor.steps("pictures", len(remaining), "view") as step:
                for ring in rings:
                    self._take_ring(ring, [view for view in remaining if view.ring == ring], step)
            self._report_unverified(len(planned))
            dataset = self._session.save(complete=True)
            finished = True
        except BoardFaultError as fault:  # a fault during the recovery from a previous fault, or before the first picture
            self._turntable.lost = True
            self._stopped(fault.cause)
            raise fault.cause from fault
        except BaseException as error:
            self._stopped(error)
            raise
        finally:
            self._watch.close()
            board = BoardState(used=self._board_used, lost=self._turntable.lost, finished=finished)
            arm = ArmState(used=self._arm_used, failed=self._stand.failed)
            make_safe(self._devices, self._scene, board, arm, say=self._log.say)
        return dataset

    def _preflight(self, pictures: int) -> None:
        """Check every device and report one line for each. The scan does not begin if a device has a problem."""
        devices = self._devices
        self._log.report("disk", preflight.check_disk(self._session.folder, pictures, self._scene.camera))
        self._log.report("turntable", preflight.check_table(devices.table))
        self._board_used = True
        self._log.report("lights", preflight.check_lights(devices.lights, devices.rig.lights))
        if devices.arm is not None:
            self._arm_used = self._stand.failed = True
            self._log.report("arm", preflight.check_arm(devices.arm))
            self._stand.failed = False
        self._log.report("camera", preflight.check_camera(devices.camera))

    def _take_ring(self, index: int, views: list[View], step: Callable[[], None]) -> None:
        main = plan.main_band(self._scene, index)
        self._views.begin_ring(main, [band for band in plan.ring_bands(self._scene, index) if band != main])
        self._turntable.forget_references()
        self._stand.place(self._scene.plan.rings[index])
        self._run_with_recovery(lambda: self._look_about(index, views[0].table_deg), near_deg=views[0].table_deg)
        self._run_with_recovery(lambda: self._measure_rest(views), near_deg=views[0].table_deg)
        self._views.placement = self._session.next_placement(index)
        self._watch.begin_ring()
        for view in views:
            self._wait()
            take = partial(self._views.take, view, twice=self._observer.watches_motion)
            (frame, image), others, again = self._run_with_recovery(take, near_deg=view.table_deg)
            self._check_previous_picture()
            for one in ((frame, image), *others):
                self._session.record(*one)
            self._turntable.add_picture(view.table_deg, self._session.folder / frame.file)
            self._watch.begin_look(frame, image, again)
            step()
        self._check_previous_picture()

    def _wait(self) -> None:
        """Wait as long as the observer pauses the scan, and monitor the arm during this time."""
        while self._observer.holds():
            self._stand.joints()

    def _check_previous_picture(self) -> None:
        """Raise an error if the previous picture does not confirm that the table has rotated.

        Before, all pictures at wrong angles are removed. If there are none, the previous picture is removed.
        """
        wrong = self._watch.wrong()
        if wrong is None:
            return
        files, why = wrong
        if not self._remove_slipped(self._turntable.pictures):
            self._session.drop(files)
            self._observer.on_drop(files)
        raise RigError(f"turntable: {why}, then finish the scan with --resume; the wrong pictures were removed")

    def _measure_rest(self, views: Sequence[View]) -> None:
        """Choose the acceleration of the table and the pause before each picture.

        They are derived from the time for which the contents of the picture move after a turn.
        """
        if self._rest_known or len(views) < 2:
            return
        devices = self._devices
        angles_deg = [view.table_deg for view in views]
        chosen = choose_acceleration(
            self._turntable, lambda: devices.camera.capture().image, devices.clock, angles_deg=angles_deg, part=devices.rig.turntable
        )
        self._views.rest_s, self._rest_known = chosen.rest_s, True
        self._log.note("rest", f"turntable: {chosen.text()}")

    def _report_unverified(self, planned: int) -> None:
        """Report the number of pictures whose angles could not be verified with the markers."""
        unread = len(self._watch.unread)
        if unread:
            self._log.note(
                "unchecked",
                f"the markers of {unread} of {planned} pictures could not be read, so that their angles are known only from the turntable; "
                "for these pictures, only a difference from the previous picture was verified",
            )

    def _look_about(self, index: int, near_deg: float) -> None:
        """Check the first picture of a ring, determine the table angle, and correct the camera's position."""
        shot, seen = self._stand.search()
        self._turntable.check_board()
        self._log.report("picture", preflight.check_picture(shot.image, self._scene.camera))
        self._views.bright = preflight.measure_exposure(shot.image).bright
        if not self._homed:
            self._identify(shot.image)  # first, because it may name the plant to which other markers belong
        if seen is None and (other := other_canister(shot.image, self._scene.strip)):
            raise RigError(
                f"turntable: the canister has the markers {other}, which are not those of the scene; put the right one on the table"
            )
        if not self._homed:
            before = self._session.frames_of(index)
            earlier = [(frame.table_deg or 0.0, self._session.folder / frame.file) for frame in before]
            seen = self._turntable.start(seen, shot.image, earlier=earlier, near_deg=near_deg)
            self._homed = True
        seen = self._stand.correct(seen, self._turntable.angle_deg)
        self._turntable.add_sighting(seen)
        self._log.report(
            "markers", "cannot be read from this position" if seen is None else f"{seen.markers} read, error {seen.reprojection_px:.2f} px"
        )

    def _run_with_recovery(self, action: Callable[[], T], *, near_deg: float) -> T:
        """Run an action. If the board of the table and the lights fails, recover the board and repeat the action."""
        faults = 0
        fault: BoardFaultError | None = None
        while True:
            try:
                if fault is not None:
                    self._session.flush()  # the pictures determine the angle
                    self._views.reset_band()  # the markers are needed
                    if self._turntable.recover(fault, near_deg=near_deg, again=faults > 1):
                        self._views.placement += 1
                return action()
            except BoardFaultError as another:
                fault, faults = another, faults + 1
                if faults > MOST_FAULTS:
                    self._turntable.lost = True
                    raise

    def _remove_slipped(self, pictures: list[Taken]) -> str:
        """Remove pictures whose measured angles differ from the commanded angles, and return their description.

        The board cannot detect lost steps of the motor, which affect all subsequent pictures.
        """
        self._session.flush()
        slipped = self._turntable.find_slipped(pictures)
        if not slipped:
            return ""
        files = [f"images/{path.name}" for path in slipped]
        self._session.drop(files)
        self._observer.on_drop(files)
        names = slipped[0].name if len(slipped) == 1 else f"{slipped[0].name} to {slipped[-1].name}"
        text = (
            f"turntable: the markers of {names} show angles that differ from the commanded angles, because the table slipped or the "
            "camera was pushed; these pictures are removed"
        )
        self._log.note("slipped", text)
        return text

    def _stopped(self, error: BaseException) -> None:
        """Write the log and report how to resume the scan.

        Errors in this method are ignored, so that the original error is reported.
        """
        with suppress(Exception):
            self._remove_slipped(self._turntable.pictures)
        with suppress(Exception):
            self._log.record("stopped", str(error) or type(error).__name__)
            done = len(self._session.save().frames)
            off = self._turntable.lost or self._devices.rig.turntable.kind == "hat"
            motor = "" if off else "; the table's motor remains on, so that the angle is not lost"
            if done:
                self._log.say(f"{done} pictures are kept{motor}; finish the scan with --resume")


def _check_plan(scene: Scene, planned: list[View]) -> None:
    """Reject plans that can be rendered but not scanned by a real rig."""
    for i, ring in enumerate(scene.plan.rings, start=1):
        if ring.jitter_mm or ring.jitter_deg:
            raise UserError(f"plan.rings {i}: jitter_mm and jitter_deg must be 0 for a scan, because the camera is static")
    for view in planned:
        if view.table_deg < LEAST_DEG:
            raise UserError(
                f"plan.rings {view.ring + 1}: first_deg requires a table angle of {view.table_deg:g} deg, but the table angles of a scan "
                f"must be at least {LEAST_DEG:g} deg; add 360"
            )
