"""The keys of what is kept: the same for the same content, another for any change of what made it."""

import shutil
from pathlib import Path

import pytest

from benchmarks import cache, datasets
from rhizotwin import sources

SETTINGS = {"scene": {"name": "ball", "views": 4}, "seed": 0}


@pytest.fixture(scope="module")
def our_sources(tmp_path_factory) -> Path:
    """Return a copy of the sources that tests may change."""
    root = tmp_path_factory.mktemp("sources")
    for package in sources.PACKAGES:
        place = Path(*package.split("."))
        shutil.copytree(sources.ROOT / place, root / place, ignore=shutil.ignore_patterns("__pycache__"))
    return root


def pictures_digest(root: Path) -> str:
    return sources.digest(datasets.PICTURES, root=root, without=datasets.TRUTH_ONLY)


@pytest.fixture(scope="module")
def unchanged(our_sources) -> str:
    return pictures_digest(our_sources)


@pytest.fixture
def appended(our_sources):
    """Append to a source file for the length of one test."""
    before: dict[Path, bytes | None] = {}

    def append(name: str, text: str) -> None:
        path = our_sources / "rhizotwin" / name
        before[path] = path.read_bytes() if path.is_file() else None
        path.write_bytes((before[path] or b"") + text.encode())

    yield append
    for path, content in before.items():
        path.unlink() if content is None else path.write_bytes(content)


CHANGED = 'CHANGED = "otherwise"\n'


@pytest.mark.parametrize(
    "name", ["sim/solids.py", "sim/render.py", "sim/__init__.py", "scenes/model.py", "scenes/plan.py", "sim/table.dat"]
)
def test_what_decides_the_pictures_changes_their_key(our_sources, unchanged, appended, name):
    appended(name, CHANGED)
    assert pictures_digest(our_sources) != unchanged


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("scenes/traits.py", CHANGED),
        ("sim/truth.py", CHANGED),
        ("sim/board.py", CHANGED),  # pictures of the lens's board
        ("recon/reconstruct.py", CHANGED),
        ("scenes/library/sphere_20mm.toml", "# another scene\n"),
        ("sim/solids.py", "# a comment\n"),
        ("sim/solids.py", '"""Words."""\n'),
    ],
    ids=lambda value: value.strip(),
)
def test_what_does_not_decide_the_pictures_keeps_their_key(our_sources, unchanged, appended, name, text):
    appended(name, text)
    assert pictures_digest(our_sources) == unchanged


def test_traits_are_in_the_digest_of_the_truth(our_sources, appended):
    before = sources.digest(datasets.TRUTH, root=our_sources)
    appended("scenes/traits.py", CHANGED)
    assert sources.digest(datasets.TRUTH, root=our_sources) != before


def test_the_renderer_and_the_plant_are_in_the_closure_and_the_reconstruction_is_not():
    found = set(sources.closure(datasets.PICTURES, without=datasets.TRUTH_ONLY))
    assert {
        "rhizotwin.sim.simulate",
        "rhizotwin.sim.render",
        "rhizotwin.sim.solids",
        "rhizotwin.sim.growth",
        "rhizotwin.sim.dirt",
        "rhizotwin.scenes.model",
    } <= found
    assert not {name for name in found if name.startswith("rhizotwin.recon")}
    assert not found & datasets.TRUTH_ONLY


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
