"""The walk through the first day, on the emulated rig with scripted answers."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.rig.first_day import Finding, FirstDay, edge_width_px, panel_evenness
from rhizotwin.rig.jog import Jog
from rhizotwin.rig.open import open_devices
from rhizotwin.rig.rig_file import RigFile
from rhizotwin.rig.twin.twin import Twin
from rhizotwin.scenes.files import load_profile
from rhizotwin.scenes.model import Camera, MarkerStrip, Scene, Turntable

SCENE = Scene(
    camera=Camera().resized((400, 300)),
    strip=MarkerStrip(columns=22, rows=1, marker_mm=18.0, bottom_mm=2.0),
    disturbances=load_profile("clean"),
)
ACROSS = {"over the strip's paper": "159.1", "across the canister": "152.5", "ten markers": ""}


def walked(folder: Path, *, scene: Scene | None = None, mirrored: bool = False, no: str = "", rig: RigFile | None = None) -> list[Finding]:
    """Walk through a twin; every question is answered with yes but those that hold ``no``."""
    twin = Twin(SCENE, seed=2, profile_name="clean", pictures="sketch", rig=rig)
    known = scene or twin.calibrated_scene()
    camera = twin.open_camera()
    if mirrored:
        capture = camera.capture
        camera.capture = lambda: replace(shot := capture(), image=np.ascontiguousarray(shot.image[:, ::-1]))
    devices = open_devices(twin.rig, known, clock=twin.clock, camera=camera)

    def answer(question: str) -> str:
        for words, number in ACROSS.items():
            if words in question:
                return number
        if "unexpected" in question:
            return ""
        return "no" if no and no in question else "yes"

    try:
        found = FirstDay(devices, known, ask=answer, say=lambda _: None, folder=folder).walk(wrong_devices=0)
    finally:
        devices.close()
    twin.clock.sleep(1.0)
    assert twin.world.panel.level == twin.world.front.level == 0.0
    return found


def of(found: list[Finding], step: str) -> Finding:
    return next(one for one in found if one.step == step)


def test_a_sound_rig_on_a_tripod(tmp_path: Path) -> None:
    found = walked(tmp_path, rig=RigFile(arm=None))
    assert {one.step: one.verdict for one in found if one.step in ("lamps", "strip", "table")} == dict.fromkeys(
        ("lamps", "strip", "table"), "ok"
    )
    assert of(found, "table").measured["turned_deg"] == pytest.approx(9.0, abs=0.3)
    assert [one.verdict for one in found if one.step.startswith("joint")] == ["skipped"] * 5
    assert [one.verdict for one in found if one.step == "calipers"] == ["ok", "ok", "skipped"]
    kept = json.loads((tmp_path / "first_day.json").read_text())
    assert len(kept["findings"]) == len(found)
    assert "| table | ok |" in (tmp_path / "first_day.md").read_text()
    assert (tmp_path / "focus.png").stat().st_size > 0


def test_a_table_that_turns_the_other_way_is_told(tmp_path: Path) -> None:
    wrong = replace(SCENE, turntable=Turntable(direction=-1), disturbances=type(SCENE.disturbances)())
    found = of(walked(tmp_path, scene=wrong, rig=RigFile(arm=None)), "table")
    assert found.verdict == "wrong"
    assert "the other way" in found.text


def test_a_mirrored_picture_is_told(tmp_path: Path) -> None:
    found = of(walked(tmp_path, mirrored=True, rig=RigFile(arm=None)), "strip")
    assert found.verdict == "wrong"
    assert "mirrored" in found.text


def test_joints_move_and_come_back(tmp_path: Path) -> None:
    found = walked(tmp_path, no="the shoulder lean")
    joints = [one for one in found if one.step.startswith("joint")]
    assert [one.verdict for one in joints] == ["ok", "wrong", "ok", "ok", "ok"]
    assert "set sign of arm.joints 2" in joints[1].text
    assert all(one.measured["moved_deg"] == pytest.approx(5.0, abs=1.5) for one in joints)


def test_a_sound_rig_with_an_arm_is_brought_before_the_canister(tmp_path: Path) -> None:
    """A parked arm sees the bare panel: neither strip nor focus can be judged there."""
    found = walked(tmp_path)
    assert {one.step: one.verdict for one in found if one.verdict != "skipped"} == dict.fromkeys(
        ("devices", "lamps", *(f"joint {k}" for k in range(1, 6)), "arm", "focus", "strip", "panel", "table", "calipers"), "ok"
    )
    assert "markers turned by" in of(found, "table").text


def test_an_arm_goes_nowhere_before_its_joints_are_right(tmp_path: Path) -> None:
    found = walked(tmp_path, no="the wrist lean")
    assert [of(found, step).verdict for step in ("joint 4", "arm", "focus", "strip", "panel")] == ["wrong", *["skipped"] * 4]
    assert of(found, "table").verdict == "ok"


def test_focus_is_not_judged_on_a_bare_panel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Jog, "shot", lambda _: np.rint(np.tile(np.linspace(48000.0, 50000.0, 400), (300, 1))).astype(np.uint16))
    found = of(walked(tmp_path, rig=RigFile(arm=None)), "focus")
    assert found.verdict == "wrong"
    assert "nothing dark stands before the panel" in found.text


def test_an_answer_that_is_missing_leaves_the_rig_safe_and_the_report(tmp_path: Path) -> None:
    twin = Twin(SCENE, seed=2, profile_name="clean", pictures="sketch", rig=RigFile(arm=None))
    devices = open_devices(twin.rig, twin.calibrated_scene(), clock=twin.clock, camera=twin.open_camera())
    answers: Iterator[str] = iter(["yes"])

    def answer(_: str) -> str:
        try:
            return next(answers)
        except StopIteration:
            raise KeyboardInterrupt from None

    with pytest.raises(KeyboardInterrupt):
        FirstDay(devices, twin.calibrated_scene(), ask=answer, say=lambda _: None, folder=tmp_path).walk(wrong_devices=0)
    devices.close()
    twin.clock.sleep(1.0)
    assert twin.world.panel.level == 0.0
    assert (tmp_path / "first_day.md").exists()


@pytest.mark.parametrize("blur_px", [1.0, 2.0, 4.0])
def test_width_of_an_edge(blur_px: float) -> None:
    x = np.arange(200.0)
    edge = np.clip((x - 100.0) / blur_px + 0.5, 0.0, 1.0)
    image = np.rint(1000.0 + 50000.0 * np.tile(edge, (100, 1))).astype(np.uint16)
    # central differences see nothing narrower than two pixels
    assert edge_width_px(image) == pytest.approx(max(blur_px, 2.0), rel=0.05)


def test_evenness_of_a_slope() -> None:
    image = np.tile(np.linspace(0.5, 1.0, 320), (240, 1))
    image[:60] = 0.05  # not the panel
    share = panel_evenness(np.rint(60000.0 * image).astype(np.uint16))
    assert share == pytest.approx(0.53, abs=0.04)
