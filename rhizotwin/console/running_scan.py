"""A scan that the console runs: its listeners, and the question that it may ask a person."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, suppress
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING

from rhizotwin import rigs
from rhizotwin.console.live import HOLD_S, Live
from rhizotwin.rig.scanning.audience import Audience
from rhizotwin.scenes.errors import UserError

if TYPE_CHECKING:
    from pathlib import Path

    from rhizotwin.rig.scanning.onlooker import Look
    from rhizotwin.scenes.dataset import Dataset
    from rhizotwin.scenes.model import Scene


class RunningScan:
    """One run of a scan.

    Parameters
    ----------
    name, scene : str, Scene
        Name of the scan; the bench's scene with the subject.
    on_look, on_change : callable
        Receives each picture; called after every other change.
    paused : bool
        Wait before the first picture.
    """

    def __init__(
        self, name: str, scene: Scene, *, on_look: Callable[[Look], object], on_change: Callable[[], object], paused: bool = False
    ) -> None:
        self.name, self.scene = name, scene
        self.question = ""
        """What a person has to answer; empty when nothing is asked."""
        self._answers: SimpleQueue[str] = SimpleQueue()
        self._on_change, self._on_look = on_change, on_look
        self._seen: Look | None = None
        self.live = Live(scene, on_change=self._live_changed, paused=paused)

    def run(
        self,
        bench: rigs.Bench,
        folder: Path,
        *,
        twin: rigs.TwinPictures | None,
        table_angle_deg: float | None,
        say: Callable[[str], None],
    ) -> Dataset:
        """Open the devices and take what the folder does not have yet.

        Parameters
        ----------
        bench, folder : Bench, Path
            The rig; the scan's folder.
        twin, table_angle_deg : TwinPictures or None, float or None
            As in `rigs.take_scan`.
        say : callable
            Receives lines for people.

        Raises
        ------
        RigError
            When a device failed.
        UserError
            For a folder that cannot be used.
        KeyboardInterrupt
            When the scan was stopped.
        """
        try:
            with ExitStack() as stack:
                devices = bench.open_devices(None, stack)
                return rigs.take_scan(
                    bench,
                    devices,
                    self.scene,
                    folder,
                    audience=Audience(ask=self._ask, say=say, onlooker=self.live),
                    twin=twin,
                    resume=True,
                    table_angle_deg=table_angle_deg,
                )
        finally:
            self.live.close()

    def answer(self, text: str) -> None:
        """Answer the question.

        Raises
        ------
        UserError
            Where nothing is asked.
        """
        if not self.question:
            raise UserError("the scan asks nothing at present")
        self._answers.put(text)

    def plain(self) -> dict[str, object]:
        """Return the scan as JSON values."""
        live = self.live
        state = "ended" if live.ended else "stopping" if live.stopping else "paused" if live.paused else "running"
        left_s = live.left_s()
        return {
            "name": self.name,
            "subject": str(self.scene.subject),
            "state": state,
            "done": live.done,
            "total": live.total,
            "left_s": None if left_s is None or state != "running" else round(left_s),
            "question": self.question,
        }

    def _ask(self, question: str) -> str:
        """Wait for a person's answer; `Live.stop` ends the wait with KeyboardInterrupt."""
        self.question = question
        self._on_change()
        try:
            while not self.live.stopping:
                with suppress(Empty):
                    return self._answers.get(timeout=HOLD_S)
            raise KeyboardInterrupt
        finally:
            self.question = ""
            self._on_change()

    def _live_changed(self) -> None:
        look = self.live.last
        if look is not None and look is not self._seen:
            self._seen = look
            self._on_look(look)
        self._on_change()
