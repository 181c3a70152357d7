"""Execution of the schedule of a time-lapse experiment in the console.

Questions and live pictures are shown to the user.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from rhizotwin.rig.scanning.observer import Look, Observer
from rhizotwin.timelapse.changers import Changer, PersonChanger
from rhizotwin.timelapse.runner import Listener, Outcome, Runner
from rhizotwin.timelapse.table import EmulatedTable, RealTable

if TYPE_CHECKING:
    from rhizotwin.catalogue.records import Visit
    from rhizotwin.console.running_scan import RunningScan
    from rhizotwin.rig.scanning.homing import Ask
    from rhizotwin.scenes.model import Scene
    from rhizotwin.timelapse.experiment import Experiment, Member


class ScheduleRun:
    """Execution of an experiment's schedule. Its progress is stored in the catalogue.

    Parameters
    ----------
    experiment : Experiment
        Experiment with plants, rig and schedule.
    ask : Ask
        Function that asks the person at the rig a question and returns the answer.
    say : callable
        Function that is called with each line of output.
    show_scan : callable
        Function that is called with the name and scene of each new scan, and returns the scan for display.
    """

    def __init__(
        self, experiment: Experiment, *, ask: Ask, say: Callable[[str], None], show_scan: Callable[[str, Scene], RunningScan]
    ) -> None:
        self.experiment = experiment
        self.stopping = False
        """Whether the schedule should stop before the next scan."""
        self._ask, self._say, self._show_scan = ask, say, show_scan
        self._scan: RunningScan | None = None

    def run(self) -> Outcome:
        """Perform all planned scans at their times, until the schedule is complete or stopped.

        Raises
        ------
        UserError
            If another run uses the experiment, or its files cannot be used.
        KeyboardInterrupt
            If the user stopped a scan.
        """
        listener = Listener(
            say=self._say, on_visit=self._follow, stop=lambda: self.stopping, ask=self._ask, observer=_Forwarding(lambda: self._scan)
        )
        by_hand = self.experiment.schedule.change == "person"
        changer: Changer | None = _Person(lambda: runner.table, self._ask) if by_hand else None
        runner = Runner(self.experiment, listener=listener, changer=changer)
        try:
            return runner.run()
        finally:
            self._end_scan()

    def _follow(self, visit: Visit) -> None:
        """Show the scan of a planned visit when it starts. The display of the previous scan is closed."""
        self._end_scan()
        if visit.state == "scanning":
            member = self.experiment.member(visit.plant)
            name = self.experiment.scan_folder(member, visit.due_utc).name
            self._scan = self._show_scan(name, self.experiment.known_scene(member, visit.due_utc))

    def _end_scan(self) -> None:
        scan = self._scan
        self._scan = None
        if scan is not None:
            scan.live.close()


class _Person(PersonChanger):
    """Person who is asked to place canisters on the turntable.

    On the emulated rig, the person may answer with the number of another canister.
    """

    def __init__(self, table: Callable[[], RealTable | EmulatedTable | None], ask: Ask) -> None:
        super().__init__(self._asked)
        self._table = table
        self._to_person = ask
        self._answer = ""

    def change(self, member: Member, reason: str, /) -> None:
        """Ask the person to place the canister of a plant.

        On the emulated rig, place the canister whose number was answered.
        """
        super().change(member, reason)
        table = self._table()
        if isinstance(table, EmulatedTable):
            table.put(int(self._answer) if self._answer.isdecimal() else member.canister)

    def _asked(self, question: str) -> str:
        emulated = " On the emulated rig, enter a number to use another canister." if self._table_is_emulated() else ""
        self._answer = self._to_person(f"{question.removesuffix('then press Enter: ')}then confirm.{emulated}").strip()
        return self._answer

    def _table_is_emulated(self) -> bool:
        return isinstance(self._table(), EmulatedTable)


class _Forwarding(Observer):
    """Observer that forwards all calls to the live state of the current scan. Calls are ignored if there is no scan."""

    watches_motion = True

    def __init__(self, scan: Callable[[], RunningScan | None]) -> None:
        self._scan = scan

    def on_plan(self, total: int, done: int) -> None:
        """Forward the number of planned pictures to the live state of the current scan."""
        if (scan := self._scan()) is not None:
            scan.live.on_plan(total, done)

    def on_look(self, look: Look) -> None:
        """Forward a picture."""
        if (scan := self._scan()) is not None:
            scan.live.on_look(look)

    def on_drop(self, files: list[str]) -> None:
        """Forward the file names of rejected pictures."""
        if (scan := self._scan()) is not None:
            scan.live.on_drop(files)

    def holds(self) -> bool:
        """Return whether the current scan is paused."""
        return (scan := self._scan()) is not None and scan.live.holds()
