"""Masses: the thesis's tables, foil, intervals, and each mistake in a table as one sentence."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import ladder
from rhizotwin.experiment import biomass, model_file, tables
from rhizotwin.experiment.masses import Weighed, read_masses
from rhizotwin.experiment.measured import IN_90, Measured, read_all
from rhizotwin.scenes import files
from rhizotwin.scenes.assessment import Assessment
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.specimens import GrownSpecimen
from rhizotwin.scenes.subject import Subject
from tests.command import Command

ONE_RING = "/clean/40x800x600/0.27/coverage"
HEAD = "plant,root_fresh_g,root_dry_g\n"


@pytest.fixture
def thesis(tmp_path: Path) -> tuple[Path, Path]:
    """Return the thesis's volumes and masses."""
    masses, volumes = tables.write_shipped(tmp_path)
    return volumes, masses


@pytest.fixture
def twins() -> list[Measured]:
    """Return twenty plants whose volumes are known within 3 %."""
    rng, plants = np.random.default_rng(5), []
    for k, true in enumerate(np.geomspace(30.0, 1800.0, 20)):
        volume = float(true * np.exp(rng.normal(0.0, 0.03)))
        reach = float(np.exp(IN_90 * 0.03))
        plants.append(
            Measured(
                name=f"result {k}",
                subject=Subject(plant=f"P{k}", species="Raphanus sativus", day=5.0),
                traits={"volume": volume, "total_length": float(40.0 * true**0.8)},
                assessed={"volume": Assessment(verdict="reliable", interval=(volume / reach, volume * reach))},
            )
        )
    return plants


def weigh(path: Path, plants: list[Measured], density: float = 1.0) -> list[Weighed]:
    """Return the masses of plants whose true volumes lie between those of their neighbours."""
    rows = [
        f"{one.subject.plant},{density * true / 1000.0:.4f},{density * true / 30000.0:.4f}"
        for one, true in zip(plants, np.geomspace(30.0, 1800.0, 20), strict=True)
    ]
    return masses_of(path, HEAD + "\n".join(rows) + "\n")


def masses_of(path: Path, text: str) -> list[Weighed]:
    """Write a table and read its masses."""
    path.write_text(text, encoding="utf-8")
    return read_masses(path, balance_g=1e-4)


def test_the_thesis_table_gives_its_densities_and_waters(thesis: tuple[Path, Path], command: Command) -> None:
    volumes, masses = thesis
    found, notes = biomass.pairs(read_all([volumes]), read_masses(masses, balance_g=1e-4))
    printed = {row.cells["plant"]: row.cells for row in tables.read_table(volumes)}
    known = {pair.measured.subject.plant: ratio for pair, ratio in biomass.ratios(found)}
    assert len(known) == 16
    # printed with three decimals, from masses with three
    assert known == pytest.approx({plant: float(printed[plant]["density (g/ml)"]) for plant in known}, abs=1.1e-3)
    assert np.mean(list(known.values())) == pytest.approx(0.034, abs=5e-4)
    assert not notes
    grams = {one.subject.plant: one.grams for one in read_masses(masses, balance_g=1e-4)}
    water = {plant: 100.0 * (1.0 - own["root_dry"] / own["root_fresh"]) for plant, own in grams.items()}
    assert water == pytest.approx({plant: float(printed[plant]["water (%)"]) for plant in grams}, abs=0.011)
    told = command.works("biomass", "fit", volumes, masses, "-o", volumes.with_name("model.json")).out
    assert "fresh root mass per volume: mean 0.03401 g/ml of 16 plants" in told


