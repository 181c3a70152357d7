"""The schedule of an experiment in the console: canisters asked for, wrong ones refused, interruptions continued."""

from collections.abc import Callable
from pathlib import Path

import pytest

from rhizotwin.catalogue.store import Catalogue
from rhizotwin.console.client import Console
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.timelapse.experiment import Experiment, load_experiment
from tests.rhizotwin.browser import LONG_S, until
from tests.rhizotwin.console.conftest import VIEWS, Lab

EXPERIMENT = """
name = "two plants"
rig = "twin"
scene = "scene.toml"
[schedule]
start = "2026-12-01T09:00+00:00"
rounds = 1
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


@pytest.fixture
def experiment(scene_file: Path) -> Experiment:
    path = scene_file.with_name("my.toml")
    path.write_text(EXPERIMENT)
    return load_experiment(path)


@pytest.fixture
def scheduled(make_lab: Callable[..., Lab], experiment: Experiment) -> Lab:
    """Return the console of the experiment."""
    return make_lab(experiment.folder, experiment=experiment)


def question(client: Console, plant: str) -> str:
    """Return the question for a plant's canister."""
    return str(until(lambda: (text := client.state()["question"]) and f"(plant {plant})" in text and text))


def answer(client: Console, text: str) -> None:
    client.answer(text, question=client.state()["question_number"])


def test_the_schedule_asks_checks_and_continues(scheduled: Lab, experiment: Experiment) -> None:
    client = scheduled.client("Anna")
    assert [visit["plant"] for visit in client.state()["schedule"]["next"]] == ["P1", "P2"]
    client.start_schedule()
    question(client, "P1")
    with pytest.raises(UserError, match=r"the rig is busy \(schedule of two plants\); wait until this action has ended"):
        client.command("pose")
    answer(client, "2")
    assert question(client, "P1").startswith("The plant on the turntable is P2 instead of P1; put P1 on the turntable.")
    answer(client, "7")
    until(lambda: "matches no plant in the catalogue" in question(client, "P1"))
    assert not list(experiment.scans_folder.rglob("*.png"))
    answer(client, "")
    question(client, "P2")
    scheduled.stop()

    scheduled.start()
    client = scheduled.client("Anna")
    state = client.state()
    assert (state["schedule"]["scanned"], state["schedule"]["state"]) == (1, "stopped")
    client.start_schedule()
    question(client, "P2")
    client.stop_schedule()  # withdraws the question
    until(lambda: client.state()["activity"] == "")
    client.start_schedule()
    question(client, "P2")
    answer(client, "")
    until(lambda: client.state()["activity"] == "")
    state = client.state()
    assert (state["schedule"]["scanned"], state["schedule"]["missed_count"]) == (2, 0)
    assert [plant["scans"] for plant in state["plants"]] == [1, 1]
    datasets = [load_dataset(experiment.scans_folder / scan["name"]) for scan in state["scans"]]
    assert [(one.origin["complete"], len(one.frames)) for one in datasets] == [(True, VIEWS)] * 2
    assert [one.scene.subject.plant for one in datasets] == [scan["name"].partition("_")[0] for scan in state["scans"]]


def test_nothing_is_written_under_a_wrong_name(scheduled: Lab, experiment: Experiment) -> None:
    """The emulated table has canister 1, that of P1."""
    client = scheduled.client("Anna")
    for plant in ("P2", "a new plant", ""):
        client.start_scan(plant=plant, reconstruct=False)
        with pytest.raises(UserError, match=f"is P1 instead of {plant or 'a plant without a name'}"):
            client.wait_for_scan(timeout_s=LONG_S)
    assert not list(experiment.scans_folder.rglob("*.png"))
    with pytest.raises(UserError, match="the treatment of plant P1 is 'control' in the catalogue, not 'low N'"):
        client.start_scan(plant="P1", treatment="low N")
    name = client.start_scan(plant="P1", reconstruct=False)
    client.wait_for_scan(timeout_s=LONG_S)
    assert load_dataset(experiment.scans_folder / name).scene.subject.treatment == "control"
    with Catalogue.open(experiment.catalogue_path, read_only=True) as catalogue:
        assert [scan.plants for scan in catalogue.scans()] == [("P1",)]
