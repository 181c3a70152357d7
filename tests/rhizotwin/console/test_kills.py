"""The console killed at random moments while it runs a schedule: nothing is lost, nothing is scanned twice."""

import os
import random
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from rhizotwin.catalogue import verify
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.console.client import Console
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.timelapse.experiment import load_experiment
from tests.rhizotwin.console.conftest import LONG_S, VIEWS
from tests.rhizotwin.console.test_schedule import EXPERIMENT

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[3]
KILLS = 20
LONGEST_S = 2.5
"""Longest time between the start of the schedule and the kill."""


def start(experiment: Path) -> tuple[subprocess.Popen[str], Console]:
    """Start a console in a process of its own."""
    words = ["console", "--experiment", str(experiment), "--no-browser", "--port", "8797"]
    process = subprocess.Popen(
        [sys.executable, "-m", "rhizotwin", *words],
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert process.stdout is not None
    return process, Console(next(line for line in process.stdout if line.startswith("http")).strip())


def confirm_all(console: Console, ended: threading.Event) -> bool:
    """Run the schedule and confirm every canister; return whether it came to its end."""
    with suppress(UserError):  # killed meanwhile
        console.take_control("robot")
        console.start_schedule()
        while not ended.is_set():
            state = console.state()
            if state["activity"] == "":
                return True
            if state["question"]:
                with suppress(UserError):
                    console.answer("", question=state["question_number"])
            time.sleep(0.05)
    return False


def test_twenty_kills(tmp_path: Path, scene_file: Path) -> None:
    path = tmp_path / "my.toml"
    path.write_text(EXPERIMENT.replace("rounds = 2", "rounds = 10"))
    assert scene_file.parent == tmp_path
    experiment = load_experiment(path)
    rng = random.Random(20)
    written: dict[str, tuple[int, int]] = {}
    for _ in range(KILLS):
        process, console = start(path)
        ended = threading.Event()
        robot = threading.Thread(target=confirm_all, args=(console, ended))
        robot.start()
        time.sleep(rng.uniform(0.05, LONGEST_S))
        process.kill()
        process.communicate()
        ended.set()
        robot.join(LONG_S)
        for picture, stamp in written.items():  # a picture that was kept is never taken again
            status = Path(picture).stat()
            assert (status.st_mtime_ns, status.st_size) == stamp
        for dataset in experiment.scans_folder.glob("*/dataset.json"):
            for frame in load_dataset(dataset.parent).frames[:-1]:
                picture = dataset.parent / frame.file
                if picture.is_file():
                    written[str(picture)] = (picture.stat().st_mtime_ns, picture.stat().st_size)
    process, console = start(path)
    try:
        assert confirm_all(console, threading.Event())
        state = console.state()
    finally:
        process.kill()
        process.communicate()
    assert (state["schedule"]["planned"], state["schedule"]["scanned"]) == (20, 20)
    assert len(state["scans"]) == 20
    for scan in state["scans"]:
        dataset = load_dataset(experiment.scans_folder / scan["name"])
        assert dataset.origin["complete"]
        assert len(dataset.frames) == VIEWS
    with Catalogue.open(experiment.catalogue_path, read_only=True) as catalogue:
        assert verify.check(catalogue) == []
        assert len(catalogue.scans()) == 20
