"""Reconstruction in a separate process, which sends its progress to the console."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from rhizotwin import engine
from rhizotwin.console.messages import explained
from rhizotwin.recon.settings import PictureSettings
from rhizotwin.scenes.terminal import OneBar
from rhizotwin.scenes.threads import end_with_parent
from rhizotwin.steps import command_steps
from rhizotwin.steps.arguments import Progress

NICE = 10
"""Niceness of the process. It gives a simultaneous scan a higher priority."""

Send = Callable[[str, float], None]


class SentBar(OneBar):
    """Progress monitor of a reconstruction, which sends the progress to the console.

    Parameters
    ----------
    shares : mapping of str to float
        Relative duration of each stage, see `OneBar`.
    send : callable
        Function that is called with the name of the stage and the completed fraction of the work.
    """

    def __init__(self, shares: Mapping[str, float], send: Send) -> None:
        super().__init__(shares, quiet=True)
        self._send = send

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure the duration of a stage, and send its name at the start."""
        self._send(name, self._done)
        with super().stage(name):
            yield


@dataclass(frozen=True, kw_only=True)
class SentProgress(Progress):
    """Progress options for a reconstruction whose progress is sent to the console."""

    send: Send = lambda _stage, _done: None

    def bar(self, **shares: float) -> OneBar:
        """Return a progress monitor. ``shares`` are the relative durations of the stages."""
        return SentBar(shares, self.send)


def work(line: Connection, dataset: str, output: str) -> None:
    """Reconstruct a dataset, and send the progress and the outcome to the console, with which this process ends.

    Parameters
    ----------
    line : Connection
        Connection to the console, over which JSON texts are sent: ``[stage, fraction]``, and finally
        ``{"error": text}`` with an empty text on success.
    dataset, output : str
        Folders of the dataset and of the result.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the console stops this process itself
    end_with_parent()
    if hasattr(os, "nice"):
        os.nice(NICE)

    def send(value: Any) -> None:
        with suppress(OSError):
            line.send_bytes(json.dumps(value).encode())

    try:
        engine.ensure("auto")
        settings = command_steps.settings_of(None, pictures=PictureSettings(tolerant=True))
        progress = SentProgress(send=lambda stage, done: send([stage, done]))
        command_steps.reconstruct_whole(Path(dataset), Path(output), command_steps.Wanted(settings=settings), progress=progress)
    except Exception as error:  # noqa: BLE001 - sent to the console, which shows it
        send({"error": explained(error)})
    else:
        send({"error": ""})
