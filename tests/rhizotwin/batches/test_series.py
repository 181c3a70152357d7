"""Variations of a scene."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rhizotwin.batches import series
from rhizotwin.scenes import files
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.solution import Solution
from tests.command import Command


def test_series_name_plants_days_and_treatments() -> None:
    scene = replace(files.load_scene("radish_day05a"), solution=Solution(recipe="kliman_2022"))
    varied = series.vary(scene, plants=2, days=(3.0, 5.0), treatments=(("control", 1.0, ()), ("low N", 0.85, (("N", 0.5),))))
    assert len(varied) == 8
    one = varied["radish_day05a_low_N_plant2_day03"]
    assert (one.subject.treatment, one.subject.day, one.subject.replicate) == ("low N", 3.0, 2)
    assert len({other.subject.plant for other in varied.values()}) == 4
    assert one.solution.ions_mmol_per_l["NO3"] == pytest.approx(0.5 * scene.solution.ions_mmol_per_l["NO3"])
    with pytest.raises(UserError, match=r"treatment dry of scene .* whose compounds are none"):
        series.vary(files.load_scene("radish_day05a"), treatments=(("dry", 1.0, (("K", 0.5),)),))
    same = series.vary(scene, days=(5.0,))["radish_day05a_day05"]
    assert same.specimen.volume_ml == pytest.approx(scene.specimen.volume_ml)
    with pytest.raises(UserError, match="has no grown plant"):
        series.vary(files.load_scene("sphere_20mm"), plants=2)


@pytest.mark.parametrize("same", [{"treatments": (("low N", 0.85, ()), ("low_N", 0.9, ()))}, {"days": (5.01, 5.04)}], ids=list)
def test_no_variation_replaces_another_of_the_same_name(same: dict[str, Any]) -> None:
    with pytest.raises(UserError, match="have the same name"):
        series.vary(files.load_scene("radish_day05a"), **same)


def test_a_scene_is_not_simulated_twice_into_one_folder(tmp_path: Path, command: Command) -> None:
    words = ("batch", "simulate", "radish_day05a", "radish_day05a", "--plants", 2, "-o", tmp_path / "scans")
    command.fails(*words, named=["two scenes have the same name"])
