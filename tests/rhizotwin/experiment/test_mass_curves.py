"""Masses by day: the thesis's figure 4.1, and weighed beside predicted masses."""

from pathlib import Path

import numpy as np
import pytest

from rhizotwin.experiment import mass_curves
from rhizotwin.experiment.thesis_tables import shipped
from rhizotwin.scenes.errors import UserError
from tests.command import Command

PREDICTED = """result,plant,species,treatment,day,date,replicate,notes,mass,mass (g),low (g),high (g),from,verdict,extrapolated
a,P1,,,5,,,,root_fresh,2.0,1.5,2.5,volume,reliable,no
a,P1,,,5,,,,root_dry,0.1,0.05,0.2,volume,reliable,no
"""


def test_the_figure_of_the_thesis(command: Command, tmp_path: Path) -> None:
    """Means by day are those of table A.1 (Kliman 2022), worked out by hand for the first harvest."""
    command.works("growth", shipped("kliman_2022_masses.csv"), "-o", tmp_path / "grown")
    assert sorted(path.name for path in (tmp_path / "grown").iterdir()) == ["growth.html", "masses.csv", "masses.png"]
    curves = mass_curves.measure(mass_curves.read([shipped("kliman_2022_masses.csv")])[0])
    first = curves["plant", "water"][0]
    assert (first.day, first.plants) == (5.0, 3)
    assert first.mean == pytest.approx(np.mean([92.2439759, 91.47496617, 92.26950355]))
    assert curves["root", "fresh"][3].mean == pytest.approx(np.mean([0.956, 0.9287, 0.5903]))


def test_what_was_weighed_counts_before_what_was_predicted(tmp_path: Path) -> None:
    (tmp_path / "predicted.csv").write_text(PREDICTED)
    (tmp_path / "weighed.csv").write_text("plant,day,root_fresh_g\nP1,5,1.0\nP2,5,3.0\n")
    paths = [tmp_path / name for name in ("weighed.csv", "predicted.csv")]
    masses, again = ({one.plant: one for one in mass_curves.read(order)[0]} for order in (paths, paths[::-1]))
    assert masses["P1"].grams == again["P1"].grams
    assert dict(masses["P1"].grams) == {"root_fresh": 1.0, "root_dry": 0.1}
    assert masses["P1"].value("root", "water") == pytest.approx(90.0)
    assert masses["P2"].value("root", "water") is None
    assert masses["P1"].value("plant", "fresh") is None  # its shoot is not known
    (tmp_path / "later.csv").write_text("plant,day,root_dry_g\nP1,9,0.08\n")
    assert mass_curves.read([*paths, tmp_path / "later.csv"])[1] == []  # within the error of the prediction of day 5


def test_intervals_are_inside_the_limits_and_falls_are_named(tmp_path: Path) -> None:
    rows = "P1,5,1.0,0.01\nP2,5,0.1,0.05\nP1,9,2.0,0.02\nP2,9,0.01,0.009\n"  # means of two plants were -1.8 to 2.9 g
    (tmp_path / "weighed.csv").write_text("plant,day,root_fresh_g,root_dry_g\n" + rows)
    masses, notes = mass_curves.read([tmp_path / "weighed.csv"])
    assert notes == [
        "plant P2, day 9: root_fresh_g fell from 0.1 to 0.01 and root_dry_g fell from 0.05 to 0.009 since day 5, "
        "by more than the error; it may have died or been replaced"
    ]
    points = {key: [(one.low, one.mean, one.high) for one in own] for key, own in mass_curves.measure(masses).items()}
    assert all(0.0 < low < mean < high for own in points.values() for low, mean, high in own)
    assert max(high for *_, high in points["root", "water"]) < 100.0


def test_predicted_masses_that_are_not_reliable_are_excluded(command: Command, tmp_path: Path) -> None:
    bad, beyond = "a,P2,,,5,,,,root_fresh,90,1,99,volume,not reliable,yes\n", "a,P3,,,5,,,,root_fresh,4.0,1,9,volume,reliable,yes\n"
    (tmp_path / "predicted.csv").write_text(PREDICTED + bad + beyond)
    masses, notes = mass_curves.read([tmp_path / "predicted.csv"])
    assert {one.plant for one in masses} == {"P1", "P3"}
    assert notes == [
        "predicted mass: 1 of 4 values are excluded, because they are not reliable: the volume is not reliable",
        "predicted mass: 1 of 4 values are extrapolated; weigh plants of this size for the model",
    ]
    told = command.works("growth", tmp_path / "predicted.csv", "-o", tmp_path / "grown").out
    assert all(note in told for note in notes)
    (tmp_path / "predicted.csv").write_text(PREDICTED.splitlines()[0] + "\n" + bad)
    command.fails("growth", tmp_path / "predicted.csv", "-o", tmp_path / "none", named=["1 of 1 values are excluded"])


def test_a_mass_without_a_treatment_has_that_of_its_plant(command: Command, tmp_path: Path) -> None:
    (tmp_path / "weighed.csv").write_text("plant,day,root_fresh_g\nP1,5,1.0\nP1,9,2.0\nP2,9,3.0\n")
    (tmp_path / "traits.csv").write_text("plant,treatment,day,tips\nP1,low N,5,9\nP2,control,5,9\n")
    command.works("growth", tmp_path / "traits.csv", tmp_path / "weighed.csv", "-o", tmp_path / "grown")
    rows = [row.split(",") for row in (tmp_path / "grown" / "masses.csv").read_text().splitlines()[1:]]
    assert [(row[2], row[3], row[4]) for row in rows] == [("control", "9", "3"), ("low N", "5", "1"), ("low N", "9", "2")]
    (tmp_path / "a.csv").write_text("plant,treatment,day,root_fresh_g\nP1,low N,5,1.0\n")
    (tmp_path / "b.csv").write_text("plant,treatment,day,root_fresh_g\nP1,control,9,1.0\n")
    with pytest.raises(UserError, match="plant P1 has two treatments, 'low N' and 'control'"):
        mass_curves.read([tmp_path / "a.csv", tmp_path / "b.csv"])
