"""Calls of commands from Python: paths as arguments, and printed text as log messages."""

from __future__ import annotations

import io
import logging
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any

from rhizotwin.scenes.errors import UserError
from rhizotwin.steps.calls import require_each

log = logging.getLogger("rhizotwin")


def paths(name: str, given: Any) -> list[Path]:
    """Return one path or several as a list; raise UserError if ``given``, the argument ``name``, is something else."""
    return [Path(path) for path in require_each(name, given, "path")]


def existing(name: str, given: Any) -> list[Path]:
    """Return paths, after it was checked that they exist, before slow libraries are imported."""
    found = paths(name, given)
    missing = [path for path in found if not path.exists()]
    if missing:
        raise UserError(f"{name}: {missing[0]} does not exist; check the path")
    return found


@contextmanager
def logged() -> Iterator[None]:
    """Replace the standard output of a command by log messages.

    The output is logged even if the command fails.
    """
    printed = io.StringIO()
    try:
        with redirect_stdout(printed):
            yield
    finally:
        for line in filter(None, printed.getvalue().splitlines()):
            log.info(line)
