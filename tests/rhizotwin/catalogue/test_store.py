"""Entries of a catalogue: added once, completed, never contradicted."""

import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest

from rhizotwin.catalogue import adding, export, report, schema, sources
from rhizotwin.catalogue.records import Plant, Tag
from rhizotwin.catalogue.store import Catalogue
from rhizotwin.catalogue.verify import check
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import MarkerStrip
from rhizotwin.scenes.rsml import write_rsml
from rhizotwin.scenes.solution import Solution
from tests.rhizotwin.catalogue.conftest import SCENE
from tests.roots import straight

TAG = Tag(dictionary="APRILTAG_36h11", first_id=62, markers=62)


def test_entry_is_completed_but_not_contradicted(catalogue: Catalogue):
    solution = Solution(recipe="kliman_2022", factors={"N": 0.5})
    whose = {"species": "Raphanus sativus", "treatment": "low N", "replicate": 0, "sown": "2026-11-01", "notes": "x"}
    plant = Plant(name="P1", solution=solution, tag=TAG, **whose)
    for known in (Plant(name="P1", treatment="low N"), plant, Plant(name="P1")):
        catalogue.add_plant(known)
    with Catalogue.open(catalogue.path, read_only=True) as again:
        assert again.plants() == [plant]
        with pytest.raises(UserError):
            again.add_plant(Plant(name="P2"))
    with pytest.raises(UserError, match="replicate of plant P1 is 0 in the catalogue, but 1"):
        catalogue.add_plant(Plant(name="P1", replicate=1))


def test_names_are_values_and_strips_share_no_markers(catalogue: Catalogue):
    name = "'); DROP TABLE plants; --"
    catalogue.add_plant(Plant(name=name, tag=TAG))
    with pytest.raises(UserError, match="have common markers"):
        catalogue.add_plant(Plant(name="P2", tag=replace(TAG, first_id=100)))
    assert [one.name for one in catalogue.plants()] == [name]
    assert catalogue.scans(plant=name, treatment=name) == []


def test_scans_results_and_masses(catalogue: Catalogue, tmp_path: Path, make_dataset, make_result):
    whose = {"plant": "P1", "treatment": "control", "day": 5.0}
    dataset = make_dataset("P1_day_05", **whose)
    rig = {"focal_scale_found": 1.001, "table_correction_deg": 0.05}
    result = make_result("P1_day_05", sha256=dataset.sha256, changes={"rig": rig}, **whose)
    masses = tmp_path / "masses.csv"
    masses.write_text("plant,day,root_fresh_g\nP1,5,0.4\n")
    adding.add_result(catalogue, result)
    assert catalogue.results()[0].scan is None
    for _ in range(2):  # adding again changes nothing
        added = adding.add_all(catalogue, adding.find_all([tmp_path / "scans", tmp_path / "results", masses]))
        assert (len(added.scans), len(added.results), len(added.tables), added.failed) == (1, 1, 1, ())
        (scan,) = catalogue.scans(plant="P1", treatment="control", day=5.0)
        assert (scan.path, scan.plants, scan.pictures, scan.complete) == (dataset.folder, ("P1",), 2, True)
        (stored,) = catalogue.results(plant="P1")
        assert (stored.path, stored.scan, stored.plants) == (result, dataset.folder, ("P1",))
        panel_level = pytest.approx(90.5 / 255.0)
        assert stored.rig_numbers == {"focal_scale": 1.001, "focal_left": 1.001, "table_steps_deg": 0.05, "panel_level": panel_level}
        assert [(one.plant, one.kind, one.grams) for one in catalogue.masses()] == [("P1", "root_fresh", 0.4)]
    assert check(catalogue) == []
    assert sources.expand_scans([str(catalogue.path)]) == [str(dataset.folder)]
    assert sources.expand_results([catalogue.path], tables=True) == [result, masses]
    assert "P1,control" in export.table(catalogue, "traits").csv()


