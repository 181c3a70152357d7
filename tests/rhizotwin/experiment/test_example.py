"""The example of eighteen plants is complete, and growth and biomass run on it without refused numbers."""

from pathlib import Path

from rhizotwin.experiment import biomass, growth, mass_curves
from rhizotwin.experiment.masses import BALANCE_G, read_masses
from rhizotwin.experiment.measured import read_all
from rhizotwin.experiment.thesis_tables import write_example


def test_growth_and_biomass_run_on_the_example(tmp_path: Path) -> None:
    write_example(tmp_path / "example")
    found = read_all([tmp_path / "example" / "results"])
    grown = growth.measure(found)
    assert {f"radish {k}" for k in range(1, 19)} == grown.plants.keys()
    assert not [note for note in grown.notes if "excluded" in note]
    assert len(grown.tracked) == 7
    weighed = read_masses(tmp_path / "example" / "masses.csv", balance_g=BALANCE_G)
    pairs, notes = biomass.pairs(found, weighed)
    assert len({pair.measured.subject.plant for pair in pairs}) >= 15
    assert not [note for note in notes if "reliable" in note]
    model = biomass.fit(pairs, balance_g=BALANCE_G, notes=notes)
    assert {one.kind for one in model.relations} == {"root_fresh", "root_dry", "shoot_fresh", "shoot_dry"}
    curves = mass_curves.measure(mass_curves.read([tmp_path / "example" / "masses.csv"], {})[0])
    points = [*(point for own in (grown.curves, curves) for points in own.values() for point in points)]
    assert all(0.0 < point.low <= point.mean <= point.high for point in points)