def test_the_mean_density_is_that_of_plants_and_not_of_weighings(tmp_path: Path, command: Command) -> None:
    volumes, masses = tmp_path / "volumes.csv", tmp_path / "masses.csv"
    days = [("A", 1, 1.2), *((plant, day, 0.9) for plant in "BCD" for day in (1, 2))]
    sizes = [f"{plant},{day},{100 * k}\n" for k, (plant, day, _) in enumerate(days, start=1)]
    weights = [f"{plant},{day},{ratio * k / 10.0}\n" for k, (plant, day, ratio) in enumerate(days, start=1)]
    volumes.write_text("plant,day,volume_mm3\n" + "".join(sizes), encoding="utf-8")
    masses.write_text("plant,day,root_fresh_g\n" + "".join(weights), encoding="utf-8")
    told = command.works("biomass", "fit", volumes, masses, "-o", tmp_path / "model.json").out
    assert "fresh root mass per volume: mean 0.975 g/ml of 4 plants" in told


def test_the_density_is_found_with_an_honest_interval(twins: list[Measured], tmp_path: Path) -> None:
    found, _ = biomass.pairs(twins, weigh(tmp_path / "m.csv", twins, 1.05))
    model = biomass.fit(found, balance_g=1e-4)
    fresh = next(relation for relation in model.relations if relation.kind == "root_fresh")
    assert (fresh.trait, fresh.proportional) == ("total_length", False)  # which has no error here
    by_volume = next(one for one in model.tried if one.kind == "root_fresh" and one.trait == "volume" and one.proportional)
    assert 1000.0 * np.exp(by_volume.line.intercept) == pytest.approx(1.05, rel=0.02)
    assert by_volume.error < 0.05
    assert 0.8 <= by_volume.held <= 1.0
    grams, low, high = by_volume.predict(500.0, 0.03)
    assert grams == pytest.approx(0.525, rel=0.03)
    assert np.log(high / low) / 2.0 == pytest.approx(1.73 * 0.03, rel=0.2)  # Student's t of 19 degrees of freedom


def test_a_plant_that_is_weighed_on_six_days_counts_once(twins: list[Measured], tmp_path: Path) -> None:
    once, _ = biomass.pairs(twins[::5], weigh(tmp_path / "m.csv", twins))
    one, six = (biomass.fit(found, balance_g=1e-4).tried for found in (once, 6 * once))
    assert [line.line.dof for line in six] == [4 - (1 if line.proportional else 2) for line in one]
    told = [np.array([line.predict(500.0, 0.03) for line in tried]) for tried in (six, one)]
    assert told[0] == pytest.approx(told[1], rel=1e-6)


def test_a_model_is_read_back_and_predicts(twins: list[Measured], tmp_path: Path) -> None:
    found, _ = biomass.pairs(twins, weigh(tmp_path / "m.csv", twins))
    model = biomass.fit(found, balance_g=1e-4)
    model_file.save_model(model, tmp_path / "model.json")
    assert model_file.load_model(tmp_path / "model.json") == model
    told = model_file.predict(model, twins[:1])
    rows = list(csv.DictReader(model_file.to_csv(told).splitlines()))
    assert {row["mass"] for row in rows} == {"root_fresh", "root_dry"}
    assert all(float(row["low (g)"]) < float(row["mass (g)"]) < float(row["high (g)"]) for row in rows)


def test_foil_is_added_and_rows_without_text_are_ignored(tmp_path: Path) -> None:
    """Spreadsheets often write rows without text at the end of a table."""
    head = "plant,root_fresh_mg,root_dry_mg,root_foil_mg,root_foil_scraped_mg\n"
    a, b = masses_of(tmp_path / "m.csv", head + 'A,100,5,800,801.5\nB,90,4,,\n,,\n , ,\n"","",""\n')
    assert a.grams == pytest.approx({"root_fresh": 0.1, "root_dry": 0.0065})
    assert a.residue_g == pytest.approx({"root_dry": 0.0015})
    assert (b.grams["root_dry"], b.residue_g) == (pytest.approx(0.004), {})


