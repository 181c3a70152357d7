"""The key of a rendered dataset: the same for the same content, another for any change of what made it."""

import shutil
from pathlib import Path

import pytest

from benchmarks import cache

SETTINGS = {"scene": {"name": "ball", "views": 4}, "seed": 0}


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    for name, text in {
        "sim/render.py": "a = 1\n",
        "sim/deep/er.py": "",
        "scenes/model.py": "b = 2\n",
        "scenes/library/ball.toml": "x = 1\n",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def test_the_digest_is_of_content_not_of_place_or_time(sources, tmp_path):
    copy = tmp_path / "elsewhere"
    for package in cache.SOURCES:
        shutil.copytree(sources / package, copy / package)
    (copy / "sim" / "__pycache__").mkdir()
    (copy / "sim" / "__pycache__" / "render.pyc").write_bytes(b"1")
    assert cache.source_digest(copy) == cache.source_digest(sources)


@pytest.mark.parametrize("name", ["sim/render.py", "sim/deep/er.py", "scenes/model.py", "scenes/library/ball.toml", "sim/new.py"])
def test_a_changed_or_new_source_changes_the_digest(sources, name):
    before = cache.source_digest(sources)
    with (sources / name).open("a") as stream:
        stream.write("# changed\n")
    assert cache.source_digest(sources) != before


def test_a_renamed_source_changes_the_digest(sources):
    before = cache.source_digest(sources)
    (sources / "sim" / "render.py").rename(sources / "sim" / "renderer.py")
    assert cache.source_digest(sources) != before


def test_no_sources_are_no_digest(tmp_path):
    with pytest.raises(FileNotFoundError, match="sim"):
        cache.source_digest(tmp_path)


def test_the_key_depends_on_settings_and_sources_only():
    key = cache.key(SETTINGS, sources="s")
    assert key == cache.key(dict(reversed(SETTINGS.items())), sources="s")
    assert key != cache.key(SETTINGS | {"seed": 1}, sources="s")
    assert key != cache.key(SETTINGS, sources="t")


def test_the_folder_can_be_named(monkeypatch, tmp_path):
    monkeypatch.setenv("RHIZOTWIN_CACHE", str(tmp_path))
    assert cache.folder() == tmp_path
    monkeypatch.delenv("RHIZOTWIN_CACHE")
    assert cache.folder() == Path.home() / ".cache" / "rhizotwin"
