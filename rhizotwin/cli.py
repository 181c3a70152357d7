"""The program: it runs a command, and each failure ends in one sentence and an exit code."""

import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Sequence
from contextlib import redirect_stdout
from types import FrameType
from typing import Any, TextIO, cast

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.said import DEBUG_VARIABLE, FULL, failure, printable

EXIT_FAILED, EXIT_MISTAKE, EXIT_STOPPED = 1, 2, 130
AFTER_STOP = {
    "simulate": "the same command takes it up again",
    "demo": "the same command takes it up again",
    "plan": "the same command takes it up again",
    "batch": "what is finished is kept; the same command does the rest",
    "scan": "the pictures are kept; the same command with --resume takes the others",
    "timelapse": "the catalogue and the pictures are kept; the same command continues",
    "console": "scans, results and the queue are kept; the same command continues them",
    "twin": "",
    "rig": "",
    "camera": "",
    "view": "",
}
"""What Ctrl-C leaves of a command; of the others nothing."""
ONE_STOP_S = 1.0
"""Ctrl-C pressed again within this time is the same press: it must not disturb the tidying up."""
ASK_AGAIN_S = 0.05
"""Ctrl-C while a library is loading waits for it: after this time it is looked again."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    0 done, 1 failed (or what a command returns, as a gate does), 2 what the user can put right, 130 stopped by Ctrl-C.
    """
    stops: list[float] = []
    command = ""

    def stop(_: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if _loading(frame) and hasattr(signal, "setitimer"):  # Windows has none: libraries may report an error of their own there
            signal.setitimer(signal.ITIMER_REAL, ASK_AGAIN_S)
        elif not stops or now - stops[-1] > ONE_STOP_S:
            stops.append(now)
            raise KeyboardInterrupt

    in_main_thread = threading.current_thread() is threading.main_thread()
    numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGALRM") if hasattr(signal, name)]
    before = {number: signal.signal(number, stop) for number in numbers if in_main_thread}
    try:
        from rhizotwin import command_line  # it takes time to load, and Ctrl-C may come meanwhile

        words = sys.argv[1:] if arguments is None else list(arguments)
        command = words[0] if words else ""
        function, bound = command_line.bind(words)
        with redirect_stdout(cast(TextIO, _Printed(sys.stdout))):
            code = function(*bound.args, **bound.kwargs)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader of the output (head, less) has left: nobody is there to be told.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_FAILED
    except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001 - the last line of defence: nobody sees a traceback unasked
        # A library that is stopped while it loads may report an error of its own instead.
        return _fail(*_explain(KeyboardInterrupt() if stops else error, command))
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return code if isinstance(code, int) else 0


class _Printed:
    """Stdout for commands: names and texts in files from anybody neither steer a terminal nor end a command."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write text, a question mark for each control code that is no tab and ends no line."""
        self._stream.write("".join(letter if letter in "\n\t" else printable(letter) for letter in text))
        return len(text)


def _loading(frame: FrameType | None) -> bool:
    """Tell whether Python is loading a module.

    Libraries that are stopped then swallow it, or report an error of their own.
    """
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _fail(sentence: str, code: int) -> int:
    if "tqdm" in sys.modules:  # the sentence begins on a line of its own, not behind an unfinished bar
        for bar in list(getattr(sys.modules["tqdm"].tqdm, "_instances", ())):
            bar.close()
    if code == EXIT_STOPPED and sys.stderr.isatty():
        sys.stderr.write("\n")  # behind the terminal's ^C
    if os.environ.get(DEBUG_VARIABLE):
        traceback.print_exc()
    sys.stderr.write(f"rhizotwin: {printable(' '.join(sentence.split()))}\n")
    return code


def _explain(error: BaseException, command: str) -> tuple[str, int]:
    """Return the sentence that explains an error in a command, and the exit code."""
    if isinstance(error, KeyboardInterrupt):
        after = AFTER_STOP.get(command, "nothing was written; run it again")
        return f"stopped; {after}" if after else "stopped", EXIT_STOPPED
    full = isinstance(error, OSError) and error.errno in FULL
    return failure(error), EXIT_MISTAKE if full or isinstance(error, UserError) else EXIT_FAILED
