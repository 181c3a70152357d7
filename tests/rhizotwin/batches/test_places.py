"""Datasets in folders, patterns and other file systems."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from rhizotwin.batches import collect, places, work
from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError
from tests.rhizotwin.batches.conftest import dataset, job


def test_datasets_are_found_in_folders_and_patterns_each_once(tmp_path: Path) -> None:
    for place in ("a/one", "a/deep/two", "a/.trash/four", "b/three"):
        dataset(tmp_path / place)
    assert [Path(found).name for found in places.find_datasets(str(tmp_path / "a"))] == ["two", "one"]
    given = [str(tmp_path / "a"), str(tmp_path / "*"), str(tmp_path / "a" / "one")]
    made = collect.reconstructions(given, str(tmp_path / "results"), voxel_mm=None, settings=None, device="cpu")
    assert sorted(one.name for one in made) == ["one", "three", "two"]


@pytest.fixture
def elsewhere() -> Iterator[str]:
    """Return an address of a file system in memory."""
    fsspec = pytest.importorskip("fsspec")
    yield "memory://batch"
    fsspec.filesystem("memory").store.clear()


def test_addresses_are_found_fetched_and_put(elsewhere: str, tmp_path: Path) -> None:
    here = dataset(tmp_path / "here")
    (here / "images").mkdir()
    (here / "images" / "a.png").write_bytes(b"picture")
    places.put(here, f"{elsewhere}/scans/one", last="dataset.json")
    assert [places.name_of(found) for found in places.find_datasets(f"{elsewhere}/scans")] == ["one"]
    places.fetch(f"{elsewhere}/scans/one", tmp_path / "back")
    assert (tmp_path / "back" / "images" / "a.png").read_bytes() == b"picture"
    with pytest.raises(UserError, match="could not be opened"):
        places.find_datasets("nowhere://x")


def test_an_earlier_result_at_an_address_leaves_no_file_behind(elsewhere: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = ["result.json", "roots.rsml", "silhouettes/a.png"]

    def reconstruct(_: Path, output: Path, *_options: object, **__: object) -> None:
        for name in made:
            atomic.write_bytes(output / name, b"new")

    monkeypatch.setattr("rhizotwin.steps.command_steps.reconstruct_whole", reconstruct)
    remote = replace(job("one", tmp_path), output=f"{elsewhere}/r/one")
    places.write(f"{elsewhere}/r/one/notes.txt", b"mine")
    assert work.work(remote.plain())["state"] == "done"
    made[1:] = ["silhouettes/b.png"]
    assert work.work(remote.plain())["state"] == "done"
    places.fetch(f"{elsewhere}/r/one", tmp_path / "back")
    left = sorted(str(path.relative_to(tmp_path / "back")) for path in (tmp_path / "back").rglob("*.*"))
    assert left == ["notes.txt", "result.json", "silhouettes/b.png"]
