"""Corrected results of several plants in one canister."""

from dataclasses import replace
from pathlib import Path

import pytest

from rhizotwin.corrections import corrected, log
from rhizotwin.corrections.session import Session
from rhizotwin.recon.results import by_plant, divide_by_plant
from rhizotwin.recon.roots import plants as recon_plants
from rhizotwin.scenes.plants import Plant as ScenePlant
from rhizotwin.scenes.rsml_reader import read_rsml
from rhizotwin.scenes.subject import Subject
from rhizotwin.stored import result_files
from rhizotwin.stored.load import load_result
from tests.rhizotwin import plant as plants


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a result of two plants: the plant on paper, and a straight root 14 mm beside it."""
    folder = tmp_path_factory.mktemp("pair")
    one = load_result(plants.make(folder, fibre=True).result)
    roots = tuple(replace(root, plant="B" if k == 4 else "A") for k, root in enumerate(one.solid.roots))
    known = [ScenePlant(plant="A"), ScenePlant(plant="B", at_mm=(-14.0, -10.0), treatment="low N")]
    planted = recon_plants.check_assignment(roots, known, grid_z_mm=-15.0)
    shape = divide_by_plant.Shape(
        leaves=one.solid.voxels,
        surface=one.solid.surface,
        finest_mm=one.solid.finest_mm,
        volume_mm3=one.solid.volume.mm3,
        terms=one.solid.volume.terms,
    )
    found = divide_by_plant.measure(shape, planted, known, Subject(species="Raphanus sativus"))
    whole = replace(one, solid=replace(one.solid, roots=planted.roots), plants=found, subject=Subject(species="Raphanus sativus"))
    (folder / "pair").mkdir()
    whole.save(folder / "pair")
    return folder / "pair"


def own_of(folder: Path) -> dict[str, tuple[float, float, str]]:
    """Return volume, length and treatment of each plant."""
    summary = result_files.read_summary(folder)
    found = by_plant.from_summary(summary, "result.json")
    assert sum(one.volume_mm3 for one in found) == pytest.approx(summary["volume_mm3"])
    return {one.subject.plant: (one.volume_mm3, float(one.traits.total_length_mm or 0.0), one.subject.treatment) for one in found}


def test_plants_that_share_a_canister_keep_their_own_numbers(pair: Path, tmp_path: Path):
    session = Session(pair)
    corrected.write(session, tmp_path / "same")
    before, same = own_of(pair), own_of(tmp_path / "same")
    assert {name: values[2] for name, values in same.items()} == {"A": "", "B": "low N"}
    for name, values in before.items():
        assert same[name][:2] == pytest.approx(values[:2], rel=1e-6)
    lateral = next(k for k, line in session.state.lines.items() if line.plant == "A" and line.parent >= 0)
    other = next(k for k, line in session.state.lines.items() if line.plant == "B")
    length = session.state.lines[lateral].length_mm
    session.do(log.edit("parent", roots=[lateral, other]))
    corrected.write(session, tmp_path / "moved")
    after = own_of(tmp_path / "moved")
    assert after["B"][1] - before["B"][1] == pytest.approx(length, rel=1e-6)
    assert before["A"][1] - after["A"][1] == pytest.approx(length, rel=1e-6)
    assert after["B"][0] > before["B"][0] + 1.0
    assert {root.plant for root in read_rsml(tmp_path / "moved" / "roots.rsml")} == {"A", "B"}
    session.do(log.edit("cut", roots=[lateral], point_mm=tuple(session.state.lines[lateral].points_mm[20])))
    assert [line.plant for line in session.state.lines.values()].count("B") == 3  # what is cut off stays the plant's


def test_a_plant_without_roots_is_one_no_more(pair: Path, tmp_path: Path):
    session = Session(pair)
    other = next(k for k, line in session.state.lines.items() if line.plant == "B")
    session.do(log.edit("delete roots", roots=[other]))
    corrected.write(session, tmp_path / "one")
    assert set(own_of(tmp_path / "one")) == {"A"}
    text = (tmp_path / "one" / "traits.csv").read_text(encoding="utf-8")
    assert {line.split(",")[0] for line in text.splitlines()[1:]} == {"", "A"}
