"""A reconstruction in a process of its own, with its progress sent to the console."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from rhizotwin import command_steps, engine
from rhizotwin.arguments import Progress
from rhizotwin.recon.settings import PictureSettings
from rhizotwin.scenes.formatting import error_sentence
from rhizotwin.scenes.terminal import OneBar

LOOK_S = 1.0
"""Interval at which the process checks that the console still exists (s)."""
NICE = 10
"""Priority below that of the scan, which may run at the same time."""

Send = Callable[[str, float], None]


class SentBar(OneBar):
    """A monitor that sends stage and progress.

    Parameters
    ----------
    shares : mapping of str to float
        As in `OneBar`.
    send : callable
        Receives the stage and the fraction that is done.
    """

    def __init__(self, shares: Mapping[str, float], send: Send) -> None:
        super().__init__(shares, quiet=True)
        self._send = send

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage, and send its beginning."""
        self._send(name, self._done)
        with super().stage(name):
            yield


@dataclass(frozen=True, kw_only=True)
class SentProgress(Progress):
    """Progress that is sent."""

    send: Send = lambda _stage, _done: None

    def bar(self, **shares: float) -> OneBar:
        """Return a monitor for stages with these shares of the time."""
        return SentBar(shares, self.send)


def work(line: Connection, dataset: str, output: str, console: int) -> None:
    """Reconstruct a dataset; send progress, and at the end the error or an empty text.

    Parameters
    ----------
    line : Connection
        Receives JSON texts: ``[stage, fraction]``, and at the end ``{"error": text}``.
    dataset, output : str
        Folders.
    console : int
        Number of the console's process: this process ends when that one does.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the console stops this process itself
    threading.Thread(target=_end_with, args=(console,), daemon=True).start()
    if hasattr(os, "nice"):
        os.nice(NICE)

    def send(value: Any) -> None:
        with suppress(OSError):
            line.send_bytes(json.dumps(value).encode())

    try:
        engine.ensure("auto")
        settings = command_steps.settings_of(None, pictures=PictureSettings(tolerant=True))
        progress = SentProgress(send=lambda stage, done: send([stage, done]))
        command_steps.reconstruct_whole(Path(dataset), Path(output), settings=settings, progress=progress)
    except Exception as error:  # noqa: BLE001 - sent to the console, which shows it
        send({"error": error_sentence(error)})
    else:
        send({"error": ""})


def _end_with(console: int) -> None:
    while os.getppid() == console:
        time.sleep(LOOK_S)
    os._exit(1)