def test_one_result_is_chosen_for_a_scan_that_is_not_listed(catalogue: Catalogue, make_result):
    """All results are of the same dataset; the corrected one is chosen, and the latest other one is charted."""
    edits = {"count": 1, "who": ["Anna"], "volume_share": 0.01}
    for name, focal, changes in (("a", 1.001, {}), ("b", 1.002, {"edits": edits}), ("c", 1.003, {})):
        adding.add_result(catalogue, make_result(name, sha256="7" * 64, focal=focal, changes=changes, plant="P1", day=5.0))
    assert [one.path.name for one in catalogue.chosen_results()] == ["b"]
    assert [one.value for one in report.rig_history(catalogue)["focal_scale"]] == [1.003]


def test_wires_are_charted_at_their_dates_where_enough_was_found(catalogue: Catalogue, make_result):
    wire = straight((0.0, 0.0, 0.0), (0.0, 0.0, -60.0))
    for day in ("2026-12-01", "2026-12-08"):
        folder = make_result(day, plant="wires", date=day)
        write_rsml(folder / "roots.rsml", [wire])
        adding.add_result(catalogue, folder)
    ((name, points),) = report.wire_history(catalogue, "wires", (0.4, 0.8)).items()
    assert "0.4 mm wire" in name
    assert [(one.day, one.value) for one in points] == [(0.0, pytest.approx(1.0)), (7.0, pytest.approx(1.0))]


def test_paths_move_with_the_catalogue_and_its_links(tmp_path: Path, make_dataset):
    study = tmp_path / "study"
    make_dataset("../study/scans/P1", plant="P1")
    with Catalogue.create(study / "my.rhizotwin") as made:
        adding.add_all(made, adding.find_all([study / "scans"]))
        assert made.rows("SELECT path FROM scans")[0][0] == "scans/P1"
    study.rename(tmp_path / "moved")
    (tmp_path / "link.rhizotwin").symlink_to(tmp_path / "moved" / "my.rhizotwin")
    with Catalogue.open(tmp_path / "link.rhizotwin") as linked:
        make_dataset("../moved/scans/P2", plant="P2")
        adding.add_scan(linked, tmp_path / "moved" / "scans" / "P2")
    with Catalogue.open(tmp_path / "moved" / "my.rhizotwin") as moved:
        assert check(moved) == []


def test_check_names_differences(catalogue: Catalogue, tmp_path: Path, make_dataset, make_result):
    kept, lost, changed = (make_dataset(name, plant=name) for name in ("P1", "P2", "P3"))
    result = make_result("P1")
    adding.add_all(catalogue, adding.find_all([tmp_path / "scans", tmp_path / "results"]))
    make_dataset("P4", plant="P4")
    (kept.folder / "images" / "view_000.png").write_bytes(b"")
    (changed.folder / "images" / "view_001.png").unlink()
    (result / "result.json").write_text("{}")
    lost.folder.rename(tmp_path / "elsewhere")
    found = {(one.path.relative_to(tmp_path).as_posix(), one.kind) for one in check(catalogue)}
    assert found == {
        ("scans/P1/images/view_000.png", "changed"),
        ("scans/P2", "missing"),
        ("scans/P3/images/view_001.png", "missing"),
        ("scans/P4", "unlisted"),
        ("results/P1/result.json", "changed"),
    }


def test_tags_are_taken_from_strips_of_one_plant(catalogue: Catalogue, tmp_path: Path, make_dataset):
    for name, first, plant in (("a", 62, "P1"), ("b", 62, "P1"), ("c", 0, "P2"), ("d", 0, "P3")):
        make_dataset(name, scene=replace(SCENE, strip=MarkerStrip(first_id=first)), plant=plant)
    adding.add_all(catalogue, adding.find_all([tmp_path / "scans"]))
    assert adding.set_tags(catalogue) == ["P1"]
    assert catalogue.plant("P1").tag == TAG


