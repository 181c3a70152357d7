"""The command line run in this process, with everything it printed."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import pytest

from rhizotwin.commands import cli

STAGE = re.compile(r"[a-z ]+: \d+\.\d s")
"""The line that a finished stage leaves where no terminal shows a bar."""


@dataclass(frozen=True)
class Outcome:
    """How a command ended."""

    code: int
    out: str
    err: str
    sentence: str
    """The line on stderr that is the program's own."""


class Command:
    """Runs command lines; what libraries write past Python is captured, too."""

    def __init__(self, capfd: pytest.CaptureFixture[str]) -> None:
        self.capfd = capfd

    def __call__(self, *words: object) -> Outcome:
        """Run a command line, given in words or as one string."""
        self.capfd.readouterr()
        only = words[0] if words else ""
        code = cli.main(only.split() if len(words) <= 1 and isinstance(only, str) else [str(word) for word in words])
        out, err = self.capfd.readouterr()
        said = [line for line in err.splitlines() if line.startswith("rhizotwin: ")]
        return Outcome(code, out, err, said[-1] if said else "")

    def works(self, *words: object) -> Outcome:
        """Run a command line that must succeed."""
        done = self(*words)
        assert done.code == 0, done.err
        return done

    def fails(self, *words: object, named: Sequence[object], code: int = cli.EXIT_MISTAKE) -> Outcome:
        """Run a command line that must fail in one sentence that holds every word of ``named``."""
        done = self(*words)
        assert done.code == code, done.err + done.out
        # bars apart, and the line that each stage leaves where nothing moves
        rest = [line for line in done.err.splitlines() if line and "%|" not in line and not STAGE.fullmatch(line)]
        assert rest == [done.sentence], done.err
        assert "unexpected error" not in done.sentence
        for name in named:
            assert str(name) in done.sentence, f"{name!s} is not in: {done.sentence}"
        return done
