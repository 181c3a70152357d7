"""The walk through the first day, on the emulated rig with scripted answers."""

import json
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rhizotwin.commands import rig as rig_commands
from rhizotwin.rig.first_day import Finding, FirstDay, edge_width_px, panel_evenness
from rhizotwin.rig.jog import Jog
from rhizotwin.rig.rig_file import RigFile
from rhizotwin.rig.twin.twin import Twin
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene, Turntable
from rhizotwin.steps import rigs
from tests.rig.fake_devices import CLEAN as SCENE
from tests.rig.fake_devices import opened

ACROSS = {"over the strip's paper": "159.1", "across the canister": "152.5", "ten markers": ""}

TRIPOD = RigFile(arm=None)
Answers = Callable[[str], str]


def answers(no: str = "") -> Answers:
    """Return who answers every question with yes but those that hold ``no``."""

    def answer(question: str) -> str:
        for words, number in ACROSS.items():
            if words in question:
                return number
        return "" if "unexpected" in question else "no" if no and no in question else "yes"

    return answer


def walked(folder: Path, *, scene: Scene | None = None, mirrored: bool = False, ask: Answers | None = None, **rig: Any) -> list[Finding]:
    """Walk through a twin, which must be left with its lamps off."""
    twin = Twin(SCENE, seed=2, profile_name="clean", pictures="sketch", **rig)
    known, camera = scene or twin.calibrated_scene(), twin.open_camera()
    if mirrored:
        capture = camera.capture
        camera.capture = lambda: replace(shot := capture(), image=np.ascontiguousarray(shot.image[:, ::-1]))
    try:
        with opened(twin, scene=known, camera=camera) as devices:
            return FirstDay(devices, known, ask=ask or answers(), say=lambda _: None, folder=folder).walk(wrong_devices=0)
    finally:
        assert twin.world.panel.level == twin.world.front.level == 0.0


def of(found: list[Finding], step: str) -> Finding:
    return next(one for one in found if one.step == step)


OTHER_WAY = replace(SCENE, turntable=Turntable(direction=-1), disturbances=Disturbances())
WRONG = [("table", "The direction is wrong", {"scene": OTHER_WAY}), ("strip", "mirrored", {"mirrored": True})]


@pytest.mark.parametrize(("step", "named", "options"), WRONG, ids=["direction", "mirrored"])
def test_a_wrong_direction_and_a_mirrored_picture_are_found(step: str, named: str, options: dict[str, Any], tmp_path: Path) -> None:
    every = walked(tmp_path, rig=TRIPOD, **options)
    assert [one.verdict for one in every if one.step.startswith("joint")] == ["skipped"] * 5
    found = of(every, step)
    assert found.verdict == "wrong"
    assert named in found.text


def test_joints_move_and_come_back(tmp_path: Path) -> None:
    found = walked(tmp_path, ask=answers(no="the shoulder lean"))
    joints = [one for one in found if one.step.startswith("joint")]
    assert [one.verdict for one in joints] == ["ok", "wrong", "ok", "ok", "ok"]
    assert "reverse the sign of arm.joints 2" in joints[1].text
    assert all(one.measured["moved_deg"] == pytest.approx(5.0, abs=1.5) for one in joints)
    # The arm goes nowhere before its joints are right.
    assert [of(found, step).verdict for step in ("arm", "focus", "strip", "panel", "table")] == [*["skipped"] * 4, "ok"]


def test_a_sound_rig_with_an_arm_is_brought_before_the_canister(tmp_path: Path) -> None:
    found = walked(tmp_path)
    assert {one.step: one.verdict for one in found if one.verdict != "skipped"} == dict.fromkeys(
        ("devices", "lamps", *(f"joint {k}" for k in range(1, 6)), "arm", "focus", "strip", "panel", "table", "calipers"), "ok"
    )
    assert of(found, "table").measured["turned_deg"] == pytest.approx(9.0, abs=0.3)
    assert [one.verdict for one in found if one.step == "calipers"] == ["ok", "ok", "skipped"]
    assert len(json.loads((tmp_path / "first_day.json").read_text())["findings"]) == len(found)
    assert "| table | ok |" in (tmp_path / "first_day.md").read_text()


def test_focus_is_not_judged_on_a_bare_panel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Jog, "shot", lambda _: np.rint(np.tile(np.linspace(48000.0, 50000.0, 400), (300, 1))).astype(np.uint16))
    found = of(walked(tmp_path, rig=TRIPOD), "focus")
    assert found.verdict == "wrong"
    assert "no dark object is visible in front of the panel" in found.text


def test_the_end_of_the_input_ends_before_anything_turns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", StringIO("yes\n"))
    bench = rigs.open_bench("twin", None, errors=rigs.TwinErrors())
    with ExitStack() as stack, pytest.raises(UserError, match="a question was not answered"):
        rig_commands._walk(bench, tmp_path, None, 0, stack)
    assert bench.twin.world.table.steps == 0
    assert (tmp_path / "first_day.md").exists()


@pytest.mark.parametrize("blur_px", [1.0, 4.0])
def test_width_of_an_edge(blur_px: float) -> None:
    edge = np.clip((np.arange(200.0) - 100.0) / blur_px + 0.5, 0.0, 1.0)
    image = np.rint(1000.0 + 50000.0 * np.tile(edge, (100, 1))).astype(np.uint16)
    # central differences see nothing narrower than two pixels
    assert edge_width_px(image) == pytest.approx(max(blur_px, 2.0), rel=0.05)


def test_evenness_of_a_slope() -> None:
    slope = np.tile(np.linspace(0.5, 1.0, 320), (240, 1))
    slope[:60] = 0.05  # not the panel
    assert panel_evenness(np.rint(60000.0 * slope).astype(np.uint16)) == pytest.approx(0.53, abs=0.04)
