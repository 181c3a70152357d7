"""What is kept, by keys that any change of what made it changes."""

import shutil
from pathlib import Path

import pytest

from benchmarks import cache, datasets
from benchmarks.cases import Pictures
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.truth import load_truth
from rhizotwin.stored import sources

pytestmark = pytest.mark.usefixtures("coarse_ball")
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


BALL = Pictures(scene="sphere_20mm", rings=2, views=2, image_wh=(32, 24), seed=3)


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_the_truth_of_kept_pictures_is_renewed(tmp_path, monkeypatch):
    monkeypatch.setenv("RHIZOTWIN_CACHE", str(tmp_path))
    folder = datasets.make(BALL)
    truth = folder / "truth" / "truth.json"
    change(truth, '"surface_mm2"', '"of_older_code"')
    folder.with_suffix(".truth").write_text("older\n")
    assert not datasets.is_ready(BALL)
    pictures = (folder / "images" / "view_001.png").stat().st_mtime_ns
    assert datasets.make(BALL) == folder
    assert datasets.is_ready(BALL)
    assert "surface_mm2" in load_truth(folder).traits
    assert (folder / "images" / "view_001.png").stat().st_mtime_ns == pictures
    change(truth, '"volume_mm3": 4', '"volume_mm3": 5')
    folder.with_suffix(".truth").write_text("older\n")
    with pytest.raises(UserError, match="shows a specimen of"):
        datasets.make(BALL)
