"""The console's API over HTTP: control, commands, scans and their interruptions on the emulated rig."""

import threading
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timedelta
from io import BytesIO
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import Mock
from zipfile import ZipFile

import cv2
import numpy as np
import pytest

from rhizotwin.catalogue.records import Plant, Tag
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.console.client import Console
from rhizotwin.console.plants import Plants
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.twin.faults import Fault
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.solution import Solution
from rhizotwin.scenes.subject import Subject
from rhizotwin.steps.arguments import SubjectOptions
from tests.rhizotwin.browser import LONG_S, until
from tests.rhizotwin.console.conftest import VIEWS, Lab


def test_one_client_has_control_and_everyone_sees_who(lab: Lab) -> None:
    anna, robot = lab.client(), lab.client()
    with pytest.raises(UserError, match="take control first"):
        anna.command("pose")
    anna.take_control("Anna")
    assert robot.state()["controls"]["name"] == "Anna"
    assert [one.state()["controls"]["own"] for one in (anna, robot)] == [True, False]
    with pytest.raises(UserError, match="Anna has had control of the rig since"):
        robot.command("pose")
    robot.take_control("robot")
    with pytest.raises(UserError, match="robot has had control"):
        anna.check_devices()
    anna.release_control()  # has no effect: it is not hers any more
    assert anna.state()["controls"]["name"] == "robot"
    robot.release_control()
    assert anna.state()["controls"]["name"] is None
    for name in ("", " ", "x" * 41, "bell\x07"):
        with pytest.raises(UserError, match="1 to 40 printable characters"):
            anna.take_control(name)


def test_devices_commands_and_live_pictures(lab: Lab) -> None:
    console = lab.client("Anna")
    assert {device["state"] for device in console.state()["devices"]} == {"unknown"}
    checked = {device["name"]: device["state"] for device in console.check_devices()}
    found = dict.fromkeys(("turntable", "lights", "arm", "camera", "picture", "disk"), "ok")
    assert checked == found | {"markers": "unknown"}  # the parked camera does not see them
    assert "table at 0.000 deg" in console.command("home 0")
    assert console.command("table +9") == ["table at 9.000 deg"]
    with pytest.raises(UserError, match="is invalid; usage: table"):
        console.command("table nan")
    outside = lab.folder.parent / "outside.png"
    for line in (f"picture {outside}", "quit", "", "help"):
        with pytest.raises(UserError, match="is not a command"):
            console.command(line)
    assert not outside.exists()
    assert (lab.folder / "pictures" / console.take_picture()).is_file()
    console.command("lights 1 1")
    console.command("go 400 -20")
    console.request("POST", "/api/live", {"on": True})
    picture = until(lambda: (shown := console.state()["picture"]) and shown["title"].startswith("live, ") and shown)
    assert {meter["name"]: meter["state"] for meter in picture["meters"]} == {"Markers": "unknown", "Focus": "good", "Exposure": "good"}
    assert console.picture().startswith(b"\xff\xd8")
    console.request("POST", "/api/live", {"on": False})
    assert not console.state()["live"]
    console.release_devices()
    assert not console.state()["open"]


def test_an_unexpected_error_does_not_end_the_rig_thread(lab: Lab, monkeypatch: pytest.MonkeyPatch, caplog: Any) -> None:
    console = lab.client("Anna")
    monkeypatch.setattr("rhizotwin.console.console.show", lambda *_, **__: 1 / 0)
    console.request("POST", "/api/live", {"on": True})
    message = until(lambda: [one for one in console.state()["messages"] if one["kind"] == "error"])[0]
    advice = "the traceback is in the terminal in which 'rhizotwin console' runs"
    assert message["text"].endswith(f"(ZeroDivisionError: division by zero); {advice}")
    assert "Traceback" in caplog.text
    assert not console.state()["live"]
    with pytest.raises(ZeroDivisionError):
        lab.console.rig.begin("a failing action", lambda: 1 / 0).result()
    assert caplog.text.count("Traceback") == 2
    with monkeypatch.context() as killed:  # the thread itself, outside of the action
        killed.setattr("rhizotwin.console.rig_thread.RigThread._do", Mock(side_effect=SystemExit("killed")))
        with pytest.raises(UserError, match="home 0 was interrupted"):
            console.command("home 0")
    assert "SystemExit: killed" in console.state()["messages"][0]["text"]
    assert console.command("home 0")[-1] == "table at 0.000 deg"