MISTAKES = {
    "twice": ("plant,root_fresh_g\nA,1\nA,2\n", "plant A is listed twice, first in"),
    "no plant": ("plant,root_fresh_g\nA,1\n,2\n", "line 3: the name of the plant is missing"),
    "no column plant": ("name,root_fresh_g\nA,1\n", "the column 'plant' is missing"),
    "two units": ("plant,root_fresh_g,shoot_fresh_mg\nA,1,2\n", "root_fresh_g, shoot_fresh_mg have different units"),
    "unit in the cell": ("plant,root_fresh_g\nA,34 mg\n", "'34 mg', which is not a number; write the unit in the column name"),
    "unknown unit": ("plant,root_fresh_oz\nA,1\n", "must be g, mg or kg"),
    "nothing weighed": ("plant,height_mm\nA,1\n", "contains no column of masses"),
    "below zero": ("plant,root_fresh_g\nA,-1\n", "enter a positive number"),
    "exceeds its fresh mass": ("plant,root_fresh_g,root_dry_g\nA,1,34\n", "exceeds its fresh mass"),
    "torn foil": ("plant,root_dry_g,root_foil_g,root_foil_scraped_g\nA,1,5,4\n", "was torn"),
    "comma decimals": ("plant,root_fresh_g\nA,0,5\n", "replace decimal commas by points"),
    "semicolons": ("plant;root_fresh_g\nA;1\n", "must be separated by commas, not by semicolons or tabs"),
    "empty": ("plant,root_fresh_g\n", "contains no rows"),
}


@pytest.mark.parametrize(("text", "named"), MISTAKES.values(), ids=MISTAKES.keys())
def test_mistakes_in_the_table_are_one_sentence(text: str, named: str, tmp_path: Path) -> None:
    with pytest.raises(UserError) as refused:
        masses_of(tmp_path / "mine.csv", text)
    assert named in str(refused.value)


def test_one_mass_in_milligrams_is_noticed(thesis: tuple[Path, Path], command: Command) -> None:
    volumes, masses = thesis
    text = masses.read_text(encoding="utf-8").replace("12,Raphanus sativus,20,0.5903", "12,Raphanus sativus,20,590.3")
    masses.write_text(text, encoding="utf-8")
    command.fails("biomass", "fit", volumes, masses, "-o", volumes.with_name("m.json"), named=["check the unit"])
    assert not volumes.with_name("m.json").exists()


def test_a_model_of_another_species_is_refused(twins: list[Measured], ball_result, tmp_path: Path, command: Command) -> None:
    found, _ = biomass.pairs(twins, weigh(tmp_path / "m.csv", twins))
    by_volume = tuple(one for one in biomass.fit(found, balance_g=1e-4).tried if one.trait == "volume" and one.proportional)
    model, table = tmp_path / "model.json", tmp_path / "masses_told.csv"
    model_file.save_model(biomass.Model(species="Raphanus sativus", relations=by_volume, tried=(), notes=()), model)
    lettuce = ball_result("lettuce", subject={"plant": "L1", "species": "Lactuca sativa"})
    named = ["L1 is of the species Lactuca sativa, but the model was fitted to Raphanus sativus"]
    command.fails("biomass", "predict", lettuce, "--model", model, named=named)
    radish = ball_result("radish", subject={"plant": "R1", "species": "Raphanus sativus"})
    command.works("biomass", "predict", radish, "--model", model, "-o", table)
    assert {row["plant"] for row in csv.DictReader(table.read_text(encoding="utf-8").splitlines())} == {"R1"}


def test_results_without_trust_and_without_partner_are_told(twins: list[Measured], tmp_path: Path) -> None:
    weighed = [*weigh(tmp_path / "m.csv", twins), *masses_of(tmp_path / "n.csv", HEAD + "P99,1,\n")]
    bad = Assessment(verdict="not reliable", reason="too few views")
    doubted = replace(twins[-1], assessed=dict.fromkeys(twins[-1].traits, bad))
    found, notes = biomass.pairs([*twins[:-1], doubted], weighed)
    assert len(biomass.ratios(found)) == 19
    assert any("plant P99 has no result" in note for note in notes)
    assert "volume: 1 of 20 values are excluded, because they are not reliable: too few views" in notes


