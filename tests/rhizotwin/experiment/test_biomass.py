"""Masses: the thesis's tables, foil, intervals, mistakes in a table as one sentence, and shoots by their leaf area."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.experiment import biomass, model_file, thesis_tables
from rhizotwin.experiment.masses import Weighed, read_masses
from rhizotwin.experiment.measured import IN_90, Measured, read_all
from rhizotwin.scenes.assessment import Assessment
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.subject import Subject
from rhizotwin.scenes.table_file import read_table
from tests.command import Command

HEAD = "plant,root_fresh_g,root_dry_g\n"


@pytest.fixture
def twins() -> list[Measured]:
    """Return twenty plants whose volumes are known within 3 %."""
    rng, plants, reach = np.random.default_rng(5), [], float(np.exp(IN_90 * 0.03))
    for k, true in enumerate(np.geomspace(30.0, 1800.0, 20)):
        volume = float(true * np.exp(rng.normal(0.0, 0.03)))
        who = Subject(plant=f"P{k}", species="Raphanus sativus", day=5.0)
        traits = {"volume": volume, "total_length": float(40.0 * true**0.8)}
        known = {"volume": Assessment(verdict="reliable", interval=(volume / reach, volume * reach))}
        plants.append(Measured(name=f"result {k}", subject=who, traits=traits, assessed=known))
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


def test_the_thesis_table_gives_its_densities_and_waters(tmp_path: Path) -> None:
    masses, volumes = thesis_tables.write_shipped(tmp_path)
    found, _ = biomass.pairs(read_all([volumes]), read_masses(masses, balance_g=1e-4))
    printed = {row.cells["plant"]: row.cells for row in read_table(volumes)}
    known = {pair.measured.subject.plant: ratio for pair, ratio in biomass.ratios(found)}
    assert len(known) == 16
    # printed with three decimals, from masses with three
    assert known == pytest.approx({plant: float(printed[plant]["density (g/ml)"]) for plant in known}, abs=1.1e-3)
    assert np.mean(list(known.values())) == pytest.approx(0.034, abs=5e-4)
    grams = {one.subject.plant: one.grams for one in read_masses(masses, balance_g=1e-4)}
    water = {plant: 100.0 * (1.0 - own["root_dry"] / own["root_fresh"]) for plant, own in grams.items()}
    assert water == pytest.approx({plant: float(printed[plant]["water (%)"]) for plant in grams}, abs=0.011)


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


def test_foil_is_added_and_rows_without_text_are_ignored(tmp_path: Path) -> None:
    """Spreadsheets often write rows without text at the end of a table."""
    head = "plant,root_fresh_mg,root_dry_mg,root_foil_mg,root_foil_scraped_mg\n"
    a, b = masses_of(tmp_path / "m.csv", head + 'A,100,5,800,801.5\nB,90,4,,\n,,\n , ,\n"","",""\n')
    assert a.grams == pytest.approx({"root_fresh": 0.1, "root_dry": 0.0065})
    assert a.residue_g == pytest.approx({"root_dry": 0.0015})
    assert (b.grams["root_dry"], b.residue_g) == (pytest.approx(0.004), {})


MISTAKES = {
    "twice": ("plant,root_fresh_g\nA,1\nA,2\n", "plant A is listed twice, first in"),
    "two units": ("plant,root_fresh_g,shoot_fresh_mg\nA,1,2\n", "root_fresh_g, shoot_fresh_mg have different units"),
    "unit in the cell": ("plant,root_fresh_g\nA,34 mg\n", "'34 mg', which is not a number; write the unit in the column name"),
    "exceeds its fresh mass": ("plant,root_fresh_g,root_dry_g\nA,1,34\n", "exceeds its fresh mass"),
    "torn foil": ("plant,root_dry_g,root_foil_g,root_foil_scraped_g\nA,1,5,4\n", "was torn"),
    "comma decimals": ("plant,root_fresh_g\nA,0,5\n", "replace decimal commas by points"),
    "two decimal marks": ("plant;root_fresh_g;day\nA;0,5;1.5\n", "root_fresh_g is '0,5', which is not a number with a decimal point"),
    "fraction or thousand": ("plant;root_fresh_mg\nA;1.234\nB;567\n", "is 1.234, which may be a fraction or 1234"),
    "thousands": ('plant,root_fresh_mg\nA,"1,234"\n', "without separators of thousands"),
    "open quotation mark": ('plant,notes\nA,"fell\n', "check its quotation marks"),
}


@pytest.mark.parametrize(("text", "named"), MISTAKES.values(), ids=MISTAKES.keys())
def test_mistakes_in_the_table_are_one_sentence(text: str, named: str, tmp_path: Path) -> None:
    with pytest.raises(UserError) as refused:
        masses_of(tmp_path / "mine.csv", text)
    assert named in str(refused.value)


DIALECTS = {
    "German": "plant;day;root_fresh_g;notes\r\nA;15,5;0,300;ok\r\nB;15,5;1,234;\r\n".encode("utf-8-sig"),
    "Unicode text": "plant\tday\troot_fresh_g\nA\t15,5\t0,3\nB\t15,5\t1,234\n".encode("utf-16"),
    "line break": b'# "\nplant,day,root_fresh_g,notes\nA,15.5,0.3,"fell\n\n# over"\nB,15.5,1.234,\n',
    "sep": b'sep=;\nplant;day;"root_fresh_g"\nA;15.5;0.3\nB;15.5;1.234;;\n',
    "quoted": b'plant,day,root_fresh_g\rA,"15,5","0,3"\rB,"15,5","1,234"\r',
}


@pytest.mark.parametrize("content", DIALECTS.values(), ids=DIALECTS.keys())
def test_tables_of_spreadsheets_in_any_dialect_are_read(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_bytes(content)
    found = read_masses(tmp_path / "m.csv", balance_g=1e-4)
    assert [(one.subject.plant, one.subject.day, one.grams["root_fresh"]) for one in found] == [("A", 15.5, 0.3), ("B", 15.5, 1.234)]
    assert found[0].subject.notes in ("", "ok", "fell # over")


def test_masses_in_milligrams_are_noticed(twins: list[Measured], tmp_path: Path, command: Command) -> None:
    notes = [biomass.pairs(twins, weigh(tmp_path / "m.csv", twins, density))[1] for density in (1e3, 30.0, 0.95)]
    assert notes[0][0].startswith("root_fresh: the mass per volume of 20 of 20 plants is not plausible: P")
    assert notes[0][0].endswith("check the units of masses and volumes (mg under a heading in g, or ml under one in mm3)")
    assert [note.endswith("volumes") for note in notes[1]] == [True]
    assert notes[2] == []
    masses, volumes = thesis_tables.write_shipped(tmp_path)
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


def test_results_are_paired_with_the_weighings_of_their_day(tmp_path: Path) -> None:
    plant = Measured(name="r", subject=Subject(plant="A"), traits={"volume": 500.0})
    weighed = masses_of(tmp_path / "m.csv", "plant,day,root_fresh_g\nA,5,0.05\nA,20,0.5\n")
    with pytest.raises(UserError, match=r"A: the result r has no day, but masses of two days, .*line 2 and .*line 3; set the day"):
        biomass.pairs([plant], weighed)
    assert len(biomass.pairs([plant], weighed[:1])[0]) == 1
    days = [Measured(name=f"r{day:g}", subject=Subject(plant="A", day=day), traits={"volume": 90.0 * day}) for day in (5.0, 9.0)]
    found, notes = biomass.pairs(days, masses_of(tmp_path / "m.csv", "plant,day,root_fresh_g\nA\nA,,\nB,9,0.5\n"))
    assert found == []
    assert sum("the table contains no mass that matches this result" in note for note in notes) == 2
    assert any("plant B" in note and "has no result" in note for note in notes)


def test_an_interval_that_begins_at_zero_is_an_uncertainty() -> None:
    wide = {"volume": Assessment(verdict="not reliable", interval=(0.0, 5000.0))}
    plant = Measured(name="r", subject=Subject(plant="A"), traits={"volume": 500.0, "total_length": 90.0}, assessed=wide)
    assert (plant.log_sigma("volume"), plant.log_sigma("total_length")) == (pytest.approx(np.log(10.0) / IN_90), 0.0)


GRAMS_PER_CM2 = 0.045


def shoot(leaf_area_mm2: float, wobble: float) -> dict[str, object]:
    areas = {"surface_area_mm2": 1.2 * leaf_area_mm2, "projected_mean_mm2": 0.5 * leaf_area_mm2 * wobble}
    volumes = {"volume_mm3": None, "convex_mm3": 1000.0, "hull_mm3": 900.0}
    return {"leaf_area_mm2": leaf_area_mm2, "leaves": 6, "height_mm": 40.0, "pot_top_mm": 31.0, "hidden_share": 0.0} | areas | volumes


@pytest.fixture
def results(ball_result: Callable[..., Path], tmp_path: Path) -> Path:
    rng = np.random.default_rng(4)
    rows = ["plant,shoot_fresh_g"]
    for number, area in enumerate(np.geomspace(200.0, 4000.0, 8)):
        who = {"plant": f"P{number}", "species": "Raphanus sativus", "day": 10.0}
        ball_result(f"results/P{number}", subject=who, shoot=shoot(float(area), float(np.exp(rng.normal(0.0, 0.3)))))
        rows.append(f"P{number},{GRAMS_PER_CM2 * area / 100.0 * np.exp(rng.normal(0.0, 0.02)):.5f}")
    (tmp_path / "masses.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return tmp_path / "results"


def test_tables_have_columns_of_shoots(results: Path, tmp_path: Path, command: Command) -> None:
    table = tmp_path / "traits.csv"
    command.works("traits", *sorted(results.iterdir()), "-o", table)
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert (rows[0]["leaf_area_mm2"], rows[0]["leaves"], rows[0]["shoot_volume_mm3"]) == ("200", "6", "")
    again = {one.subject.plant: one.traits for one in read_all([table])}
    assert again["P7"]["leaf_area"] == pytest.approx(4000.0)
    assert "shoot_volume" not in again["P7"]


def test_a_shoots_mass_is_told_by_its_leaf_area(results: Path, tmp_path: Path) -> None:
    found, _ = biomass.pairs(read_all([results]), read_masses(tmp_path / "masses.csv", balance_g=1e-4))
    (best,) = biomass.fit(found, balance_g=1e-4).relations
    assert (best.kind, best.trait, best.proportional) == ("shoot_fresh", "leaf_area", True)
    grams, low, high = best.predict(1000.0, 0.0)
    assert grams == pytest.approx(GRAMS_PER_CM2 * 10.0, rel=0.03)
    assert low < grams < high