def test_a_scan_is_paused_stopped_and_finished(lab: Lab) -> None:
    console, other = lab.client("Anna"), lab.client()
    name = console.start_scan(plant="P7", treatment="low N", day=12, date="2026-11-26", paused=True, reconstruct=False)
    assert name == "P7-2026-11-26"
    scan = until(lambda: (found := console.state()["scan"]) and found["total"] == VIEWS and found)
    assert scan["state"] == "paused"
    assert scan["subject"] == "P7, treatment low N, day 12, 2026-11-26"
    with pytest.raises(UserError, match=r"the rig is busy \(scan P7-2026-11-26\); wait until this action has ended, or stop it"):
        console.command("pose")
    with pytest.raises(UserError, match="Anna has had control"):
        other.continue_scan()
    console.continue_scan()
    until(lambda: console.state()["scan"]["done"] >= 1)
    other.stop_scan()  # everyone may stop
    with pytest.raises(UserError):
        console.wait_for_scan(timeout_s=LONG_S)
    entry = console.state()["scans"][0]
    assert not entry["complete"]
    assert 1 <= entry["pictures"] < VIEWS
    with pytest.raises(UserError, match="not complete; finish it first"):
        console.reconstruct(name)
    with pytest.raises(UserError, match="already exists; choose another name, or finish"):
        console.start_scan(name=name)
    console.finish_scan(name, reconstruct=False)
    assert console.wait_for_scan(timeout_s=LONG_S)["done"] == VIEWS
    with pytest.raises(UserError, match="the pictures are sketches, which do not show the plant; scan with --fidelity render"):
        console.reconstruct(name)
    dataset = load_dataset(lab.folder / "scans" / name)
    assert dataset.origin["complete"]
    assert dataset.scene.subject.plant == "P7"
    assert console.state()["scans"][0].items() >= {"plant": "P7", "about": "treatment low N, day 12", "date": "2026-11-26"}.items()
    picture = console.request("GET", f"/api/scans/{name}/pictures/{VIEWS - 1}.jpg?width=64")
    assert cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_GRAYSCALE).shape[1] == 64
    with pytest.raises(UserError, match=f"there is no picture {VIEWS}"):
        console.request("GET", f"/api/scans/{name}/pictures/{VIEWS}.jpg")
    with ZipFile(BytesIO(console.request("GET", f"/scans/{name}/dataset.zip"))) as archive:
        archive.extractall(lab.folder / "copy")
    assert load_dataset(lab.folder / "copy" / name).frames == dataset.frames
    with pytest.raises(UserError, match="has no result; add it to the queue"):
        console.request("GET", f"/results/{name}/viewer")
    assert [device["state"] for device in console.state()["devices"] if device["name"] == "camera"] == ["ok"]
    assert len(np.frombuffer(console.request("GET", "/api/hull"), "<f4")) % 3 == 1
    with pytest.raises(UserError, match="no scan is running"):
        console.pause_scan()


