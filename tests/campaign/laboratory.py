"""Kills of the console and of its reconstructions, during scans, at random moments."""

import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from rhizotwin.catalogue.adding import is_complete
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.catalogue.verify import check
from rhizotwin.console.client import Console
from rhizotwin.console.console import CATALOGUE
from rhizotwin.console.reconstruction_queue import read
from rhizotwin.scenes.dataset import file_sha256, load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import save_scene
from rhizotwin.stored.load import load_result
from tests.rhizotwin.browser import until
from tests.rhizotwin.console.conftest import console_process
from tests.rhizotwin.timelapse.conftest import small_scene

PORT = 8830
LONGEST_S = 8.0
"""Longest time between the start of a scan and a kill, s. The scan takes about five, and its reconstruction ten."""


class Laboratory:
    """Folder of a console, with a complete scan that is reconstructed again and again."""

    def __init__(self, folder: Path, ball: Path) -> None:
        self.folder, self.kept = folder / "lab", dict[Path, str]()
        shutil.copytree(ball, self.folder / "scans" / "ball")
        save_scene(small_scene(6), folder / "scene.toml")
        self._words = ("--rig", "twin", "--scene", folder / "scene.toml", "-o", self.folder, "--fidelity", "sketch")

    def attack(self, rng: np.random.Generator, *, kill: bool = True) -> list[str]:
        """Start the console, look, finish what was interrupted, begin the next, and kill it; return what was wrong."""
        with console_process(*self._words, port=PORT, stderr=subprocess.DEVNULL) as (process, printed):
            console = Console(printed[-1])
            console.take_control("campaign")
            found = self._look(console.state())
            with suppress(UserError):  # it is still in the queue
                console.reconstruct("ball")
            open_ = [scan["name"] for scan in console.state()["scans"] if not scan["complete"]]
            for name in open_:
                console.finish_scan(name, reconstruct=False)
                if not kill:
                    console.wait_for_scan(timeout_s=600.0)
            if kill and not open_:
                console.start_scan(plant="P7", reconstruct=False)
            if not kill:
                job = until(lambda: (job := console.state()["queue"][0])["ended"] and job)
                return found + [f"untrue: {job}"] * (job["state"] != "done") + self._ended()
            time.sleep(rng.uniform(0.0, LONGEST_S))
            workers = children(process.pid)
            if workers and rng.random() < 0.3:
                os.kill(int(rng.choice(workers)), signal.SIGKILL)
                time.sleep(1.0)  # it is started again
                found += [f"stuck: {job}" for job in console.state()["queue"] if job["state"] == "failed"]
            process.send_signal(signal.SIGKILL)
        return found

    def _look(self, state: dict[str, Any]) -> list[str]:
        """Compare the state of a console that has just started with its folder."""
        found = [f"lost: {path}" for path, digest in self.kept.items() if file_sha256(path) != digest]
        datasets = [load_dataset(head.parent) for head in self.folder.glob("scans/*/dataset.json")]
        self.kept = {dataset.folder / frame.file: frame.sha256 for dataset in datasets for frame in dataset.frames}
        with Catalogue.open(self.folder / CATALOGUE, read_only=True) as catalogue:
            listed = {(scan.path.name, scan.complete) for scan in catalogue.scans()}
        found += [
            f"lost: {one.folder.name} in the catalogue" for one in datasets if (one.folder.name, is_complete(one.origin)) not in listed
        ]
        shown = {(scan["name"], scan["complete"]) for scan in state["scans"]}
        found += [f"untrue: {shown} instead of {listed}"] * (shown != listed)
        found += [f"untrue: {state['activity']}, {state['problems']}"] * bool(state["activity"] or state["problems"])
        return found + [f"stuck: {job}" for job in read(self.folder / "queue.json") if job.state == "failed"]

    def _ended(self) -> list[str]:
        load_result(self.folder / "results" / "ball")
        with Catalogue.open(self.folder / CATALOGUE) as catalogue:
            return [f"untrue: {one}" for one in check(catalogue)]


def children(pid: int) -> list[int]:
    """Return the processes that a process has started (Linux), without that which removes shared memory."""
    tasks = Path(f"/proc/{pid}/task").glob("*/children") if sys.platform == "linux" else ()
    found = [int(child) for task in tasks for child in task.read_text().split()]
    return [child for child in found if b"resource_tracker" not in Path(f"/proc/{child}/cmdline").read_bytes()]
