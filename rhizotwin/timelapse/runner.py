"""Execution of a time-lapse experiment: change of canisters, scans, reconstruction, and update of the growth curves.

The catalogue stores the state of each planned scan, so that a run can be continued after any interruption, including a
power failure. A scan is recorded as started before the rig moves, and as finished in the same transaction that adds its
dataset. The folder of a dataset depends only on plant and planned time, so that no scan is repeated.
"""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

from rhizotwin.catalogue import adding, identity, schema
from rhizotwin.catalogue.records import State, Visit
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.catalogue.visits import list_visits, plan_visits, update_visit
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.scanning.homing import Ask
from rhizotwin.rig.scanning.observer import Observer
from rhizotwin.rig.scanning.observers import Observers
from rhizotwin.rig.scanning.preflight import check_disk
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import recover
from rhizotwin.scenes.formatting import count
from rhizotwin.scenes.lock import lock_file
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.plan import count_pictures
from rhizotwin.steps import rigs
from rhizotwin.timelapse.changers import Changer, NobodyError
from rhizotwin.timelapse.clocks import STEP, Calendar, SystemCalendar, VirtualCalendar
from rhizotwin.timelapse.experiment import Experiment, Member
from rhizotwin.timelapse.reconstruction import Reconstructor, growth_page
from rhizotwin.timelapse.table import EmulatedTable, RealTable, changer_of


