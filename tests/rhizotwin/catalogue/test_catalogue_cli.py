"""The commands of a catalogue, and those that accept one in place of folders."""

from dataclasses import replace
from pathlib import Path

from rhizotwin.catalogue import export, sources
from rhizotwin.catalogue.records import Plant
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.files import save_scene
from tests.command import Command
from tests.rhizotwin.timelapse.conftest import small_scene

SCENE = small_scene(3)
SKETCH = ("--rig", "twin", "--fidelity", "sketch", "--profile", "clean", "--seed", "2")


def test_commands_of_a_catalogue_and_those_that_accept_one(tmp_path: Path, command: Command, make_dataset, make_result):
    """Two plants on two days, and a table of their masses."""
    for plant, treatment, volume in (("P1", "control", 900.0), ("P2", "low N", 700.0)):
        for day in (5.0, 6.0):
            whose = {"plant": plant, "treatment": treatment, "day": day}
            sha256 = make_dataset(f"{plant}_{day:g}", **whose).sha256
            changes = {"volume_mm3": volume + 10.0 * day}
            make_result(f"{plant}_{day:g}", sha256=sha256, focal=1.0 + 0.001 * day, changes=changes, **whose)
    files = (tmp_path / "scans", tmp_path / "results", tmp_path / "masses.csv", tmp_path / "solution.csv")
    files[2].write_text("plant,day,root_fresh_g\nP1,6,0.9\nP2,6,0.7\n")
    readings = "P1,5,,5.8,1400,5.4,0.1\nP1,6,no,6.1,1380,5.3,0.1\nP1,6,yes,5.8,1400,5.4,0.1\n"
    files[3].write_text(f"plant,day,renewed,pH,volume_ml,K_mmol_per_l,K_sd_mmol_per_l\n{readings}")
    file = tmp_path / "my.rhizotwin"
    assert "added 4 datasets, 4 results and 2 tables" in command.works("catalogue", "add", file, *files).out
    assert "low N" in command.works("catalogue", "list", file, "plants").out
    assert "2 rows" in command.works("catalogue", "list", file, "scans", "--plant", "P2").out
    assert command.works("catalogue", "list", file, "--plant", "P2").out.split()[:6] == ["plants", "1", "scans", "2", "results", "2"]
    command.fails("catalogue", "list", file, "scans", "--plant", "P9", named=["no plant is named 'P9'; known plants: P1, P2"])
    assert "P1" in command.works("catalogue", "query", file, "SELECT name FROM plants ORDER BY name LIMIT 1").out
    assert "no difference" in command.works("catalogue", "check", file).out
    command.works("catalogue", "export", file, "-o", tmp_path / "tables")
    assert (tmp_path / "tables" / "masses.csv").read_text().startswith("plant,day,kind,grams,source\nP1,6,root_fresh,0.9,masses.csv\n")
    lines = (tmp_path / "tables" / "readings.csv").read_text().splitlines()
    assert lines[:2] == ["plant,day,renewed,quantity,value,sd,unit,source", "P1,5,0,pH,5.8,,,solution.csv"]
    assert "P1,6,1,K,5.4,0.1,mmol/l,solution.csv" in lines
    command.works("catalogue", "add", file, files[3])
    assert "9 rows" in command.works("catalogue", "list", file, "readings", "--plant", "P1").out, "a table that is added again is replaced"
    other = tmp_path / "other.csv"
    other.write_text("plant,day,pH\nP1,5,5.9\n")
    assert "the pH of plant P1 is also in solution.csv" in command("catalogue", "add", file, other).out
    other.write_text("plant,day,colour\nP1,5,green\n")
    assert "contains neither masses nor readings" in command("catalogue", "add", file, other).out
    assert "report: " in command.works("catalogue", "report", file, "-o", tmp_path / "report").out
    assert (tmp_path / "report" / "catalogue.html").stat().st_size > 5000
    rebuilt = tmp_path / "new.rhizotwin"
    command.works("catalogue", "rebuild", rebuilt, *files)
    with Catalogue.open(file) as old, Catalogue.open(rebuilt) as new:
        assert [new.scans(), new.results(), new.masses()] == [old.scans(), old.results(), old.masses()]
        assert export.table(new, "readings") == export.table(old, "readings")
    command.fails("catalogue", "rebuild", rebuilt, tmp_path / "scans", named=["already exists"])
    assert "P1" in command.works("traits", file).out
    command.works("growth", file, "-o", tmp_path / "growth")
    assert (tmp_path / "growth" / "masses.csv").is_file()
    assert "P1,control,K,5,6," in (tmp_path / "growth" / "uptake.csv").read_text()
    command.fails("biomass", "fit", file, "-o", tmp_path / "model.json", named=["plants"])  # two are too few, but both were found
    with Catalogue.open(file) as opened:  # phantoms are left out of growth
        opened.add_plant(Plant(name="P2", phantom=True))
        opened.add_plant(Plant(name="P2"))
        assert opened.plant("P2").phantom
    assert len(sources.expand_results([file])) == 4
    assert {path.name[:2] for path in sources.expand_results([file], phantoms=False)} == {"P1"}


