"""Console of a laboratory, with the rig, the scans, the queue of reconstructions and the messages.

All clients share its state.
"""

from __future__ import annotations

import threading
from contextlib import ExitStack
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rhizotwin.console.by_hand import ByHand
from rhizotwin.console.controls import Controls
from rhizotwin.console.devices import DeviceStates
from rhizotwin.console.messages import Messages, explained, for_console
from rhizotwin.console.pictures import Shown, show
from rhizotwin.console.plants import Plants
from rhizotwin.console.problems import Problems
from rhizotwin.console.questions import Questions
from rhizotwin.console.reconstruction_queue import Job, Queue
from rhizotwin.console.rig_thread import RigThread
from rhizotwin.console.running_scan import Listeners, RunningScan
from rhizotwin.console.scan_folders import ScanFolders
from rhizotwin.console.schedule import ScheduleRun
from rhizotwin.console.state import StateView
from rhizotwin.console.viewers import Viewers
from rhizotwin.rig.scanning.markers import read_strip
from rhizotwin.rig.scanning.observers import Observers
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import count, error_sentence
from rhizotwin.scenes.lock import lock_file
from rhizotwin.scenes.subject import Subject
from rhizotwin.steps import rigs
from rhizotwin.steps.arguments import SubjectOptions
from rhizotwin.timelapse.runner import Listener, Runner

if TYPE_CHECKING:
    from collections.abc import Callable

    from rhizotwin.rig.scanning.observer import Look
    from rhizotwin.scenes.model import Scene
    from rhizotwin.scenes.picture_codec import Grey
    from rhizotwin.timelapse.experiment import Experiment

LOCK = ".rhizotwin-console-lock"
CATALOGUE = "laboratory.rhizotwin"
"""File name of the catalogue of plants and scans that is used if the console has no experiment."""


