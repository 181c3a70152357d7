"""The page that sets the thesis beside its method and ours."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import ladder, thesis_figures, thesis_page
from benchmarks.assumptions import Assumptions, Carved, CountedVolumes, Level
from benchmarks.cases import Pictures
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes.model import Scene


def record(scene: str, method: str, rings: int, mm3: float, commit: str = "0123abcd") -> dict[str, Any]:
    case = {"name": f"{scene}/clean/{'2x' * (rings == 2)}40x800x600/0.27/{method}", "scene": scene, "method": method, "rings": rings}
    interval = [0.9 * mm3, 1.1 * mm3] if method == "coverage" else None
    return {"case": case, "commit": commit, "score": {"volume_mm3": mm3, "volume_interval_mm3": interval}}


def carved(ml: float, cpu_s: float, grid_cpu_s: float | None = None) -> Carved:
    return Carved(ml=ml, cpu_s=cpu_s, voxels=70000, extents_mm=(70.0, 74.0, 90.0), grid_cpu_s=grid_cpu_s)


def test_plants_of_thesis_are_those_of_the_library() -> None:
    first, last = record("radish_day05a", "thesis", 2, 600.0), record("radish_day30c", "coverage", 1, 1750.0)
    found = thesis_page.plants([first, last])
    assert len(found) == 18
    assert (found[0].name, found[0].thesis_ml, found[0].grams) == ("radish 1", 1.79, 0.0348)
    assert found[0].runs == {("thesis", 2): first}
    assert found[16].thesis_ml is None
    assert found[17].runs == {("coverage", 1): last}
    grams = {one.name: one.grams for one in found}
    scenes = [case.pictures.scene_to_render() for case in thesis_page.plant_cases("clean")]
    # the twin's plant has the thesis's mass at 1 g/ml
    assert {scene.subject.plant: scene.specimen.volume_ml for scene in scenes} == pytest.approx(grams)


def test_only_the_ladder_s_own_radishes_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "ladder.json"
    monkeypatch.setattr(ladder, "PATH", path)
    assert thesis_page.committed_records("clean") == []
    wanted = [record("radish_day05a", "coverage", rings, 35.0) for rings in (1, 2)]
    other = [record("wheat", "coverage", 2, 35.0), record("radish_day05a/seed101", "coverage", 2, 35.0)]
    path.write_text(json.dumps({"schema_version": 1, "records": [*wanted, *other]}), encoding="utf-8")
    assert thesis_page.committed_records("clean") == wanted
    assert thesis_page.committed_records("bench") == []


def test_rings_and_differing_commits_have_columns(tmp_path: Path) -> None:
    one, two = record("radish_day05a", "coverage", 1, 31.0), record("radish_day05a", "coverage", 2, 35.0)
    redone = record("radish_day10a", "thesis", 2, 1131.0)
    text = thesis_page.write(tmp_path / "page.md", thesis_page.plants([one, two, redone]), [], [])[0].read_text()
    assert "| re-implemented, 2 rings (ml) | g/ml | ours, 1 ring (ml) | 90 % interval (ml) | g/ml | ours, 2 rings (ml) |" in text
    ours = "0.0310 | 0.0279 to 0.0341 | 1.123 | 0.0350 | 0.0315 to 0.0385 | 0.994"
    assert f"| radish 1 | 5 | 0.0348 | 1.790 | 0.019 | - | - | {ours} |\n" in text
    assert "| radish 17 | 30 | 0.3414 | - | - | - | - | - | - | - | - | - | - |\n" in text
    assert "Measured at commit `0123abcd`." in text
    assert "Ours, 1 ring: the largest error is 10.9 % (1 plants); 0 of 1 intervals contain the true volume." in text
    newer = {**two, "commit": "4567abcd"}
    text = thesis_page.write(tmp_path / "page.md", thesis_page.plants([one, newer, redone]), [], [])[0].read_text()
    assert f"{ours} | `0123abcd`, `4567abcd` |\n" in text


def test_page_shows_levels_errors_and_missing_parts(tmp_path: Path) -> None:
    level = Level(
        voxel_mm=0.54, grid_voxels=22_000_000, thesis=carved(14.0, 1.0, 8.0), ours=carved(9.0, 0.5), true_extents_mm=(70.0, 75.0, 90.0)
    )
    counted = [CountedVolumes(assumed=Assumptions(), kept=0.53, shared=0.2, dropped=-0.11)]
    page, *files = thesis_page.write(tmp_path / "page.md", thesis_page.plants([]), [level], counted)
    text = page.read_text()
    assert "| 0.54 | 9.00 | 0.50 | 14.00 | 1.00 | 70,000 | 22,000,000 | 8.00 | 8.0 |" in text
    assert "| y | 75.0 | 74.0 | -1.3 % | 74.0 | -1.3 % |" in text
    assert "| picture | edges | carve | +53.0 % | +20.0 % | -11.0 % |" in text
    assert "the means of the days are 90.9 % on day 5, and 93.5 to 95.1 % from day 10 on" in text  # table A.1
    assert all(f"(pictures/{file.name})" in text and file.stat().st_size > 1000 for file in files)
    page, *files = thesis_page.write(tmp_path / "empty.md", thesis_page.plants([]), [], [])
    assert [file.name for file in files] == ["empty_masses.png", "empty_growth.png"]
    assert (page.read_text().count("Not measured."), page.read_text().count("Not drawn.")) == (3, 6)


def test_circle_is_found_through_noise_and_ray_keeps_to_snell() -> None:
    rng = np.random.default_rng(0)
    turn = rng.uniform(0.0, 2.0 * np.pi, 40)
    points = np.stack([3.0 + 400.0 * np.cos(turn), -2.0 + 400.0 * np.sin(turn)], axis=1) + rng.normal(0.0, 0.2, (40, 2))
    middle, radius, away = thesis_figures.fit_circle(points)
    assert (*middle, radius) == pytest.approx((3.0, -2.0, 400.0), abs=0.2)
    assert away.std() == pytest.approx(0.2, rel=0.3)
    optics = Optics.from_scene(Scene())
    for w in (-0.7, -0.2, 0.4, 0.9):
        camera, outer, entry, leave = thesis_figures.ray_path(optics, 400.0, w)
        radii = [optics.outer_radius_mm, optics.inner_radius_mm, optics.inner_radius_mm]
        assert [np.hypot(*at) for at in (outer, entry, leave)] == pytest.approx(radii)
        steps = [step / np.linalg.norm(step) for step in (outer - camera, entry - outer, leave - entry)]
        for k, (at, indices) in enumerate(((outer, (1.0, optics.n_wall)), (entry, (optics.n_wall, optics.n_water)))):
            normal = at / np.linalg.norm(at)
            across = [n * (step[0] * normal[1] - step[1] * normal[0]) for n, step in zip(indices, steps[k : k + 2], strict=True)]
            assert across[0] == pytest.approx(across[1], abs=1e-9)  # n sin(angle) is the same on both sides


def test_figures_of_method_are_pictures_on_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RHIZOTWIN_CACHE", str(tmp_path / "cache"))
    small = Pictures(scene="sphere_20mm", image_wh=(160, 120), views=12)
    found = thesis_figures.draw(small, plant=small)
    page, *files = thesis_page.write(tmp_path / "page.md", thesis_page.plants([]), [], [], found)
    assert {file.name for file in files} >= {"page_circle.png", "page_silhouettes.png", "page_rays.png", "page_carving.png"}
    assert all(f"(pictures/{file.name})" in page.read_text(encoding="utf-8") for file in files)
    assert all(picture[:4] == b"\x89PNG" for picture in found.values())
