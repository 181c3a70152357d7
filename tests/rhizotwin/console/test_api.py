"""The console's API over HTTP: control, commands, scans and their interruptions on the emulated rig."""

import json
import threading
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.arguments import SubjectOptions
from rhizotwin.catalogue.records import Plant
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.console.client import Console
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.twin.faults import Fault
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.subject import Subject
from tests.rhizotwin.console.conftest import LONG_S, VIEWS, Lab, until


def test_one_client_has_control_and_everyone_sees_who(lab: Lab) -> None:
    anna, robot = lab.client(), lab.client()
    with pytest.raises(UserError, match="take control first"):
        anna.command("pose")
    anna.take_control("Anna")
    assert robot.state()["controls"]["name"] == "Anna"
    assert not robot.state()["controls"]["own"]
    assert anna.state()["controls"]["own"]
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


def test_devices_and_commands(lab: Lab) -> None:
    console = lab.client("Anna")
    assert {device["state"] for device in console.state()["devices"]} == {"unknown"}
    assert {device["name"]: device["state"] for device in console.check_devices()} == dict.fromkeys(
        ("turntable", "lights", "arm", "camera", "picture", "markers", "disk"), "ok"
    )
    assert "table at 0.000 deg" in console.command("home 0")
    assert console.command("table +9") == ["table at 9.000 deg"]
    with pytest.raises(UserError, match="is invalid; usage: table"):
        console.command("table nan")
    outside = lab.folder.parent / "outside.png"
    for line in (f"picture {outside}", "quit", "", "help"):
        with pytest.raises(UserError, match="is not a command"):
            console.command(line)
    assert not outside.exists()
    name = console.take_picture()
    assert (lab.folder / "pictures" / name).is_file()
    console.release_devices()
    assert not console.state()["open"]


def test_live_pictures_with_measurements(lab: Lab) -> None:
    console = lab.client("Anna")
    console.command("lights 1 1")
    console.command("go 400 -20")
    console.request("POST", "/api/live", {"on": True})
    picture = until(lambda: console.state()["picture"])
    assert picture["title"].startswith("live, ")
    assert {meter["name"]: meter["state"] for meter in picture["meters"]} == {"Markers": "good", "Focus": "good", "Exposure": "good"}
    assert console.picture().startswith(b"\xff\xd8")
    console.request("POST", "/api/live", {"on": False})
    assert not console.state()["live"]