class Console:
    """Console of a laboratory, which controls the rig, its scans and their reconstructions.

    Parameters
    ----------
    bench : Bench
        Rig with its scene.
    folder : path
        Folder of scans, results and the queue, which only one console can use at a time.
    experiment : Experiment or None
        Time-lapse experiment whose plants, schedule and folders are used; ``folder`` is then that of its file.

    Raises
    ------
    UserError
        If another console uses the folder.
    """

    def __init__(self, bench: rigs.Bench, folder: Path, *, experiment: Experiment | None = None) -> None:
        self.bench, self.experiment = bench, experiment
        self.version = 1
        """Version of the state, which increases with each change."""
        self._lock = threading.Lock()
        self.controls = Controls(self.changed)
        self.devices = DeviceStates(self.changed)
        self.messages = Messages(self.changed)
        self.problems = Problems(self.messages.error, self.changed)
        self.questions = Questions(self.changed)
        self.schedule: ScheduleRun | None = None
        """Schedule that is being executed. It is None if no schedule is running."""
        self.shown: Shown | None = None
        """Latest picture. It is None before the first picture."""
        self.scan: RunningScan | None = None
        """Running or most recent scan. It is None before the first scan."""
        self._closing = False
        self._view = StateView(self)
        own = {} if experiment is None else {"scans": experiment.scans_folder, "results": experiment.results_folder}
        self.folders = ScanFolders(folder, **own)
        with ExitStack() as stack:
            stack.enter_context(lock_file(folder / LOCK, what=str(folder)))
            self.plants = Plants(folder / CATALOGUE if experiment is None else experiment.catalogue_path)
            if experiment is not None:
                Runner(experiment, listener=Listener(say=self.messages.add)).prepare()
            for sentence in self.plants.add_unlisted(self.folders.scans, self.folders.results):
                self.messages.error(sentence)
            on_error = partial(self.problems.report, "queue of reconstructions")
            self.queue = Queue(self.folders, on_change=self.changed, on_end=self._reconstructed, on_error=on_error)
            stack.callback(self.queue.close)
            self.viewers = Viewers(self.folders)
            stack.callback(self.viewers.close)
            self.rig = RigThread(bench, say=self.messages.add, on_live=self._show_live, on_error=self._show_error, on_change=self.changed)
            stack.callback(self.rig.close)
            self.by_hand = ByHand(self.rig, bench, self.folders, self.devices)
            self._stack = stack.pop_all()

    def close(self) -> None:
        """Stop the scan, the schedule and the reconstruction, bring the rig to a safe state, and release the folder."""
        self._closing = True
        self.stop_schedule()
        if self.scan is not None:
            self.scan.live.stop()
        self._stack.close()

    def changed(self) -> None:
        """Increase the version after a change of the state."""
        with self._lock:
            self.version += 1

    # state

    def state(self, client: str, *, shared: bool) -> dict[str, Any]:
        """Return the complete state of the console as JSON values.

        It includes whether ``client`` has control of the rig. If ``shared``, other parts may have been collected for
        another client.
        """
        self.by_hand.keep_live()
        self.controls.touch(client)
        return self._view.plain(client, shared=shared)

    def hull(self) -> tuple[np.ndarray[Any, np.dtype[np.float32]], float]:
        """Return the cells of the coarse hull of the roots as centres (N, 3) and edge length.

        Both are in mm, and centres are in the canister frame.
        """
        if self.scan is None:
            return np.zeros((0, 3), np.float32), 1.0
        live = self.scan.live
        return live.cells_mm.astype(np.float32), live.cell_mm

    # actions

    def start_scan(
        self,
        subject: SubjectOptions,
        *,
        name: str = "",
        reconstruct: bool = True,
        paused: bool = False,
        table_angle_deg: float | None = None,
    ) -> str:
        """Start a scan, and return its name.

        Parameters
        ----------
        subject : SubjectOptions
            Plant in the canister. If it has a name, the plant in the scene file is ignored.
        name : str
            Name of the new scan; if empty, plant and date.
        reconstruct : bool
            Add the finished scan to the queue of reconstructions.
        paused : bool
            Pause the scan before the first picture.
        table_angle_deg : float or None
            Initial angle of the turntable, deg; required only if the markers cannot be read.

        Raises
        ------
        UserError
            If the name already exists, the plant is invalid, or the rig is busy.
        """
        known = Subject() if subject.plant else replace(self.bench.scene.subject, day=None)  # the scene may describe another plant
        dated = replace(known, date=datetime.now().astimezone().date().isoformat())
        scene = self.plants.scene_of(subject.apply_to(replace(self.bench.scene, subject=dated)))
        name = name or self.folders.new_name(scene.subject)
        self._start(self.folders.new_scan(name), scene, reconstruct=reconstruct, paused=paused, table_angle_deg=table_angle_deg)
        return name

    def resume_scan(self, name: str, *, reconstruct: bool = True, table_angle_deg: float | None = None) -> None:
        """Finish an interrupted scan. Its plant, nutrient solution and marker strip are read from its dataset.

        Raises
        ------
        UserError
            If the scan does not exist, or the rig is busy.
        """
        folder = self.folders.scan(name)
        known = load_dataset(folder).scene
        scene = replace(self.bench.scene, subject=known.subject, solution=known.solution, strip=known.strip)
        self._start(folder, scene, reconstruct=reconstruct, paused=False, table_angle_deg=table_angle_deg)

    def start_schedule(self) -> None:
        """Start the schedule, which performs each planned scan of the experiment at its time.

        Raises
        ------
        UserError
            If the console has no experiment, or the rig is busy.
        """
        if self.experiment is None:
            raise UserError("the console has no schedule; start it with --experiment FILE")
        schedule = ScheduleRun(self.experiment, ask=self._ask, say=self._say_scan, show_scan=self._show_scan)

        def run() -> None:
            self.rig.let_go()
            self.schedule = schedule
            if self._closing:  # `close` was called before this run was visible to it
                schedule.stopping = True
            try:
                outcome = schedule.run()
            except KeyboardInterrupt:
                self.messages.add("the schedule was stopped; start it again to continue")
                return
            finally:
                self.schedule = None
            left = f", {len(outcome.open)} still planned" if outcome.open else ""
            self.messages.add(f"the schedule has ended: {count(outcome.scanned, 'scan')} finished, {len(outcome.missed)} missed{left}")

        self.by_hand.set_live(on=False)
        self.rig.begin(f"schedule of {self.experiment.name}", run)

    def stop_schedule(self) -> None:
        """Stop the schedule after the current scan, and cancel a pending question."""
        schedule = self.schedule
        if schedule is not None:
            schedule.stopping = True
            self.changed()

    def running(self) -> RunningScan:
        """Return the running scan.

        Raises
        ------
        UserError
            If no scan is running.
        """
        scan = self.scan
        if scan is None or scan.live.ended:
            raise UserError("no scan is running")
        return scan

    # in the rig's thread

    def _start(self, folder: Path, scene: Scene, *, reconstruct: bool, paused: bool, table_angle_deg: float | None) -> None:
        name = folder.name
        reconstruct = reconstruct and (self.bench.pictures is None or self.bench.pictures.fidelity == "render")
        identify = self.plants.identity(scene.subject, scene.strip)

        def run() -> None:
            scan = self._show_scan(name, scene, paused=paused, reconstruct=reconstruct)
            observers = Observers(ask=self._ask, table_angle_deg=table_angle_deg, say=self._say_scan, observer=scan.live, identify=identify)
            try:
                with ExitStack() as stack:
                    stack.callback(scan.live.close)
                    self.rig.let_go()
                    devices = self.bench.open_devices(None, stack)
                    # before the devices are closed and the hull is complete, which takes seconds
                    stack.callback(self._catalogue, self.plants.add_scan, folder / "dataset.json")
                    rigs.take_scan(self.bench, devices, scene, folder, observers=observers, resume=True)
            except KeyboardInterrupt:
                self.messages.add(f"{name}: the scan was stopped and can be finished later")
                return
            except Exception as error:
                scan.error = for_console(error_sentence(error))
                raise
            self.messages.add(f"{name}: the scan is complete")
            if reconstruct:
                try:
                    self.queue.add(name)
                except UserError as error:
                    self.messages.error(f"{name}: the scan could not be added to the queue of reconstructions: {error}")

        self.by_hand.set_live(on=False)
        self.rig.begin(f"scan {name}", run)

    def _show_scan(self, name: str, scene: Scene, **options: bool) -> RunningScan:
        """Set the scan that the console shows, and return its state."""
        part = "display of the scan"
        self.problems.solve(part)
        listeners = Listeners(on_look=self._show_look, on_change=self.changed, on_error=partial(self.problems.report, part))
        self.scan = RunningScan(name, scene, listeners, **options)
        if self._closing:
            self.scan.live.stop()
        self.changed()
        return self.scan

    def _ask(self, question: str) -> str:
        """Ask the person at the rig a question.

        The question is cancelled if the scan, the schedule or the console is stopped.
        """

        def cancelled() -> bool:
            scan, schedule = self.scan, self.schedule
            return self._closing or (scan is not None and scan.live.stopping) or (schedule is not None and schedule.stopping)

        return self.questions.ask(question, cancelled=cancelled)

    # what the rig's thread reports

    def _say_scan(self, text: str) -> None:
        self.devices.read_report(text)
        self.messages.add(text)

    def _show_error(self, error: BaseException) -> None:
        text = explained(error)
        self.devices.read_error(text)
        self.messages.error(text)

    def _show_live(self, image: Grey) -> None:
        self._show(image, read_strip(image, self.bench.scene), title=f"live, {datetime.now().astimezone():%H:%M:%S}")

    def _show_look(self, look: Look) -> None:
        scan = self.scan
        panel = None if scan is None else scan.live.panel
        self._show(look.image, look.sighting, title=look.frame.file, panel=panel, motion=look.motion)

    def _show(self, image: Grey, sighting: Any, *, title: str, **more: Any) -> None:
        number = 1 if self.shown is None else self.shown.number + 1
        self.shown = show(image, sighting, number=number, title=title, **more)
        self.changed()

    def _reconstructed(self, job: Job) -> None:
        self.problems.solve("queue of reconstructions")
        if job.error:
            self.messages.error(f"{job.scan}: the reconstruction {'was interrupted' if job.state == 'waiting' else 'failed'}: {job.error}")
            return
        self.messages.add(f"{job.scan}: the reconstruction is finished")
        self._catalogue(self.plants.add_result, self.folders.result(job.scan) / "result.json")

    def _catalogue(self, add: Callable[[Path], None], head: Path) -> None:
        """Add a scan or a result to the catalogue. An error is shown, and the next start of the console adds it."""
        try:
            if head.is_file():
                add(head.parent)
        except Exception as error:  # noqa: BLE001 - a damaged catalogue must not make a good scan a failed one
            advice = "the console adds it when it is started again"
            self.messages.error(f"{head.parent.name}: the entry in the catalogue could not be written: {error_sentence(error)}; {advice}")
