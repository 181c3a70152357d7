"""The schedule of an experiment in the console: canisters asked for, wrong ones refused, interruptions continued."""

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rhizotwin import rigs
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.console import client
from rhizotwin.console.access import Access
from rhizotwin.console.console import Console
from rhizotwin.console.serve import serve
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.timelapse.experiment import Experiment, load_experiment
from tests.rhizotwin.console.conftest import LONG_S, PORT, TWIN, VIEWS, until

EXPERIMENT = """
name = "two plants"
rig = "twin"
scene = "scene.toml"
[schedule]
start = "2026-12-01T09:00+00:00"
rounds = 2
[twin]
profile = "clean"
seed = 2
[[plants]]
name = "P1"
canister = 1
treatment = "control"
[[plants]]
name = "P2"
canister = 2
treatment = "low N"
"""


class ScheduleLab:
    """A console of an experiment; `restart` ends it and starts another."""

    def __init__(self, experiment: Experiment, stack: ExitStack) -> None:
        self.experiment, self._stack = experiment, stack
        self.start()

    def start(self) -> None:
        """Start a console."""
        bench = rigs.twin_bench(self.experiment.base_scene(), TWIN)
        console = Console(bench, self.experiment.folder, twin=TWIN, experiment=self.experiment)
        self._stack.callback(console.close)
        served = serve(console, Access(), host="127.0.0.1", port=PORT + 40)
        self._stack.callback(served.stop)
        self.client = client.Console(served.address)
        self.client.take_control("Anna")

    def restart(self) -> None:
        """End the console, and start another."""
        self._stack.close()
        self.start()

    def question(self, plant: str) -> str:
        """Return the question for a plant's canister."""
        found: Any = until(lambda: (text := self.client.state()["question"]) and f"(plant {plant})" in text and text)
        return str(found)

    def answer(self, text: str) -> None:
        """Answer the pending question."""
        self.client.answer(text, question=self.client.state()["question_number"])


@pytest.fixture
def lab(tmp_path: Path, scene_file: Path) -> Iterator[ScheduleLab]:
    assert scene_file == tmp_path / "scene.toml"
    (tmp_path / "my.toml").write_text(EXPERIMENT)
    with ExitStack() as stack:
        yield ScheduleLab(load_experiment(tmp_path / "my.toml"), stack)


def test_the_schedule_asks_checks_and_continues(lab: ScheduleLab) -> None:
    state = lab.client.state()
    assert [plant["name"] for plant in state["plants"]] == ["P1", "P2"]
    assert state["schedule"]["planned"] == 4
    assert [visit["plant"] for visit in state["schedule"]["next"]] == ["P1", "P2", "P1", "P2"]
    lab.client.start_schedule()
    lab.question("P1")
    with pytest.raises(UserError, match=r"the rig is busy \(schedule of two plants\); wait until this action has ended"):
        lab.client.command("pose")
    lab.answer("2")
    assert lab.question("P1").startswith("The plant on the turntable is P2 instead of P1; put P1 on the turntable.")
    assert not list(lab.experiment.scans_folder.rglob("*.png"))
    lab.answer("")
    lab.question("P2")
    lab.restart()

    state = lab.client.state()
    assert (state["schedule"]["scanned"], state["schedule"]["state"]) == (1, "stopped")
    lab.client.start_schedule()
    lab.question("P2")
    lab.client.stop_schedule()  # withdraws the question
    until(lambda: lab.client.state()["activity"] == "")
    lab.client.start_schedule()
    for plant in ("P2", "P1", "P2"):
        lab.question(plant)
        lab.answer("")
        until(lambda: not lab.client.state()["question"])
    until(lambda: lab.client.state()["activity"] == "")
    state = lab.client.state()
    assert (state["schedule"]["scanned"], state["schedule"]["missed_count"]) == (4, 0)
    assert [plant["scans"] for plant in state["plants"]] == [2, 2]
    for scan in state["scans"]:
        dataset = load_dataset(lab.experiment.scans_folder / scan["name"])
        assert dataset.origin["complete"]
        assert len(dataset.frames) == VIEWS
        assert dataset.scene.subject.plant == scan["name"].partition("_")[0]


def test_nothing_is_written_under_a_wrong_name(lab: ScheduleLab) -> None:
    """The emulated table has canister 1, that of P1."""
    for plant in ("P2", "a new plant", ""):
        lab.client.start_scan(plant=plant, reconstruct=False)
        with pytest.raises(UserError, match=f"is P1 instead of {plant or 'a plant without a name'}"):
            lab.client.wait_for_scan(timeout_s=LONG_S)
        assert not list(lab.experiment.scans_folder.rglob("*.png"))
    with pytest.raises(UserError, match="the treatment of plant P1 is 'control' in the catalogue, not 'low N'"):
        lab.client.start_scan(plant="P1", treatment="low N")
    name = lab.client.start_scan(plant="P1", reconstruct=False)
    lab.client.wait_for_scan(timeout_s=LONG_S)
    assert load_dataset(lab.experiment.scans_folder / name).scene.subject.treatment == "control"
    with Catalogue.open(lab.experiment.catalogue_path, read_only=True) as catalogue:
        assert [scan.plants for scan in catalogue.scans()] == [("P1",)]


def test_a_canister_without_a_strip_is_not_scanned(lab: ScheduleLab) -> None:
    lab.client.start_schedule()
    lab.question("P1")
    lab.answer("7")
    assert "matches no plant in the catalogue" in lab.question("P1")
    lab.client.stop_schedule()


def test_no_schedule_without_an_experiment(lab: ScheduleLab, tmp_path: Path) -> None:
    console = Console(rigs.twin_bench(lab.experiment.base_scene(), replace(TWIN)), tmp_path / "other", twin=TWIN)
    try:
        assert console.state("")["schedule"] is None
        with pytest.raises(UserError, match="start it with --experiment"):
            console.start_schedule()
    finally:
        console.close()