def test_a_scan_that_cannot_begin_is_reported(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    """An arm that does not park ends the scan before the first device is opened; the scan before it is not shown in its place."""
    broken = Mock(side_effect=RigError("arm: no reply; switch it on"))
    monkeypatch.setattr(lab.console.rig, "let_go", broken)
    console = lab.client("Anna")
    console.start_scan(name="second")
    with pytest.raises(UserError, match="arm: no reply; switch it on"):
        console.wait_for_scan(timeout_s=LONG_S)
    ended = {"name": "second", "state": "ended", "error": "arm: no reply; switch it on"}
    assert console.state()["scan"].items() >= ended.items()


def listed(lab: Lab) -> list[tuple[str, int]]:
    """Return the names of the scans in the catalogue, and how many of them are complete."""
    with Catalogue.open(lab.console.plants.path, read_only=True) as catalogue:
        return [(scan.path.name, scan.complete) for scan in catalogue.scans()]


def test_a_complete_scan_is_in_the_catalogue_after_a_kill(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is added before the hull, and a scan that a killed console left is added at the next start."""
    carving = threading.Event()
    monkeypatch.setattr("rhizotwin.console.hull.Hull.carve", lambda _: carving.wait(LONG_S) and 1 / 0)
    console = lab.client("Anna")
    name = console.start_scan(plant="P7", reconstruct=False)
    until(lambda: listed(lab) == [(name, True)])
    assert console.state()["scan"]["state"] == "running"
    carving.set()
    assert console.wait_for_scan(timeout_s=LONG_S)["done"] == VIEWS
    assert "display of the scan: an unexpected error occurred (ZeroDivisionError" in console.state()["problems"][0]
    with Catalogue.open(lab.console.plants.path) as catalogue, catalogue.writing() as connection:
        connection.execute("DELETE FROM scans")
    lab.stop()
    lab.start()
    assert listed(lab) == [(name, True)]
    assert lab.client().state()["plants"][0]["scans"] == 1


def test_a_catalogue_that_cannot_be_read_hides_nothing_else(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    console, path = lab.client("Anna"), lab.console.plants.path
    with Catalogue.open(path) as catalogue:
        catalogue.add_plant(Plant(name="P7", species="Zea mays"))
    plants = console.state()["plants"]
    for damage, words in (("CAST(x'ff' AS TEXT)", "damaged"), ("'='", "must not begin with =")):
        with Catalogue.open(path) as catalogue:
            catalogue.connection.execute(f"UPDATE plants SET species = {damage}")
        state = console.state()
        assert (state["plants"], words in state["problems"][0]) == (plants, True)
    monkeypatch.setattr(Catalogue, "open", Mock(side_effect=RuntimeError("any other error")))
    assert "any other error" in console.state()["problems"][0]
    monkeypatch.undo()
    with Catalogue.open(path) as catalogue:
        catalogue.connection.execute("UPDATE plants SET species = 'Zea mays'")
    until(lambda: console.state()["problems"] == [])
    assert console.command("home 0")[-1] == "table at 0.000 deg"


def test_the_web_server_is_started_again(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    console = lab.client("Anna")
    with monkeypatch.context() as killed:
        killed.setattr("rhizotwin.console.connections.Server.on_tick", Mock(side_effect=SystemExit("killed")))
        (message,) = until(lambda: lab.console.messages.plain()[:1])
        assert str(message["text"]).startswith("web server: an unexpected error occurred (SystemExit: killed)")
    assert console.command("home 0")[-1] == "table at 0.000 deg"  # at the same address, still in control


def test_the_plant_of_the_scene_file_is_not_another_plant(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    console, scenes = lab.console, list[Scene]()
    monkeypatch.setattr(console, "_start", lambda _, scene, **__: scenes.append(scene))
    written = Subject(plant="P1", species="Zea mays", treatment="low N", day=15.0, date="2022-10-06", replicate=1)
    console.bench = replace(console.bench, scene=replace(console.bench.scene, subject=written))
    today = datetime.now().astimezone().date()
    with Catalogue.open(console.plants.path) as catalogue:
        for name in ("P1", "P7"):
            catalogue.add_plant(Plant(name=name, sown=(today - timedelta(days=10)).isoformat(), replicate=int(name[1:])))
    for options in (SubjectOptions(plant="P7"), SubjectOptions()):
        console.start_scan(options)
    other, same = (scene.subject for scene in scenes)
    assert other == Subject(plant="P7", day=10.0, date=today.isoformat(), replicate=7)
    assert same == replace(written, day=10.0, date=today.isoformat())


def test_the_scene_of_a_plant(tmp_path: Path) -> None:
    plants, tag = Plants(tmp_path / "my.rhizotwin"), Tag(dictionary="6X6_1000", first_id=88, markers=44)
    with Catalogue.open(plants.path) as catalogue:
        catalogue.add_plant(Plant(name="P7", treatment="low N", sown="2026-11-01", solution=Solution(recipe="kliman_2022"), tag=tag))

    def scene(**whose: Any) -> Scene:
        return plants.scene_of(replace(Scene(), subject=Subject(**{"plant": "P7", "date": "2026-11-26"} | whose)))

    assert (scene().subject.treatment, scene().subject.day, scene().solution.recipe) == ("low N", 25.0, "kliman_2022")
    assert (scene().strip.dictionary, scene().strip.first_id) == ("6X6_1000", 88)
    assert scene(day=3.0).subject.day == 3.0
    assert scene(date="2026-10-01").subject.day is None
    assert scene(plant="P8") == replace(Scene(), subject=Subject(plant="P8", date="2026-11-26"))


@pytest.mark.parametrize(
    ("fault", "device"),
    [
        pytest.param(Fault(kind="unplugged", device="table", amount=0.0), "turntable", id="table unplugged"),
        pytest.param(Fault(kind="camera_stopped", device="camera", amount=0.0), "camera", id="camera gone"),
    ],
)
def test_a_device_that_fails_is_reported_with_what_to_do(lab: Lab, fault: Fault, device: str) -> None:
    console = lab.client("Anna")
    lab.bench.twin.inject(fault)
    name = console.start_scan(plant="P7", reconstruct=False)
    with pytest.raises(UserError, match=device):
        console.wait_for_scan(timeout_s=LONG_S)
    state = console.state()
    assert [one["name"] for one in state["devices"] if one["state"] == "wrong"] == [device]
    assert state["scan"]["state"] == "ended"
    assert state["scan"]["error"].startswith(device)
    assert "--resume" not in state["scan"]["error"]
    lab.bench.twin.repair()
    if state["scans"]:
        console.finish_scan(name, reconstruct=False)
    else:
        console.start_scan(name=name, plant="P7", reconstruct=False)
    console.wait_for_scan(timeout_s=LONG_S)


def test_a_question_is_answered_once(lab: Lab) -> None:
    console, questions, answers = lab.client("Anna"), lab.console.questions, list[str]()
    numbers: list[int] = []
    for question, answer in (("Which angle?", "117.5"), ("Keep its position?", "ok")):
        asking = threading.Thread(target=lambda text=question: answers.append(questions.ask(text, cancelled=lambda: False)))
        asking.start()
        until(lambda text=question: console.state()["question"] == text)
        if numbers:
            with pytest.raises(UserError, match=f"question {numbers[0]} is no longer pending; read the present question"):
                console.answer("117.5", question=numbers[0])  # the second click of a double click
        numbers.append(console.state()["question_number"])
        console.answer(answer, question=numbers[-1])
        asking.join(LONG_S)
    assert answers == ["117.5", "ok"]
    with pytest.raises(UserError, match="there is no question"):
        console.answer("0", question=0)


def test_names_and_links_lead_nowhere_else(lab: Lab, tmp_path: Path) -> None:
    console, outside, scans = lab.client("Anna"), tmp_path / "outside", lab.folder / "scans"
    outside.mkdir()
    (outside / "report.html").write_text("secret")
    (lab.folder / "results" / "linked").symlink_to(outside)

    def start(name: str) -> None:
        console.start_scan(name=name)

    for name in ("..", "../..", "..%2F..%2Foutside", "%2e%2e", ".hidden", "linked", "a/b", "x" * 101, "none", "%00"):
        with pytest.raises(UserError) as error:
            console.request("GET", f"/results/{name}/report.html")
        assert "secret" not in str(error.value)
    for action, name in [*product((start, console.reconstruct), ("../P7", "a/b", ".x", "x" * 101, "P7\n")), (console.reconstruct, "none")]:
        with pytest.raises(UserError):
            action(name)
    long = "\U0001d400" * 100  # too long for a file system; growth is the folder of the growth curves
    for action, name in product((start, console.report), (long, "growth")):
        with pytest.raises(UserError, match="is not a valid name of a scan"):
            action(name)
    assert not list(scans.iterdir())
    for name, goal in (("linked", outside), ("dangling", tmp_path / "made")):
        (scans / name).symlink_to(goal)
        for action in (start, console.finish_scan):
            with pytest.raises(UserError, match=f"scans/{name} is a symbolic link; replace the link by the folder"):
                action(name)
    assert [path.name for path in outside.iterdir()] == ["report.html"]
    assert not (tmp_path / "made").exists()


DATASET = '{"schema_version": 1, "scene": {"subject": {"plant": "P7"}}, "frames": [], "origin": %s}'
DAMAGED = {
    "nested": "[" * 100_000,
    "infinite": DATASET % '{"planned_views": 1e999}',
    "origin": DATASET % "[]",
    "versionless": DATASET.replace('"schema_version": 1, ', "") % '{"complete": true}',
    "version": DATASET.replace(": 1", ": 2") % '{"complete": true}',
    "surrogate": '{"scene": {"subject": {"\\ud800": 1}}, "frames": [], "origin": {}}',
}


def test_damaged_files_do_not_hide_the_state(lab: Lab) -> None:
    for file in ("scans/{}/dataset.json", "results/{}/result.json"):
        for name, text in DAMAGED.items():
            path = lab.folder / file.format(name)
            path.parent.mkdir()
            path.write_text(text)
    (lab.folder / "scans" / "huge").mkdir()
    with (lab.folder / "scans" / "huge" / "dataset.json").open("wb") as stream:
        stream.truncate(2**40)
    console = lab.client("Anna")
    scans = {scan["name"]: scan for scan in console.state()["scans"]}
    assert "more than the maximum of 32 MiB" in scans.pop("huge")["error"]
    assert {name: scan["error"].split(": ")[0] for name, scan in scans.items()} == dict.fromkeys(DAMAGED, "the dataset cannot be read")
    for name in DAMAGED:
        with pytest.raises(UserError, match=f"{name}: the dataset cannot be read: "):
            console.reconstruct(name)


def test_wrong_requests_are_refused_in_a_sentence(lab: Lab) -> None:
    console = lab.client("Anna")
    for values, words in (
        ({"plnt": "P7"}, "plnt: Extra inputs are not permitted"),
        ({"day": 1e9}, "day: Input should be less than or equal"),
        ({"table_angle_deg": float("nan")}, "Input should be"),
        ({"\ud800": 1}, "Extra inputs|valid string"),
    ):
        with pytest.raises(UserError, match=words):
            console.request("POST", "/api/scans", values)
    assert console.state()["schedule"] is None
    with pytest.raises(UserError, match="start it with --experiment"):
        console.start_schedule()
    with pytest.raises(UserError, match="must not exceed 64 KiB, and the header Content-Length is required"):
        console.command("x" * 70_000)


def test_a_second_console_in_the_folder_is_refused(make_lab: Callable[..., Lab]) -> None:
    make_lab()
    with pytest.raises(UserError, match="is using it"):
        make_lab()


def test_no_console_there() -> None:
    with pytest.raises(UserError, match="could not be reached"):
        Console("http://127.0.0.1:9/?token=x").state()
    for address in ("laboratory", "localhost:8080", ""):
        with pytest.raises(UserError, match="is not the address of a console"):
            Console(address)
