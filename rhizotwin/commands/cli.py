"""Entry point of the command-line program, which turns every failure into a one-line message and an exit code."""

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
from rhizotwin.scenes.formatting import DEBUG_VARIABLE, FULL, error_sentence, printable

EXIT_FAILED, EXIT_MISTAKE, EXIT_STOPPED = 1, 2, 130
AFTER_STOP = {
    "simulate": "run the same command again to continue",
    "demo": "run the same command again to continue",
    "plan": "run the same command again to continue",
    "batch": "finished scans are kept; run the same command again to continue",
    "scan": "the pictures taken so far are kept; run the same command with --resume to continue",
    "timelapse": "the catalogue and the pictures are kept; run the same command again to continue",
    "bench": "finished cases are kept; run the same command again to continue",
    "console": "scans, results and the queue are kept; run the same command again to continue",
    "twin": "",
    "rig": "",
    "camera": "",
    "view": "",
}
"""Advice printed when a command is interrupted with Ctrl-C. The key is the command. Commands without an entry write no
output when they are interrupted."""
ONE_STOP_S = 1.0
"""Time after a Ctrl-C during which any further Ctrl-C is ignored, in seconds. A second Ctrl-C would interrupt the
clean-up."""
ASK_AGAIN_S = 0.05
"""Time after which a postponed Ctrl-C is handled, in seconds. A Ctrl-C is postponed if it arrives while Python is
importing a module."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Returns
    -------
    int
        Exit code: 0 for success, 1 for failure, 2 for invalid input, 130 after Ctrl-C, or the integer that the command
        returned.
    """
    stops: list[float] = []
    command = ""

    def stop(_: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if _loading(frame) and hasattr(signal, "setitimer"):  # Windows has none; an interrupted import may raise another error there
            signal.setitimer(signal.ITIMER_REAL, ASK_AGAIN_S)
        elif not stops or now - stops[-1] > ONE_STOP_S:
            stops.append(now)
            raise KeyboardInterrupt

    in_main_thread = threading.current_thread() is threading.main_thread()
    numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGALRM") if hasattr(signal, name)]
    before = {number: signal.signal(number, stop) for number in numbers if in_main_thread}
    try:
        from rhizotwin.commands import command_line  # slow import; Ctrl-C may arrive meanwhile

        words = sys.argv[1:] if arguments is None else list(arguments)
        command = words[0] if words else ""
        function, bound = command_line.bind(words)
        with redirect_stdout(cast(TextIO, _Printed(sys.stdout))):
            code = function(*bound.args, **bound.kwargs)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader of the output (head, less) has exited.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_FAILED
    except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001 - users see a message, never a traceback
        # An import that was interrupted by Ctrl-C may raise another error.
        return _fail(*_explain(KeyboardInterrupt() if stops else error, command))
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return code if isinstance(code, int) else 0


class _Printed:
    """Standard output that replaces control characters.

    Names of files and other texts from untrusted sources may contain such characters.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write text with a question mark for each control character except tab and newline."""
        self._stream.write("".join(letter if letter in "\n\t" else printable(letter) for letter in text))
        return len(text)


def _loading(frame: FrameType | None) -> bool:
    """Return whether Python is importing a module.

    An interrupt must not arrive at this time, because some libraries ignore it during their import, or raise an error
    of a different type.
    """
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _fail(sentence: str, code: int) -> int:
    if "tqdm" in sys.modules:  # close progress bars, so that the message starts on a new line
        for bar in list(getattr(sys.modules["tqdm"].tqdm, "_instances", ())):
            bar.close()
    if code == EXIT_STOPPED and sys.stderr.isatty():
        sys.stderr.write("\n")  # after the ^C that the terminal shows
    if os.environ.get(DEBUG_VARIABLE):
        traceback.print_exc()
    sys.stderr.write(f"rhizotwin: {printable(' '.join(sentence.split()))}\n")
    return code


def _explain(error: BaseException, command: str) -> tuple[str, int]:
    """Return the user message and the exit code for an error raised in a command."""
    if isinstance(error, KeyboardInterrupt):
        after = AFTER_STOP.get(command, "nothing was written")
        return f"interrupted; {after}" if after else "interrupted", EXIT_STOPPED
    full = isinstance(error, OSError) and error.errno in FULL
    return error_sentence(error), EXIT_MISTAKE if full or isinstance(error, UserError) else EXIT_FAILED
