"""A command in a process of its own: how it ended, what it said, what it took."""

import os
import pkgutil
import resource
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import rhizotwin
from rhizotwin import engine
from rhizotwin.commands import cli

LIMIT_S = 60.0  # by the clock: on a machine with eight runs a processor, pages of results took 15
LIMIT_MIB = 2048


@dataclass(frozen=True)
class Ended:
    """How one command ended."""

    code: int
    seconds: float
    mib: float
    said: str

    @property
    def wrong(self) -> str:
        """What must not be; empty where all is well."""
        lines = [line for line in self.said.splitlines() if line.strip()]
        if self.seconds >= LIMIT_S:
            return "hangs"
        if self.code not in (0, cli.EXIT_MISTAKE):
            return f"exit {self.code}"
        if "Traceback" in self.said or "unexpected error" in self.said:
            return "traceback"
        if self.mib > LIMIT_MIB:
            return "memory"
        strange = [line for line in lines if not line.startswith("rhizotwin: ") and "%|" not in line]
        return "strange lines" if self.code == cli.EXIT_MISTAKE and strange else ""


def run(words: list[str], work: Path, *, before: Callable[[], object]) -> Ended:
    """Run a command line in a child of this process, after ``before``; its words are in ``stdout`` and ``stderr``."""
    begun_s = time.monotonic()
    said = work / "stderr"
    child = os.fork()
    if child == 0:
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(os.open(work / "stdout", os.O_WRONLY | os.O_CREAT), 1)
        os.dup2(os.open(said, os.O_WRONLY | os.O_CREAT), 2)
        code = 70
        try:
            before()
            code = cli.main(words)
        except SystemExit as leaving:
            code = leaving.code if isinstance(leaving.code, int) else 70
        except BaseException:  # noqa: BLE001 - what passes the command line's own last line is a find
            sys.excepthook(*sys.exc_info())
        finally:
            os._exit(code)
    while True:
        ended, status, used = os.wait4(child, os.WNOHANG)
        seconds = time.monotonic() - begun_s
        if ended:
            break
        if seconds > LIMIT_S:
            os.kill(child, signal.SIGKILL)
            os.wait4(child, 0)
            return Ended(-9, seconds, 0.0, "")
        time.sleep(0.002)
    per_mib = 2**10 if sys.platform == "linux" else 2**20
    return Ended(os.waitstatus_to_exitcode(status), seconds, used.ru_maxrss / per_mib, said.read_text(errors="replace"))


def load() -> None:
    """Load what the commands need once, before the children."""
    for module in pkgutil.walk_packages(rhizotwin.__path__, "rhizotwin."):
        if not module.name.endswith("__main__"):
            with suppress(Exception):  # of those that need an engine, or something optional
                import_module(module.name)
    os.environ.pop(cli.DEBUG_VARIABLE, None)
    engine.start = lambda *_: "no engine"  # its threads do not survive a fork, and files need none
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
