"""Commits at which numbers were measured."""

import subprocess
from pathlib import Path

from rhizotwin.scenes.errors import UserError

ROOT = Path(__file__).resolve().parent.parent
MODIFIED = "+"
"""Suffix of a commit whose reconstruction was modified in the working tree."""


def last_of_reconstruction() -> str:
    """Return the last commit that changed `recon`, abbreviated.

    It ends with `MODIFIED` if `recon` contains changes that are not committed, and is empty without git.
    """
    try:
        commit = _git("log", "-1", "--format=%h", "--abbrev=8", "--", "recon")
        return commit + (MODIFIED if _git("status", "--porcelain", "--", "recon") else "")
    except (OSError, subprocess.CalledProcessError):
        return ""


def check(commit: str, what: str) -> None:
    """Raise UserError if numbers of a commit cannot be committed, because the commit does not determine them."""
    if not commit or commit.endswith(MODIFIED):
        raise UserError(f"{what} was measured with a modified reconstruction or without git; commit `recon` first, then run it again.")


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