def test_a_result_without_a_day_is_not_paired_with_two_weighings(tmp_path: Path) -> None:
    plant = Measured(name="r", subject=Subject(plant="A"), traits={"volume": 500.0})
    weighed = masses_of(tmp_path / "m.csv", "plant,day,root_fresh_g\nA,5,0.05\nA,20,0.5\n")
    with pytest.raises(UserError, match=r"A: the result r has no day, but masses of two days, .*line 2 and .*line 3; set the day"):
        biomass.pairs([plant], weighed)
    assert len(biomass.pairs([plant], weighed[:1])[0]) == 1
    shoots = masses_of(tmp_path / "shoots.csv", "plant,day,shoot_fresh_g\nA,5,0.1\n")
    assert len(biomass.pairs([plant], [weighed[0], *shoots])[0]) == 2


def test_a_power_law_is_not_fitted_if_only_one_plant_differs() -> None:
    """Two days of a plant have values of their own; without this plant, all values are equal."""
    days = [(Subject(plant=plant, day=day), mm3) for plant, day, mm3 in (("A", 5.0, 1000.0), ("A", 9.0, 2000.0))]
    days += [(Subject(plant=plant, day=5.0), 500.0) for plant in "BCD"]
    plants = [Measured(name="r", subject=own, traits={"volume": mm3}) for own, mm3 in days]
    grams = [{"root_fresh": mm3 / 1000.0 + 0.01 * k} for k, (_, mm3) in enumerate(days)]
    masses = [Weighed(where="m", subject=own, grams=own_g, residue_g={}) for (own, _), own_g in zip(days, grams, strict=True)]
    assert [one.proportional for one in biomass.fit(biomass.pairs(plants, masses)[0], balance_g=1e-4).tried] == [True]


def test_plants_not_weighed_yet_may_have_several_results(tmp_path: Path) -> None:
    days = [Measured(name=f"r{day:g}", subject=Subject(plant="A", day=day), traits={"volume": 90.0 * day}) for day in (5.0, 9.0)]
    found, notes = biomass.pairs(days, masses_of(tmp_path / "m.csv", "plant,day,root_fresh_g\nA\nA,,\nB,9,0.5\n"))
    assert found == []
    assert sum("the table contains no mass that matches this result" in note for note in notes) == 2


def test_an_interval_that_begins_at_zero_is_an_uncertainty() -> None:
    wide = {"volume": Assessment(verdict="not reliable", interval=(0.0, 5000.0))}
    plant = Measured(name="r", subject=Subject(plant="A"), traits={"volume": 500.0, "total_length": 90.0}, assessed=wide)
    assert (plant.log_sigma("volume"), plant.log_sigma("total_length")) == (pytest.approx(np.log(10.0) / IN_90), 0.0)


def test_the_twins_radishes_have_nearly_the_density_of_water() -> None:
    """The twin's masses are those of 1 g/ml; in one ring, up to a tenth of a volume is the crown, which the net pot hides."""
    ours = {one["case"]["scene"]: one["score"]["volume_mm3"] for one in ladder.read() if one["case"]["name"].endswith(ONE_RING)}
    radishes = [files.load_scene(name) for name in ours if name.startswith("radish_day")]
    plants, masses = [], []
    for scene in radishes:
        assert isinstance(scene.specimen, GrownSpecimen)
        plants.append(Measured(name=scene.name, subject=scene.subject, traits={"volume": ours[scene.name]}))
        masses.append(Weighed(where=scene.name, subject=scene.subject, grams={"root_fresh": scene.specimen.volume_ml}, residue_g={}))
    found, _ = biomass.pairs(plants, masses)
    assert len(found) == len(radishes) >= 9
    by_volume = biomass.fit(found, balance_g=1e-4).tried[0]
    assert (by_volume.trait, by_volume.proportional) == ("volume", True)
    assert 1.0 <= 1000.0 * np.exp(by_volume.line.intercept) < 1.1
    assert by_volume.error < 0.05
    assert by_volume.held >= 0.8