@dataclass(frozen=True, kw_only=True)
class Listener:
    """Functions that are called during a run. They are provided by the console or the command line."""

    say: Callable[[str], None] = lambda _: None
    """Function that is called with each line of text for the user."""
    say_devices: Callable[[str], None] | None = None
    """Function that is called with each line of output about devices. If it is None, these lines are passed to
    ``say``."""
    on_visit: Callable[[Visit], object] = lambda _: None
    """Function that is called whenever the state of a planned scan has changed."""
    stop: Callable[[], bool] = lambda: False
    """Function that returns whether the run should end before the next scan. A running reconstruction is stopped."""
    ask: Ask | None = None
    """Function that asks the user a question, and returns the answer. It is None if there is no user to ask."""
    observer: Observer = field(default_factory=Observer)
    """Receives the pictures of a scan, and can pause the scan."""
    monitor: Monitor = field(default_factory=Monitor)
    """Receives the progress of a scan."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """State of an experiment at the end of a run."""

    scanned: int
    """Number of finished scans."""
    missed: tuple[Visit, ...]
    """Missed scans."""
    open: tuple[Visit, ...]
    """Scans that are still to be performed."""
    growth: Path | None
    """Path of the page with the growth curves. It is None if no growth curves have been computed yet."""


class Runner:
    """Runs a time-lapse experiment.

    Parameters
    ----------
    experiment : Experiment
        Experiment from `load_experiment`.
    listener : Listener or None
        Callbacks for the events of the run.
    changer : Changer or None
        Device or person that places canisters on the turntable; None: as in the schedule.
    calendar : Calendar or None
        Clock; None: time of the computer, or virtual time for the emulated rig.
    """

    def __init__(
        self, experiment: Experiment, *, listener: Listener | None = None, changer: Changer | None = None, calendar: Calendar | None = None
    ) -> None:
        self.experiment = experiment
        self.listener = listener or Listener()
        self._changer = changer
        self._calendar = calendar
        self._placed: Member | None = None  # plant whose canister was put on the turntable last
        self._numbers = {visit: number for number, visit in enumerate(experiment.visits())}
        self.table: RealTable | EmulatedTable | None = None
        """Rig of the experiment with its turntable. It is None until the run starts."""

    def prepare(self) -> None:
        """Create the catalogue if necessary, add plants that are not yet listed, and plan the scans.

        Raises
        ------
        UserError
            If the experiment is inconsistent with the catalogue.
        """
        with Catalogue.open_or_create(self.experiment.catalogue_path) as catalogue:
            self._prepare(catalogue)

    def run(self) -> Outcome:
        """Perform all planned scans at their times.

        The method returns when the schedule is complete, or when the listener stops the run.

        Returns
        -------
        Outcome
            State of the experiment at the end of the run.

        Raises
        ------
        UserError
            If another run uses the experiment, or the catalogue, the folders or the rig file cannot be used.
        """
        path = self.experiment.catalogue_path
        with lock_file(path.with_name(f".{path.name}.lock"), what=self.experiment.file), Catalogue.open_or_create(path) as catalogue:
            self._prepare(catalogue)
            calendar = self._calendar = self._calendar or self._usual_calendar(catalogue)
            self.table = self.table or (EmulatedTable if self.experiment.is_emulated else RealTable)(self.experiment)
            self._reopen(catalogue)
            self._changer = self._changer or changer_of(self.experiment, self.table, ask=self.listener.ask)
            reconstructor = Reconstructor(self.experiment, say=self.listener.say)
            stop = self.listener.stop
            while (visit := _next_visit(catalogue)) is not None and not stop():
                due = datetime.fromisoformat(visit.due_utc)
                if due <= calendar.now():
                    self._visit(catalogue, visit)
                elif not self._reconstruct_until(due, calendar, reconstructor, catalogue):
                    calendar.wait_until(due, stop=stop)
            while not stop() and reconstructor.step(catalogue, stop=stop):
                pass
            return outcome_of(self.experiment, catalogue)

    def _prepare(self, catalogue: Catalogue) -> None:
        with catalogue.writing():
            for member in self.experiment.plants:
                catalogue.add_plant(self.experiment.plant(member))
            dropped = plan_visits(catalogue, self.experiment.visits())
        if dropped:
            self.listener.say(f"the schedule has changed: removed {count(len(dropped), 'planned scan')} that had not begun")

    def _usual_calendar(self, catalogue: Catalogue) -> Calendar:
        if not self.experiment.is_emulated:
            return SystemCalendar(self.listener.say)
        times = [one for visit in list_visits(catalogue) for one in (visit.began_utc, visit.ended_utc) if one]
        return VirtualCalendar(max([self.experiment.start_utc, *(datetime.fromisoformat(one) for one in times)]))

    def _reopen(self, catalogue: Catalogue) -> None:
        """Plan scans again that were recorded as missed at a later time than now, because the clock was wrong."""
        now = self._now()
        visits = list_visits(catalogue)
        last = max((one for visit in visits for one in (visit.began_utc, visit.ended_utc)), default="")
        if not last or datetime.fromisoformat(last) < now + STEP:
            return
        wrong = [one for one in visits if one.state == "missed" and datetime.fromisoformat(one.ended_utc) >= now + STEP]
        again = [one for one in wrong if not self._is_over(one)]
        self.listener.say(
            f"the clock of this computer shows {now:%Y-%m-%d %H:%M} UTC, but the catalogue has entries of {last[:16]}, and one is wrong; "
            f"{count(len(again), 'scan')} recorded as missed since then can still be taken"
        )
        for visit in again:
            self._change(catalogue, visit, state="due", note="")

    def _visit(self, catalogue: Catalogue, visit: Visit) -> None:
        """Perform a planned scan at its time, or record it as missed.

        Errors of the plant and its folder do not end the run. Errors of the disk and of the catalogue do.
        """
        member = self.experiment.member(visit.plant)
        folder = self.experiment.scan_folder(member, visit.due_utc)
        try:
            if self._is_complete(folder, member):
                recover(folder)  # a run that was killed after the scan has left its lock file
                self._finish(catalogue, visit, folder)
            else:
                self._attempt(catalogue, visit, member, folder)
        except UserError as error:
            if isinstance(error, NobodyError) or isinstance(error.__cause__, (OSError, *schema.ERRORS)):
                raise
            scene = self.experiment.base_scene()
            check_disk(folder, count_pictures(scene), scene.camera)  # a full disk must not make all scans missed
            self._change(catalogue, visit, state="missed", note=str(error))

    def _attempt(self, catalogue: Catalogue, visit: Visit, member: Member, folder: Path) -> None:
        """Place the canister and scan the plant, again if the rig fails or the plant is another one."""
        if self._changer is None:
            raise RuntimeError("the run has not started")
        reason = ""
        for attempt in range(1, self.experiment.schedule.tries + 1):
            if self._miss_if_late(catalogue, visit, folder, reason=reason):
                return
            visit = self._change(catalogue, visit, state="scanning", note=reason)
            try:
                if reason or member != self._placed or not self.experiment.is_short(member, visit.due_utc):
                    self._changer.change(member, reason)
                    self._placed = member
                if self._miss_if_late(catalogue, visit, folder, reason=reason):
                    return
                self._scan(catalogue, visit, member, folder)
            except (RigError, identity.WrongPlantError) as error:
                reason = str(error)
                self.listener.say(f"{member.name}: attempt {attempt} of {self.experiment.schedule.tries} failed: {reason}")
                if self.listener.stop():
                    return
                if attempt < self.experiment.schedule.tries and isinstance(error, RigError):
                    self._wait(timedelta(minutes=self.experiment.schedule.pause_min))
            else:
                self._finish(catalogue, visit, folder)
                return
        self._change(catalogue, visit, state="missed", note=reason)

    def _miss_if_late(self, catalogue: Catalogue, visit: Visit, folder: Path, *, reason: str) -> bool:
        """Record a scan as missed if its time is over, and return whether it is.

        Time passes while a person places the canister, and between two attempts.
        """
        if not self._is_over(visit):
            return False
        begun = (folder / "dataset.json").is_file()
        note = reason or visit.note or f"the scan was {'interrupted and not continued' if begun else 'not started'} in time"
        self._change(catalogue, visit, state="missed", note=note)
        return True

    def _is_over(self, visit: Visit) -> bool:
        return self._now() > datetime.fromisoformat(visit.due_utc) + self.experiment.most_late(visit.plant, visit.due_utc)

    def _scan(self, catalogue: Catalogue, visit: Visit, member: Member, folder: Path) -> None:
        """Check the identity of the plant in the first picture, and scan it.

        The dataset contains the date and age at the start of the scan, also if the scan is continued later.
        """
        if self.table is None or self._calendar is None:
            raise RuntimeError("the run has not started")
        if (folder / "dataset.json").is_file():
            begun = load_dataset(folder).scene.subject
            is_short = self.experiment.is_short(member, visit.due_utc)
            scene = self.experiment.scene_at(member, day=begun.day, date=begun.date, is_short=is_short)
        else:
            scene = self.experiment.known_scene(member, visit.due_utc, self._now())
        number = self._numbers.get((visit.plant, visit.due_utc), 0)
        bench = self.table.bench(scene, number)
        plants = catalogue.plants()
        observers = Observers(
            ask=self.listener.ask,
            say=self.listener.say_devices or self.listener.say,
            observer=self.listener.observer,
            monitor=self.listener.monitor,
            identify=identity.check_plant(catalogue.plant(member.name), plants, scene.strip),
        )
        begin_s = bench.clock.now_s()
        try:
            with ExitStack() as stack:
                devices = bench.open_devices(None, stack)
                rigs.take_scan(bench, devices, bench.scene, folder, observers=observers, resume=True)
        finally:
            self._calendar.advance(bench.clock.now_s() - begin_s)

    def _finish(self, catalogue: Catalogue, visit: Visit, folder: Path) -> None:
        """Add the dataset to the catalogue, and record the scan as finished.

        Both changes are made in a single transaction.
        """
        with catalogue.writing():
            adding.add_scan(catalogue, folder)
            done = update_visit(catalogue, visit, state="scanned", at_utc=self._now().isoformat(timespec="seconds"), scan=folder)
        pictures = len(load_dataset(folder).frames)
        self.listener.say(f"{visit.plant}: the scan planned for {visit.due_utc} is finished, with {pictures} pictures in {folder}")
        self.listener.on_visit(done)

    def _reconstruct_until(self, due: datetime, calendar: Calendar, reconstructor: Reconstructor, catalogue: Catalogue) -> bool:
        """Reconstruct a scan or update the growth curves before the next scan, and return whether there was time."""
        left_s = (due - calendar.now()).total_seconds()
        return reconstructor.step(catalogue, stop=lambda: self.listener.stop() or calendar.now() >= due, left_s=left_s)

    def _change(self, catalogue: Catalogue, visit: Visit, *, state: State, note: str) -> Visit:
        changed = update_visit(catalogue, visit, state=state, at_utc=self._now().isoformat(timespec="seconds"), note=note)
        if state == "missed":
            self.listener.say(f"{visit.plant}: the scan planned for {visit.due_utc} was missed: {note}")
        self.listener.on_visit(changed)
        return changed

    def _is_complete(self, folder: Path, member: Member) -> bool:
        """Return whether a scan is complete, although the catalogue does not record it as finished.

        This happens if a run is interrupted directly after the scan.
        """
        if not (folder / "dataset.json").is_file():
            return False
        dataset = load_dataset(folder)
        if dataset.scene.subject.plant != member.name:
            raise UserError(
                f"{folder}: the folder contains a scan of plant {dataset.scene.subject.plant!r} instead of {member.name}; move it elsewhere"
            )
        return dataset.origin.get("complete") is True

    def _now(self) -> datetime:
        return datetime.now(UTC) if self._calendar is None else self._calendar.now()

    def _wait(self, pause: timedelta) -> None:
        if self._calendar is not None:
            self._calendar.wait_until(self._now() + pause, stop=self.listener.stop)


def outcome_of(experiment: Experiment, catalogue: Catalogue) -> Outcome:
    """Return the current state of an experiment from its catalogue."""
    visits = list_visits(catalogue)
    page = growth_page(experiment.results_folder)
    return Outcome(
        scanned=sum(one.state == "scanned" for one in visits),
        missed=tuple(one for one in visits if one.state == "missed"),
        open=tuple(one for one in visits if one.state in ("due", "scanning")),
        growth=page if page.is_file() else None,
    )


def _next_visit(catalogue: Catalogue) -> Visit | None:
    """Return the earliest scan that is still to be performed, or None if there is none."""
    return next((one for one in list_visits(catalogue) if one.state in ("due", "scanning")), None)
