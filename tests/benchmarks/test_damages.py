"""The stress tests spoil what they say, and only a wrong volume that is called trusted fails."""

import json
import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from benchmarks import __main__ as command
from benchmarks import cases, damages
from benchmarks.damaged_scan import Damage, Light, Scan
from rhizotwin import engine
from rhizotwin.scenes import atomic
from rhizotwin.scenes import frames as frames_of
from rhizotwin.scenes.dataset import Dataset, Frame, file_sha256, load_dataset, read_image, save_dataset
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from rhizotwin.scenes.truth import TrueView, Truth, save_truth
from tests.recon.hull.exact_pictures import rows

VIEWS = 16
SAID = ("reversed", "step-other", "focal-said-3-more", "strip-said-3-more", "n-said-1.37", "radius-said-3-more", "stopped")
"""These change what is said of the pictures, not the pictures."""


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Scan:
    """Pictures of noise on a panel, with a box for a specimen."""
    folder = tmp_path_factory.mktemp("clean")
    scene = Scene(camera=Camera().resized((160, 120)), plan=CapturePlan(rings=(Ring(views=VIEWS),)))
    (folder / "images").mkdir()
    frames, views = [], []
    for k in range(VIEWS):
        name, path = f"images/{k:03d}.png", folder / f"images/{k:03d}.png"
        atomic.write_image(path, np.random.default_rng(k).integers(20000, 40000, (120, 160), np.uint16))
        frames.append(Frame(file=name, sha256=file_sha256(path), table_deg=360.0 * k / VIEWS))
        pose = frames_of.level_camera(distance_mm=400.0, height_mm=-60.0, tilt_deg=0.0) @ frames_of.rotation_z(2.0 * math.pi * k / VIEWS)
        views.append(TrueView(file=name, cam_from_canister=rows(pose), table_deg=360.0 * k / VIEWS))
    save_dataset(Dataset(folder=folder, scene=scene, frames=tuple(frames), origin={}))
    (folder / "truth").mkdir()
    specimen = trimesh.creation.capsule(height=50.0, radius=5.0).apply_translation((0.0, 0.0, -85.0))
    specimen.export(folder / "truth" / "specimen.ply")
    box = {"extents_min_mm": (-5.0, -5.0, -90.0), "extents_max_mm": (5.0, 5.0, -30.0)}
    save_truth(folder, Truth(volume_mm3=6000.0, **box, n_water=1.333, canister_from_strip=rows(np.eye(4)), views=tuple(views)))
    return Scan.read(folder)


def test_every_damage_can_be_read_and_differs_from_clean(scan: Scan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", lambda _: None)  # nothing here need outlast a power cut, and that is most of the time
    every = damages.catalogue(lambda: replace(scan, light=scan.light[::-1]))
    assert len({damage.name for damage in every}) == len(every)
    for damage in every:
        written = load_dataset(damage.write(scan, tmp_path / damage.name).folder)
        image = read_image(written, written.frames[0])
        assert image.shape[::-1] == written.scene.camera.image_wh, damage.name
        assert (written.folder / "truth" / "truth.json").is_file()
        assert damage.name == "none" or is_spoilt(scan, damage), damage.name


@pytest.mark.parametrize("scene", ["sphere_20mm", "printed_8ml", "radish_day05a"])
def test_the_other_scan_shows_another_scene_in_the_same_size(scene: str) -> None:
    other, (scan, *_) = damages.other_pictures(scene), cases.quick(scenes=(scene,), profiles=("clean",), methods=("coverage",))
    assert other.scene != scene
    assert other.image_wh == scan.pictures.image_wh


def is_spoilt(scan: Scan, damage: Damage) -> bool:
    if damage.name in SAID:
        said = damage.scene(scan.dataset.scene) != scan.dataset.scene
        return said or damage.table_deg(scan, 7) != scan.frames[7].table_deg or not damage.keeps(scan, scan.count - 1)
    stored = damage.stored.encode(scan.light[7]) != Damage(name="", why="").stored.encode(scan.light[7])
    return stored or any(differs(damage.light(scan, k), scan.light[k]) for k in range(scan.count))


def differs(one: Light, other: Light) -> bool:
    return one.shape != other.shape or float(np.abs(one - other).max()) > 1e-3


def record(error: float, interval: tuple[float, float], *, trusted: bool) -> dict[str, Any]:
    about = {"name": "a", "why": "b", "refused": None, "crashed": None, "wall_s": 1.0, "verdict": "c", "checks": []}
    return about | {"volume_error": error, "interval": list(interval), "trusted": trusted}


def test_only_a_wrong_volume_that_is_trusted_and_a_crash_fail() -> None:
    wrong = record(0.1, (0.05, 0.15), trusted=True)
    refused = {"name": "mirrored", "why": "a mirror", "refused": "no marker", "crashed": None}
    assert damages.fails(wrong)
    assert not damages.fails(record(0.1, (0.05, 0.15), trusted=False))
    assert not damages.fails(record(0.1, (-0.05, 0.15), trusted=True))
    assert not damages.fails(record(0.03, (0.01, 0.05), trusted=True))
    assert damages.fails(record(math.nan, (math.nan, math.nan), trusted=True))
    assert not damages.fails(refused)
    assert damages.fails({"refused": None, "crashed": "KeyError"})


def test_a_crash_ends_with_1_and_the_others_are_tried(
    scan: Scan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def crash(_: Dataset) -> None:
        raise ZeroDivisionError("a crash")

    monkeypatch.setattr(damages.datasets, "make", lambda _: scan.dataset.folder)
    monkeypatch.setattr(damages, "reconstruct", crash)
    monkeypatch.setattr(engine, "start", lambda _: "cpu")
    assert command.main(["damages", "--names", "none,black-level", "-o", str(tmp_path / "found.json")]) == 1
    records = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))["records"]
    assert [record["name"] for record in records] == ["none", "black-level"]
    assert all("ZeroDivisionError: a crash" in record["crashed"] for record in records)
    assert "[2/2] black-level: CRASHED" in capsys.readouterr().out
