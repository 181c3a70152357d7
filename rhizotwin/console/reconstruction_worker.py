"""Reconstruction in a separate process, which sends its progress to the console."""

from __future__ import annotations

import json
import logging
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
from rhizotwin.console.messages import for_console
from rhizotwin.recon.settings import PictureSettings
from rhizotwin.scenes.formatting import error_sentence, is_expected
from rhizotwin.scenes.terminal import OneBar

LOOK_S = 1.0
"""Polling interval, in seconds, at which the process checks whether the console is still running."""
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


def work(line: Connection, dataset: str, output: str, console: int) -> None:
    """Reconstruct a dataset, and send the progress and the outcome to the console.

    Parameters
    ----------
    line : Connection
        Connection to the console, over which JSON texts are sent: ``[stage, fraction]``, and finally
        ``{"error": text}`` with an empty text on success.
    dataset, output : str
        Folders of the dataset and of the result.
    console : int
        Process id of the console; if the console ends, this process ends as well.
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
    except Exception as error:  # sent to the console, which shows it
        if not is_expected(error):
            logging.getLogger(__name__).error("%s: the reconstruction failed with an unexpected error", dataset, exc_info=error)
        send({"error": for_console(error_sentence(error))})
    else:
        send({"error": ""})


def _end_with(console: int) -> None:
    while os.getppid() == console:
        time.sleep(LOOK_S)
    os._exit(1)
