"""The page that sets the thesis beside its method and ours."""

from pathlib import Path

import pytest

from benchmarks import thesis_page
from benchmarks.assumptions import Assumptions, Counted, Level


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
    counted = [Counted(assumed=Assumptions(), kept=0.53, shared=0.2, dropped=-0.11)]
    text = (files := thesis_page.write(tmp_path / "page.md", found, levels, counted))[0].read_text()
    assert "| radish 1 | 5 | 0.0348 | 1.7900 | 0.019 | - | - | 0.0350 | 0.0315 to 0.0385 | 0.994 |" in text
    assert "| radish 17 | 30 | 0.3414 | - | - | - | - | - | - | - |" in text
    assert "| picture | edges | carve | +53.0 % | +20.0 % | -11.0 % |" in text
    assert all(file.name in text and file.stat().st_size > 1000 for file in files[1:])
    page, *figures = thesis_page.write(tmp_path / "empty.md", thesis_page.plants([]), [], [])
    assert [file.name for file in figures] == ["empty_growth.png"]
    assert page.read_text().count("Not measured.") == 3
