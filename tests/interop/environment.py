"""Temporary environments for other programs."""

import os
import subprocess
import sys
import venv
from collections.abc import Mapping
from pathlib import Path


class NotInstalledError(RuntimeError):
    """A program cannot be had on this machine."""


def run(*command: object, folder: Path | None = None, variables: Mapping[str, str] | None = None) -> str:
    """Return what a program prints in a working directory. A RuntimeError states its last words if it fails."""
    environment = {**os.environ, **(variables or {})}
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, cwd=folder, env=environment)
    if done.returncode:
        raise RuntimeError(" ".join((done.stdout + done.stderr).split()[-60:]))
    return done.stdout


def fetch(*command: object, folder: Path | None = None) -> None:
    """Run a command that installs a program. A NotInstalledError states its last words if it fails."""
    try:
        run(*command, folder=folder)
    except (RuntimeError, OSError) as error:
        raise NotInstalledError(f"{' '.join(map(str, command))[-200:]} failed: {error}") from None


def install(folder: Path, *packages: str) -> Path:
    """Install packages into a new environment in a folder, and return the environment's Python."""
    venv.create(folder, with_pip=True)
    python = folder / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    fetch(python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *packages)
    return python
