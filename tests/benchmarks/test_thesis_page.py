"""The page that sets the thesis beside its method and ours."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import thesis_figures, thesis_page
from benchmarks.assumptions import Assumptions, CountedVolumes, Level
from benchmarks.cases import Pictures
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes.model import Scene


def score(mm3: float) -> dict[str, object]:
    return {"volume_mm3": mm3, "volume_interval_mm3": [0.9 * mm3, 1.1 * mm3]}


def test_the_thesiss_plants_are_the_librarys_in_its_order() -> None:
    records = [
        {"case": {"scene": "radish_day05a", "method": "thesis"}, "score": score(600.0)},
        {"case": {"scene": "radish_day30c", "method": "coverage"}, "score": score(1750.0)},
    ]
    found = thesis_page.plants(records)
    assert len(found) == 18
    assert (found[0].name, found[0].thesis_ml, found[0].grams) == ("radish 1", 1.79, 0.0348)
    assert found[0].redone == score(600.0)
    assert found[0].ours is None
    assert found[16].thesis_ml is None
    assert found[17].ours == score(1750.0)
    for case in thesis_page.plant_cases("clean"):
        scene = case.pictures.scene_to_render()
        plant = next(one for one in found if one.name == scene.subject.plant)
        assert plant.grams == pytest.approx(scene.specimen.volume_ml)  # the twin's plant has the thesis's mass at 1 g/ml


def test_the_page_shows_numbers_and_dashes_and_what_was_not_measured(tmp_path: Path) -> None:
    found = thesis_page.plants([{"case": {"scene": "radish_day05a", "method": "coverage"}, "score": score(35.0)}])
    levels = [Level(voxel_mm=0.54, thesis_ml=14.0, thesis_s=1.0, ours_ml=9.0, ours_s=0.5)]
    counted = [CountedVolumes(assumed=Assumptions(), kept=0.53, shared=0.2, dropped=-0.11)]
    text = (files := thesis_page.write(tmp_path / "page.md", found, levels, counted))[0].read_text()
    assert "| radish 1 | 5 | 0.0348 | 1.7900 | 0.019 | - | - | 0.0350 | 0.0315 to 0.0385 | 0.994 |" in text
    assert "| radish 17 | 30 | 0.3414 | - | - | - | - | - | - | - |" in text
    assert "| picture | edges | carve | +53.0 % | +20.0 % | -11.0 % |" in text
    assert all(file.name in text and file.stat().st_size > 1000 for file in files[1:])
    page, *figures = thesis_page.write(tmp_path / "empty.md", thesis_page.plants([]), [], [])
    assert [file.name for file in figures] == ["empty_growth.png"]
    assert page.read_text().count("Not measured.") == 3


def test_a_circle_is_found_through_noise_and_a_ray_keeps_to_snell() -> None:
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


def test_figures_of_the_method_are_pictures_on_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RHIZOTWIN_CACHE", str(tmp_path / "cache"))
    found = thesis_figures.draw(Pictures(scene="sphere_20mm", image_wh=(160, 120), views=12))
    page, *files = thesis_page.write(tmp_path / "page.md", thesis_page.plants([]), [], [], found)
    assert {file.name for file in files} >= {"page_circle.png", "page_rays.png", "page_carving.png"}
    assert all(f"({file.name})" in page.read_text(encoding="utf-8") and file.read_bytes()[:4] == b"\x89PNG" for file in files)
