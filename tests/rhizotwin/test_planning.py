"""Capture plans tried on the twin: what is varied, what is taken over, which plan is named."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import cases
from rhizotwin import cli, command_line, plan_report, planning, plans
from rhizotwin.plans import Height
from rhizotwin.scenes import files, frames
from rhizotwin.scenes.model import Ring


def row(pictures: int, worst: float, *, image_wh: tuple[int, int] = (800, 600)) -> plans.Row:
    variant = plans.Variant(heights=(Height(-42.0),), views=pictures, image_wh=image_wh)
    return plans.Row(
        variant=variant,
        pictures=pictures,
        volume_error=worst / 2.0,
        volume_error_worst=worst,
        volume_errors=(worst / 2.0, -worst),
        interval_width=0.2,
        interval_holds=1.0,
        length_error=-0.01,
        length_error_worst=0.02,
        length_errors=(-0.02, 0.0),
        recall=0.9,
        precision=0.9,
        capture_min=1.0,
        compute_s=10.0,
    )


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
    assert len({ring.first_deg for ring in changed.plan.rings}) == 3  # the rings' views interleave


def test_the_second_ring_of_the_ladder_can_be_asked_for():
    words = ["plan", "radish_day05a", "-o", "plan", "--heights=-42", "--heights=-42,10:8"]
    asked = command_line.bind(words)[1].arguments["grid"].heights[1]
    variant = plans.Variant(heights=tuple(Height(*one) for one in asked), views=40, image_wh=(800, 600))
    scene = files.load_scene("radish_day05a")
    assert variant.of(scene).plan == cases.Pictures(scene="radish_day05a", rings=2).scene_to_render().plan
    assert variant.name == "40x800x600_at_-42_10tilt8"


def test_three_rings_of_one_plan_have_no_direction_in_common():
    heights = tuple(Height(mm) for mm in (-80.0, -42.0, 10.0))
    rings = plans.Variant(heights=heights, views=4, image_wh=(400, 300)).of(files.load_scene("radish_day05a")).plan.rings
    assert [ring.first_deg for ring in rings] == [0.0, 30.0, 60.0]


def test_table_and_csv_have_a_row_a_plan():
    rows = [row(20, 0.09), replace(row(40, 0.02), length_error=None, length_error_worst=None, length_errors=())]
    lines = plan_report.table(rows).splitlines()
    assert len(lines) == 6
    assert lines[2].split()[:6] == ["-42", "20", "800x600", "+4.5%", "9.0%", "20%"]
    assert lines[2].split()[7:9] == ["-1.0%", "2.0%"]
    assert lines[3].split()[7:9] == ["-", "-"]
    assert "the roots' length or the voxels" in lines[5]
    csv_lines = plan_report.csv_text(rows).splitlines()
    assert len({line.count(",") for line in csv_lines}) == 1
    assert csv_lines[1].startswith("-42,20,800x600,20,0.045,0.09,")


def test_the_cheapest_plan_that_is_good_enough_is_named():
    rows = [row(20, 0.09), row(41, 0.02), row(40, 0.04), row(30, 0.04, image_wh=(1600, 1200))]
    assert planning.best(rows, within=0.05) is rows[2]
    assert planning.best(rows, within=0.01) is None


def test_plans_are_compared_and_a_second_run_takes_them_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "plan"
    words = [
        "plan",
        "sphere_20mm",
        "-o",
        str(out),
        "--views",
        "5,7",
        "--image-wh",
        "200x150",
        "--heights=-42",
        "--heights=-1900",
        "--profile",
        "clean",
        "--device",
        "cpu",
    ]
    assert cli.main([*words, "--within", "50"]) == 0, capsys.readouterr().err
    said = capsys.readouterr().out
    assert "5x200x150_at_-1900 cannot be reconstructed" in said
    assert "cheapest plan within 50 %: 5x200x150_at_-42, 5 pictures" in said
    scores = sorted((out / "scores").iterdir())
    assert [path.name for path in scores if "1900" not in path.name] == ["5x200x150_at_-42_seed0.json", "7x200x150_at_-42_seed0.json"]
    assert (out / "plan.png").stat().st_size > 10000
    lines = (out / "plan.csv").read_text().splitlines()
    assert lines[0].startswith("heights_mm,views_per_ring,image_wh,pictures,volume_error")
    assert lines[1].startswith("-42,5,200x150,5,")

    before = [path.stat().st_mtime_ns for path in scores]
    assert cli.main([*words, "--within", "0.01"]) == 0
    assert "no plan stays within 0.01 %" in capsys.readouterr().out
    assert [path.stat().st_mtime_ns for path in scores] == before


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--views", "0"], "out of range"),
        (["--heights=-42,x"], "not a number of mm"),
        (["--heights=10:"], "not a number of degrees"),
        (["--heights=10:95"], "out of range"),
        (["--within", "0"], "out of range"),
        (["--seeds", "0"], "out of range"),
        (["--heights=-1e9"], "out of range"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_mistakes_are_one_sentence(words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["plan", "sphere_20mm", "-o", str(tmp_path / "plan"), "--device", "cpu", *words]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1
    assert not (tmp_path / "plan").exists()


def test_a_folder_of_something_else_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "letters.txt").write_text("keep me")
    assert cli.main(["plan", "sphere_20mm", "-o", str(tmp_path), "--device", "cpu"]) == 2
    assert "no earlier plan" in capsys.readouterr().err