def test_wrong_folders_and_damaged_entries_are_reported(tmp_path: Path, command: Command, make_dataset):
    command.fails("catalogue", "add", tmp_path / "my.rhizotwin", tmp_path / "sacns", named=["sacns: the folder or table"])
    assert not (tmp_path / "my.rhizotwin").exists()
    (tmp_path / "masses.csv").write_text("plant,root_fresh_g\nP1,1.0\n")
    command.fails("catalogue", "add", tmp_path, tmp_path / "masses.csv", named=["is a folder; give a catalogue file"])
    good = make_dataset("P1", plant="P1").folder
    (make_dataset("P2", plant="P2").folder / "dataset.json").write_text("{")
    failed = command.fails("catalogue", "add", tmp_path / "my.rhizotwin", tmp_path / "scans", named=["1 entry could not be added"])
    assert "not added:" in failed.out
    with Catalogue.open(tmp_path / "my.rhizotwin") as opened:
        assert [one.path for one in opened.scans()] == [good]


def test_scan_recognises_the_plant(tmp_path: Path, command: Command):
    file, scene, coded = tmp_path / "my.rhizotwin", tmp_path / "scene.toml", tmp_path / "canister_120.toml"
    save_scene(SCENE, scene)
    save_scene(replace(SCENE, strip=replace(SCENE.strip, first_id=119 * 22)), coded)
    for number, treatment in ((1, "control"), (120, "low N")):
        words = ("catalogue", "plant", file, f"P{number}", "--canister", number, "--scene", scene)
        command.works(*words, "--treatment", treatment, "--sown", "2026-11-20")
    scan = ("scan", "--scene", coded, *SKETCH, "--catalogue", file, "--date", "2026-12-01", "-o")
    assert "plant: P120, treatment low N, day 11" in command.works(*scan, tmp_path / "d").out
    assert load_dataset(tmp_path / "d").scene.subject.plant == "P120"
    with Catalogue.open(file) as opened:
        assert [(one.plants, one.day) for one in opened.scans()] == [(("P120",), 11.0)]
    command.fails(*scan, tmp_path / "e", "--plant", "P1", named=["is P120 instead of P1; put P1 on the turntable"])
    assert not list(tmp_path.glob("e/images/*"))


def test_wrong_value_of_a_plant_is_replaced(tmp_path: Path, command: Command):
    words = ("catalogue", "plant", tmp_path / "my.rhizotwin", "P1")
    command.works(*words, "--treatment", "control", "--sown", "2026-11-20", "--replicate", "2")
    changes = ("--treatment", "low N", "--sown", "2026-11-21")
    command.fails(*words, *changes, named=["but low N in the new entry", "`rhizotwin catalogue plant --replace`"])
    command.works(*words, *changes, "--replace")
    with Catalogue.open(tmp_path / "my.rhizotwin") as opened:
        assert opened.plant("P1") == Plant(name="P1", treatment="low N", sown="2026-11-21", replicate=2)


def test_time_lapse_commands(tmp_path: Path, command: Command):
    file = tmp_path / "e.toml"
    command.works("timelapse", "example", "-o", file)
    assert "60 scans planned" in command.works("timelapse", "status", file).out
    save_scene(SCENE, tmp_path / "scene.toml")
    told = command.works("markers", tmp_path / "scene.toml", "-o", tmp_path / "strips.pdf", "--labels", "3").out
    assert "canister 3: APRILTAG_36h11 markers 44 to 65" in told
    text = file.read_text().replace("radish_day15a", "scene.toml").replace("rounds = 10", "rounds = 1").replace('"bench"', '"clean"')
    file.write_text("[[plants]]".join(text.split("[[plants]]")[:3]))
    assert "scans: 2 finished, 0 missed, 0 still planned" in command.works("timelapse", "run", file, "--quiet").out
    assert command.works("timelapse", "status", file, "--every").out.count("scanned") == 2