def test_an_error_of_a_live_picture_does_not_end_the_rig_thread(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    console = lab.client("Anna")
    monkeypatch.setattr("rhizotwin.console.console.show", lambda *_, **__: 1 / 0)
    console.request("POST", "/api/live", {"on": True})
    message = until(lambda: [one for one in console.state()["messages"] if one["kind"] == "error"])[0]
    assert "division by zero" in message["text"]
    assert not console.state()["live"]
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
    with pytest.raises(UserError, match="the rig is busy"):
        console.start_scan(plant="P8")
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
    with pytest.raises(UserError, match="the pictures are sketches of the emulated rig, which show no roots; scan with --fidelity render"):
        console.reconstruct(name)
    dataset = load_dataset(lab.folder / "scans" / name)
    assert dataset.origin["complete"]
    assert dataset.scene.subject.plant == "P7"
    assert [device["state"] for device in console.state()["devices"] if device["name"] == "camera"] == ["ok"]
    cells = np.frombuffer(console.request("GET", "/api/sketch"), "<f4")
    assert len(cells) % 3 == 1
    with pytest.raises(UserError, match="no scan is running"):
        console.pause_scan()


def test_a_scan_that_cannot_begin_is_reported(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    """An arm that does not park ends the scan before the first device is opened; the scan before it is not shown in its place."""

    def fail() -> None:
        raise RigError("arm: no reply; switch it on")

    monkeypatch.setattr(lab.console.rig, "let_go", fail)
    console = lab.client("Anna")
    console.start_scan(name="second")
    with pytest.raises(UserError, match="arm: no reply; switch it on"):
        console.wait_for_scan(timeout_s=LONG_S)
    scan = console.state()["scan"]
    assert (scan["name"], scan["state"], scan["error"]) == ("second", "ended", "arm: no reply; switch it on")


def test_the_plant_of_the_scene_file_is_not_recorded_for_another_plant(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_a_console_that_is_started_again_finishes_the_scan(lab: Lab) -> None:
    console = lab.client("Anna")
    name = console.start_scan(plant="P7", reconstruct=False)
    until(lambda: console.state()["scan"] and console.state()["scan"]["done"] >= 1)
    lab.stop()
    lab.start()
    console = lab.client("Anna")
    entry = console.state()["scans"][0]
    if not entry["complete"]:
        console.finish_scan(name, reconstruct=False)
        console.wait_for_scan(timeout_s=LONG_S)
    dataset = load_dataset(lab.folder / "scans" / name)
    assert dataset.origin["complete"]
    assert len(dataset.frames) == VIEWS


@pytest.mark.parametrize(
    ("fault", "device"),
    [
        (Fault(kind="unplugged", device="table", amount=0.0), "turntable"),
        (Fault(kind="stalled", device="arm", amount=0.0, joint=1), "arm"),
        (Fault(kind="camera_stopped", device="camera", amount=0.0), "camera"),
    ],
    ids=["table unplugged", "arm blocked", "camera gone"],
)
def test_a_device_that_fails_is_reported_with_what_to_do(lab: Lab, fault: Fault, device: str) -> None:
    console = lab.client("Anna")
    lab.bench.twin.inject(fault)
    name = console.start_scan(plant="P7", reconstruct=False)
    with pytest.raises(UserError, match=device):
        console.wait_for_scan(timeout_s=LONG_S)
    state = console.state()
    wrong = {device["name"]: device["text"] for device in state["devices"] if device["state"] == "wrong"}
    assert set(wrong) == {device}
    assert not any(message["text"].startswith("the program was stopped by an unexpected error") for message in state["messages"])
    assert state["scan"]["state"] == "ended"
    assert state["scan"]["error"].startswith(device)
    assert "--resume" not in state["scan"]["error"]
    lab.bench.twin.repair()
    if state["scans"]:
        console.finish_scan(name, reconstruct=False)
    else:
        console.start_scan(name=name, plant="P7", reconstruct=False)
    console.wait_for_scan(timeout_s=LONG_S)


def test_a_question_waits_for_its_answer(lab: Lab) -> None:
    console = lab.client("Anna")
    with pytest.raises(UserError, match="there is no question"):
        console.answer("0", question=0)
    questions, answers = lab.console.questions, []
    asking = threading.Thread(target=lambda: answers.append(questions.ask("Which angle?", cancelled=lambda: False)))
    asking.start()
    until(lambda: console.state()["question"] == "Which angle?")
    first = console.state()["question_number"]
    console.answer("117.5", question=first)
    asking.join(LONG_S)
    assert answers == ["117.5"]
    assert console.state()["question"] == ""
    with pytest.raises(KeyboardInterrupt):
        questions.ask("Which angle?", cancelled=lambda: True)
    asking = threading.Thread(target=lambda: answers.append(questions.ask("Keep its position?", cancelled=lambda: False)))
    asking.start()
    until(lambda: console.state()["question"])
    with pytest.raises(UserError, match=f"question {first} is no longer pending; read the present question"):
        console.answer("117.5", question=first)  # the second click of a double click
    console.answer("ok", question=console.state()["question_number"])
    asking.join(LONG_S)
    assert answers == ["117.5", "ok"]


def test_names_lead_nowhere_else(lab: Lab, tmp_path: Path) -> None:
    console = lab.client("Anna")
    secret = tmp_path / "secret"
    secret.mkdir()
    (secret / "report.html").write_text("secret")
    (lab.folder / "results" / "linked").symlink_to(secret)
    for name in ("..", "../..", "..%2F..%2Fsecret", "%2e%2e", ".hidden", "linked", "a/b", "x" * 101, "none", "%00"):
        with pytest.raises(UserError) as error:
            console.request("GET", f"/results/{name}/report.html")
        assert "secret" not in str(error.value).replace(name, "")
    for name in ("../P7", "a/b", ".x", "x" * 101, "P7\n", ""):
        if name:
            with pytest.raises(UserError):
                console.start_scan(name=name)
        with pytest.raises(UserError):
            console.reconstruct(name or "none")
    assert not list((lab.folder / "scans").iterdir())


def test_a_scan_is_not_written_through_a_link(lab: Lab, tmp_path: Path) -> None:
    console = lab.client("Anna")
    outside = tmp_path / "outside"
    outside.mkdir()
    for name, goal in (("linked", outside), ("dangling", tmp_path / "made")):
        (lab.folder / "scans" / name).symlink_to(goal)
        with pytest.raises(UserError, match=f"scans/{name} is a symbolic link; replace the link by the folder"):
            console.start_scan(name=name)
        with pytest.raises(UserError, match=f"scans/{name} is a symbolic link; replace the link by the folder"):
            console.finish_scan(name)
    assert not list(outside.iterdir())
    assert not (tmp_path / "made").exists()
    for name in ("\U0001d400" * 100, "growth"):  # too long for a file system; the folder of the growth curves
        with pytest.raises(UserError, match="is not a valid name of a scan"):
            console.start_scan(name=name)
        with pytest.raises(UserError, match="is not a valid name of a scan"):
            console.report(name)


DATASET = '{"schema_version": 1, "scene": {"subject": {"plant": "P7"}}, "frames": [], "origin": %s}'


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000,
        "[]",
        DATASET % '{"planned_views": 1e999}',
        DATASET % "[]",
        '{"scene": {"subject": {"\\ud800": 1}}, "frames": [], "origin": {}}',
        "\0",
    ],
    ids=["nested", "list", "infinite", "origin", "surrogate", "binary"],
)
def test_a_damaged_file_does_not_hide_the_state(lab: Lab, text: str) -> None:
    for name, parent in (("dataset.json", "scans"), ("result.json", "results")):
        (lab.folder / parent / "P7").mkdir()
        (lab.folder / parent / "P7" / name).write_text(text)
    (scan,) = lab.client().state()["scans"]
    assert scan["error"].startswith("the dataset cannot be read: ")
    assert "the program was stopped" not in scan["error"]  # the console goes on
    assert scan["result"] is None
    with pytest.raises(UserError, match="P7: the dataset cannot be read: "):
        lab.client("Anna").reconstruct("P7")


def test_a_huge_file_is_not_read(lab: Lab) -> None:
    (lab.folder / "scans" / "P7").mkdir()
    with (lab.folder / "scans" / "P7" / "dataset.json").open("wb") as stream:
        stream.truncate(2**40)
    (scan,) = lab.client().state()["scans"]
    assert "more than the maximum of 32 MiB" in scan["error"]


def test_wrong_requests_are_refused_in_a_sentence(lab: Lab) -> None:
    console = lab.client("Anna")
    with pytest.raises(UserError, match="plnt: Extra inputs are not permitted"):
        console.request("POST", "/api/scans", {"plnt": "P7"})
    with pytest.raises(UserError, match="day: Input should be less than or equal"):
        console.start_scan(day=1e9)
    with pytest.raises(UserError, match="must be a date"):
        console.start_scan(date="yesterday")
    with pytest.raises(UserError, match="Not Found"):
        console.request("GET", "/api/nothing")
    for values in ({"table_angle_deg": float("nan")}, {"plant": "\ud800"}, {"\ud800": 1}):
        with pytest.raises(UserError, match=r"Input should be|Extra inputs|valid string"):
            console.request("POST", "/api/scans", values)
    with pytest.raises(UserError, match="must not exceed 64 KiB, and the header Content-Length is required"):
        console.request("POST", "/api/command", {"line": "x" * 70_000})


def test_the_schema_has_every_action_of_the_client(lab: Lab) -> None:
    schema = lab.client().request("GET", "/api/openapi.json")
    assert {"/api/state", "/api/control", "/api/command", "/api/scans", "/api/scans/{name}/finish", "/api/queue"} <= set(schema["paths"])
    assert all(method.get("description") for path in schema["paths"].values() for method in path.values())
    assert set(schema["components"]["schemas"]["StartScan"]["properties"]) > {"plant", "treatment", "day", "reconstruct"}
    json.dumps(schema)


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