@pytest.mark.parametrize(
    ("sql", "words"),
    [
        ("DELETE FROM plants", "must only read"),
        ("ATTACH '/tmp/other.db' AS other", "must only read"),
        ("SELECT 1; DROP TABLE plants", "one statement"),
        ("SELECT load_extension('x')", "must only read"),
        ("VACUUM INTO 'copy.db'", "must only read"),
        ("SELECT zeroblob(900000000)", "too big"),
        ("WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i FROM n", "more than 100000 rows"),
        ("WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT zeroblob(900000) FROM n", "or 100 MB"),
    ],
)
def test_query_only_reads(catalogue: Catalogue, sql: str, words: str):
    with pytest.raises(UserError, match=words):
        export.query(catalogue, sql)
    catalogue.add_plant(Plant(name="P1"))  # the connection is as before
    assert export.query(catalogue, "SELECT name FROM plants WHERE name = ?", ["P1"]).rows == (("P1",),)


def test_query_without_an_end_is_interrupted(catalogue: Catalogue, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(export, "MOST_S", 0.1)
    with pytest.raises(UserError, match="was stopped after"):
        export.query(catalogue, "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT max(i) FROM n")


def execute(path: Path, statement: str) -> None:
    with closing(sqlite3.connect(path)) as raw:
        raw.execute("PRAGMA writable_schema = ON")
        raw.execute(statement)
        raw.commit()


def test_foreign_files_are_rejected(tmp_path: Path):
    path = tmp_path / "x.rhizotwin"
    with schema._connecting(tmp_path / "empty.rhizotwin") as raw:  # as a killed run leaves it
        raw.execute("PRAGMA journal_mode = WAL")
        raw.close()
    with Catalogue.open_or_create(tmp_path / "empty.rhizotwin") as made:
        assert made.plants() == []
    path.write_bytes(b"SQLite format 3\0" + bytes(300))
    with pytest.raises(UserError, match=r"damaged|not a catalogue"):
        Catalogue.open(path)
    path.unlink()
    execute(path, "CREATE TABLE plants (name)")
    before = path.read_bytes()
    with pytest.raises(UserError, match="not a catalogue"):
        Catalogue.open_or_create(path)
    with pytest.raises(UserError, match="already exists"):
        Catalogue.create(path)
    assert path.read_bytes() == before
    trigger = "CREATE TRIGGER t AFTER INSERT ON plants BEGIN DELETE FROM scans; END"
    undecodable = "UPDATE sqlite_schema SET name = CAST(x'ff' AS TEXT), sql = 'x' WHERE name = 'plants'"
    for k, change in enumerate(("PRAGMA user_version = 9", trigger, undecodable)):
        Catalogue.create(other := tmp_path / f"{k}.rhizotwin").close()
        execute(other, change)
        with pytest.raises(UserError, match="rebuild"):
            Catalogue.open(other)


def test_a_full_disk_is_named(catalogue: Catalogue, monkeypatch: pytest.MonkeyPatch):
    """SQLite calls it an I/O error if it cannot create the file of shared memory."""
    monkeypatch.setattr(schema, "_connect", Mock(side_effect=sqlite3.OperationalError("disk I/O error")))
    with pytest.raises(UserError, match="disk I/O error"):
        Catalogue.open(catalogue.path)
    monkeypatch.setattr(schema.shutil, "disk_usage", lambda _: Mock(free=0))
    with pytest.raises(UserError, match="the disk is full"):
        Catalogue.open(catalogue.path)


def test_damaged_text_is_named(catalogue: Catalogue, tmp_path: Path, make_result):
    make_result("P1", focal=1.001)
    adding.add_all(catalogue, adding.find_all([tmp_path / "results"]))
    catalogue.connection.execute("UPDATE results SET path = 'a' || char(0)")
    with pytest.raises(UserError, match=r"damaged|cannot be used"):
        report.page(catalogue, report.charts(report.rig_history(catalogue)), [])
    catalogue.add_plant(Plant(name="P2"))
    catalogue.connection.execute("UPDATE plants SET sown = 'soon'")
    with pytest.raises(UserError, match="must be a date such as 2022-10-06"):
        catalogue.plants()
