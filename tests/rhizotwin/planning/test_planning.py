"""Capture plans tried on the twin: what is varied, what is taken over, which plan is named."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import cases
from rhizotwin.commands import command_line
from rhizotwin.planning import comparison, plans
from rhizotwin.planning.plans import Height
from rhizotwin.scenes import files, frames
from rhizotwin.scenes import plan as capture
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from rhizotwin.scenes.plan import marker_warnings
from rhizotwin.scenes.specimens import MeshSpecimen
from rhizotwin.scenes.terminal import OneBar
from tests.command import Command


def row(pictures: int, worst: float, *, image_wh: tuple[int, int] = (800, 600)) -> plans.Row:
    variant = plans.Variant(heights=(Height(-42.0),), views=pictures, image_wh=image_wh)
    volume = {"volume_error": worst / 2.0, "volume_error_worst": worst, "volume_errors": (worst / 2.0, -worst)}
    length = {"length_error": -0.01, "length_error_worst": 0.02, "length_errors": (-0.02, 0.0)}
    shares = {"interval_width": 0.2, "interval_holds": 1.0, "recall": 0.9, "precision": 0.9}
    return plans.Row(variant=variant, pictures=pictures, capture_min=1.0, compute_s=10.0, **volume, **length, **shares)


def test_every_ring_of_a_variant_looks_at_the_same_point():
    scene = files.load_scene("sphere_20mm")
    scene = replace(scene, plan=replace(scene.plan, rings=(Ring(height_mm=-10.0, tilt_deg=5.0, distance_mm=390.0),)))
    changed = plans.Variant(heights=(Height(-10.0), Height(-90.0), Height(60.0)), views=7, image_wh=(400, 300)).of(scene)
    assert changed.camera.image_wh == (400, 300)
    assert changed.plan.rings[0].tilt_deg == pytest.approx(5.0)
    aim = []
    for ring in changed.plan.rings:
        assert ring.views == 7
        rig_from_cam = frames.invert(frames.level_camera(distance_mm=ring.distance_mm, height_mm=ring.height_mm, tilt_deg=ring.tilt_deg))
        origin, forward = rig_from_cam[:3, 3], rig_from_cam[:3, 2]
        aim.append((origin + forward * (origin[0] / -forward[0]))[2])
    np.testing.assert_allclose(aim, aim[0], atol=1e-9)
    first = [ring.first_deg * 7 / 360.0 for ring in changed.plan.rings]  # in steps of a ring
    assert first == pytest.approx([0.0, 1.0 / 3.0, 2.0 / 3.0])  # no two views have one direction


def test_rings_of_a_variant_are_like_the_first_ring():
    scene = files.load_scene("radish_bands")
    variant = plans.Variant(heights=(Height(-42.0), Height(10.0)), views=10, image_wh=(400, 300))
    assert capture.count_pictures(variant.of(scene)) == 20  # the first ring has one band of six
    first = replace(scene.plan.rings[0], span_deg=120.0, jitter_mm=2.0, jitter_deg=0.5)
    rings = variant.of(replace(scene, plan=replace(scene.plan, rings=(first,)))).plan.rings
    assert [(ring.span_deg, ring.jitter_mm, ring.jitter_deg) for ring in rings] == [(120.0, 2.0, 0.5)] * 2
    assert [ring.first_deg for ring in rings] == pytest.approx([0.0, 6.0])
    patch = Ring(views=3, distance_mm=200.0, first_deg=30.0, span_deg=90.0)
    turn = replace(Scene(), plan=CapturePlan(rings=(Ring(views=4), patch)))
    assert [view.table_deg for view in capture.views(turn)] == pytest.approx([0.0, 90.0, 180.0, 270.0, 30.0, 60.0, 90.0])


def test_rings_are_asked_for_on_the_command_line():
    words = ["plan", "radish_day05a", "-o", "plan", "--heights=-42,10:8", "--heights=-42,-14:0@200"]
    asked = command_line.bind(words)[1].arguments["grid"].heights
    ladder, near = (plans.Variant(heights=tuple(Height(*one) for one in own), views=40, image_wh=(800, 600)) for own in asked)
    assert (ladder.name, near.name) == ("40x800x600_at_-42_10tilt8", "40x800x600_at_-42_-14tilt0from200")
    scene = files.load_scene("radish_day05a")
    assert ladder.of(scene).plan == cases.Pictures(scene="radish_day05a", rings=2).scene_to_render().plan
    rings = near.of(scene).plan.rings
    assert [(ring.height_mm, ring.distance_mm, ring.tilt_deg) for ring in rings] == [(-42.0, 400.0, 0.0), (-14.0, 200.0, 0.0)]


def test_the_cheapest_plan_within_a_limit_is_named():
    rows = [row(20, 0.09), row(41, 0.02), row(40, 0.04), row(30, 0.04, image_wh=(1600, 1200))]
    assert comparison.best(rows, within=0.05) is rows[2]
    assert comparison.best(rows, within=0.01) is None


@pytest.mark.slow
def test_plans_are_compared_and_a_second_run_takes_them_over(tmp_path: Path, command: Command) -> None:
    out = tmp_path / "plan"
    words = ("plan", "sphere_20mm", "-o", out, "--views", "5", "--image-wh", "200x150", "--heights=-42", "--heights=-1900")
    words = (*words, "--profile", "clean", "--device", "cpu")
    told = command.works(*words, "--within", "50").out
    assert "5x200x150_at_-1900 could not be reconstructed" in told
    assert "plan with the fewest pixels and a volume error of at most 50 %: 5x200x150_at_-42, 5 pictures" in told
    scores = sorted((out / "scores").iterdir())
    assert "5x200x150_at_-42_seed0.json" in [path.name for path in scores]
    assert (out / "plan.png").stat().st_size > 10000
    lines = (out / "plan.csv").read_text().splitlines()
    assert lines[0].startswith("heights_mm,views_per_ring,image_wh,pictures,volume_error")
    assert lines[1].startswith("-42,5,200x150,5,")

    before = [path.stat().st_mtime_ns for path in scores]
    assert "no plan has a volume error of at most 0.01 %" in command.works(*words, "--within", "0.01").out
    assert [path.stat().st_mtime_ns for path in scores] == before


def test_plans_are_scored_again_after_the_mesh_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings: list[object] = []
    monkeypatch.setattr(comparison, "_run", lambda *given: settings.append(given[3]))
    scene = replace(Scene(), specimen=MeshSpecimen(file=str(tmp_path / "root.stl")))
    for data in (b"a root", b"a root", b"a thicker root"):
        (tmp_path / "root.stl").write_bytes(data)
        comparison.run_plans(scene, (), tmp_path / "plan", profile_name="clean", seeds=1, bar=OneBar({}, quiet=True))
    assert settings[0] == settings[1] != settings[2]


@pytest.mark.parametrize(("height_mm", "distance_mm", "blind"), [(-22.0, 200.0, True), (-14.0, 200.0, False)])
def test_a_ring_that_sees_no_strip_is_said_beforehand(height_mm: float, distance_mm: float, blind: bool):
    """As simulated scans of 400x300: at -22 mm no markers were found in any of 40 pictures, at -14 mm in all."""
    ring = Ring(height_mm=height_mm, distance_mm=distance_mm)
    scene = replace(Scene(camera=Camera().resized((400, 300))), plan=CapturePlan(rings=(Ring(), ring)))
    found = marker_warnings(scene)
    assert bool(found) == blind
    assert not blind or found[0].startswith(f"ring 2 (200 mm away, height {height_mm:g} mm) sees fewer than 4 complete markers")


def test_a_telecentric_camera_sees_markers_from_any_distance():
    camera = Camera(kind="telecentric", mm_per_px=0.3, focal_px=(1e5, 1e5))
    scenes = [replace(Scene(camera=camera), plan=CapturePlan(rings=(Ring(distance_mm=distance),))) for distance in (150.0, 900.0)]
    assert [marker_warnings(scene) for scene in scenes] == [[], []]
    near = replace(scenes[0], camera=replace(camera, mm_per_px=0.1))  # the picture ends 30 mm above its centre, below the strip
    assert marker_warnings(near)
