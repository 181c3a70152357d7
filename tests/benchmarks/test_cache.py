"""The keys of what is kept: the same for the same content, another for any change of what made it."""

import shutil
from pathlib import Path

import pytest

from benchmarks import cache, datasets, growth
from rhizotwin import sources

SETTINGS = {"scene": {"name": "ball", "views": 4}, "seed": 0}


@pytest.fixture(scope="module")
def our_sources(tmp_path_factory) -> Path:
    """Return a copy of the sources that tests may change."""
    root = tmp_path_factory.mktemp("sources")
    for package in sources.PACKAGES:
        place = Path(*package.split("."))
        if (sources.ROOT / place).is_dir():
            shutil.copytree(sources.ROOT / place, root / place, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy((sources.ROOT / place).with_suffix(".py"), (root / place).with_suffix(".py"))
    return root


def pictures_digest(root: Path) -> str:
    return sources.digest(datasets.PICTURES, root=root, without=datasets.TRUTH_ONLY)


CHANGED = 'CHANGED = "otherwise"\n'


@pytest.mark.parametrize(
    ("name", "text", "decides"),
    [
        ("sim/solids.py", CHANGED, True),
        ("scenes/plan.py", CHANGED, True),
        ("sim/table.dat", CHANGED, True),
        ("scenes/traits.py", CHANGED, False),
        ("sim/truth.py", CHANGED, False),
        ("recon/reconstruct.py", CHANGED, False),
        ("scenes/library/sphere_20mm.toml", "# another scene\n", False),
        ("sim/solids.py", '"""Words."""\n', False),
    ],
    ids=lambda value: str(value).strip(),
)
def test_the_key_changes_with_what_decides_the_pictures(our_sources, name, text, decides):
    before, truth_before = pictures_digest(our_sources), sources.digest(datasets.TRUTH, root=our_sources)
    path = our_sources / "rhizotwin" / name
    content = path.read_bytes() if path.is_file() else None
    path.write_bytes((content or b"") + text.encode())
    after, truth_after = pictures_digest(our_sources), sources.digest(datasets.TRUTH, root=our_sources)
    path.unlink() if content is None else path.write_bytes(content)
    assert (after != before) is decides
    assert truth_after != truth_before or name != "scenes/traits.py"


def test_the_key_depends_on_settings_and_sources_only():
    key = cache.key(SETTINGS, sources="s")
    assert key == cache.key(dict(reversed(SETTINGS.items())), sources="s")
    assert key != cache.key(SETTINGS | {"seed": 1}, sources="s")
    assert key != cache.key(SETTINGS, sources="t")


def test_pictures_of_a_growing_plant_are_kept(monkeypatch):
    kept = growth.place("bench")
    assert growth.place("bench") == kept
    assert growth.place("clean") != kept
    monkeypatch.setattr(growth.sources, "digest", lambda *_: "changed")
    assert growth.place("bench") != kept
