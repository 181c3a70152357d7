"""Published folders: valid RO-Crates with checksums, MIAPPE tables and no path of a person; bad input is refused whole."""

import csv
import hashlib
import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from rhizotwin.commands import cli
from rhizotwin.publishing import crate, miappe
from rhizotwin.publishing import published as publishing
from rhizotwin.publishing.study import EXAMPLE, _is_orcid, read_study
from rhizotwin.report import page
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.stored import result_files, stored_traits
from tests.command import Command
from tests.conftest import Reconstructed
from tests.interop.ro_crate import violations
from tests.rhizotwin import plant as plants

pytest.importorskip("rocrate")


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "study.toml"
    path.write_text(EXAMPLE, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def published(made: Path, found: Reconstructed, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("published")
    (folder / "study.toml").write_text(EXAMPLE, encoding="utf-8")
    words = ["export", made, found.folder, "--publish", folder / "data", "--study", folder / "study.toml"]
    assert cli.main([str(word) for word in words]) == 0
    return folder / "data"


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of rdflib, in the validator
def test_the_folder_is_a_valid_ro_crate(published: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rocrate_validator")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = Path(shutil.copytree(published, tmp_path / "data"))
    assert violations(folder) == []  # what is required included
    (folder / "LICENSE.txt").unlink()
    assert violations(folder, "REQUIRED") != []


def test_checksums_tables_and_copies_are_those_of_the_sources(published: Path, made: Path, found: Reconstructed) -> None:
    lines = (published / "checksums-sha256.txt").read_text(encoding="utf-8").splitlines()
    listed = {name: digest for digest, name in (line.split("  ", 1) for line in lines)}
    files = {path.relative_to(published).as_posix() for path in published.rglob("*") if path.is_file()}
    assert set(listed) == files - {"checksums-sha256.txt"}
    assert all(hashlib.sha256((published / name).read_bytes()).hexdigest() == digest for name, digest in listed.items())
    scan, result = published / "scans" / made.name, published / "results" / found.folder.name
    assert (scan / "dataset.json").read_bytes() == (made / "dataset.json").read_bytes()
    assert json.loads((result / "result.json").read_text(encoding="utf-8"))["dataset"] == f"scans/{made.name}"
    text = "".join(path.read_text(encoding="utf-8") for path in (result / "report.html", published / "ro-crate-metadata.json"))
    assert str(made) not in text
    tables = {path.stem: list(csv.DictReader(path.read_text(encoding="utf-8").splitlines())) for path in (published / "miappe").iterdir()}
    (above,), (study,) = tables["investigation"], tables["study"]
    assert (above["License"], above["MIAPPE version"]) == ("https://spdx.org/licenses/CC-BY-4.0", "1.1")
    ids = (above["Investigation unique ID"], study["Study unique ID"])
    rows = [row for name, table in tables.items() for row in table if name != "investigation"]
    assert {(row["Investigation unique ID"], row["Study unique ID"]) for row in rows} == {ids}
    assert [row["Data file link"] for row in tables["data_file"]][:2] == [f"scans/{made.name}", f"results/{found.folder.name}"]
    assert [row["Observation unit ID"] for row in tables["observation_unit"]] == [made.name]
    assert "SPDX-License-Identifier: CC-BY-4.0" in (published / "LICENSE.txt").read_text(encoding="utf-8")
    assert "CC-BY-4.0" in (published / "README.md").read_text(encoding="utf-8")
    assert (published / "contact_sheet.png").read_bytes()[:4] == b"\x89PNG"


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> plants.Plant:
    return plants.make(tmp_path_factory.mktemp("plant"))


def edit_summary(folder: Path, **changes: object) -> None:
    summary = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    (folder / "result.json").write_text(json.dumps(summary | changes), encoding="utf-8")


def found_in(folder: Path) -> publishing.Found:
    return publishing.Found(
        name="one", folder=folder, summary=result_files.read_summary(folder), traits=stored_traits.read(folder), scan=None
    )


@pytest.mark.parametrize("dataset", ["wd", "/home/ann/<my> scan \udce9"])
def test_a_published_report_differs_only_in_its_dataset(plant: plants.Plant, dataset: str, tmp_path: Path) -> None:
    edit_summary(plant.result, dataset=dataset)
    page.write(plant.result, dataset=plant.dataset)
    publishing.copy([], [found_in(plant.result)], tmp_path, monitor=Monitor())
    edit_summary(plant.result, dataset="")
    expected = page.write(plant.result, dataset=plant.dataset).read_bytes()
    assert (tmp_path / "results" / "one" / "report.html").read_bytes() == expected


def test_tables_name_versions_and_the_columns_of_the_traits(plant: plants.Plant, study: Path, tmp_path: Path) -> None:
    found = found_in(plant.result)
    variables = csv.DictReader(miappe.tables(read_study(study), [], [found])["observed_variable.csv"].splitlines())
    names = [row["Variable ID"] for row in variables]
    assert "volume_mm3" in names
    assert set(names) <= set(stored_traits.spreadsheet([(found.name, found.summary, found.traits)]).splitlines()[0].split(","))
    found = replace(found, summary={key: value for key, value in found.summary.items() if key not in ("versions", "settings")})
    crate.write(tmp_path, read_study(study), [], [found], files={}, version="9.9")
    (action,) = [one for one in json.loads((tmp_path / "ro-crate-metadata.json").read_bytes())["@graph"] if one["@type"] == "CreateAction"]
    assert action["description"] == "rhizotwin of unknown version"


def test_bad_pictures_links_and_missing_words_leave_nothing(made: Path, study: Path, tmp_path: Path, command: Command) -> None:
    goal = tmp_path / "data"
    command.fails("export", made, "--publish", goal, named=["--study", "title", "licence", "authors"])
    (tmp_path / "empty").mkdir()
    command.fails("export", tmp_path / "empty", "--publish", goal, "--study", study, named=["contains neither a dataset"])
    (tmp_path / "empty" / "elsewhere").symlink_to(made)
    command.fails("export", tmp_path / "empty", "--publish", goal, "--study", study, named=["is a link"])
    copy = tmp_path / "copy"
    shutil.copytree(made, copy)
    picture = sorted((copy / "images").iterdir())[0]
    picture.write_bytes(picture.read_bytes()[:-50])
    command.fails("export", copy, "--publish", goal, "--study", study, named=[picture.name])
    picture.unlink()
    picture.symlink_to("/etc/passwd")
    command.fails("export", copy, "--publish", goal, "--study", study, named=["is a link"])
    assert not goal.exists()


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("CC-BY-4.0", "CC-BY", 'did you mean "CC-BY-4.0"'),
        ("0000-0002-1825-0097", "0000-0002-1825-0098", "check digit"),
        ("[[authors]]", 'published = "yesterday"\n[[authors]]', "must be a date"),
        ("[[authors]]", 'publication_doi = "https://doi.org/10.1/2"\n[[authors]]', "must be a DOI"),
    ],
)
def test_a_wrong_study_is_one_sentence(study: Path, old: str, new: str, named: str) -> None:
    assert read_study(study).authors[0].name == "Ada Example"
    study.write_text(EXAMPLE.replace(old, new), encoding="utf-8")
    with pytest.raises(UserError, match=named) as caught:
        read_study(study)
    assert "\n" not in str(caught.value)


def test_orcid_check_digits() -> None:
    known = ("0000-0002-1825-0097", "0000-0001-5109-3700", "0000-0002-1694-233X")
    right = [one[:-1] + digit for one in known for digit in "0123456789X" if _is_orcid(one[:-1] + digit)]
    assert right == list(known)
