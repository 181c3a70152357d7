"""What is kept, by keys that any change of what made it changes, and renderings from elsewhere that are what it would render."""

import json
import shutil
from pathlib import Path

import pytest

from benchmarks import cache, datasets
from benchmarks.adopt import adopt
from benchmarks.cases import Pictures
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.truth import load_truth
from rhizotwin.sim.simulate import simulate
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


@pytest.fixture(scope="module")
def rendered(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("elsewhere") / "ball"
    simulate(BALL.scene_to_render(), folder, profile_name=BALL.profile, seed=BALL.seed)
    return folder


@pytest.fixture
def copy(rendered, tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("RHIZOTWIN_CACHE", str(tmp_path / "cache"))
    shutil.copytree(rendered, tmp_path / "ball")
    return tmp_path / "ball"


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_what_fits_is_taken_and_its_truth_kept_up_to_date(copy):
    before = (copy / "dataset.json").read_bytes()
    change(copy / "truth" / "truth.json", '"surface_mm2"', '"of_older_code"')
    assert not datasets.is_ready(BALL)
    adopted = adopt(copy)
    assert adopted == datasets.place(BALL)
    assert datasets.is_ready(BALL)
    assert load_dataset(adopted).frames == load_dataset(copy).frames
    assert "surface_mm2" in load_truth(adopted).traits
    assert (copy / "dataset.json").read_bytes() == before  # the original is left as it was
    assert (copy / "images" / "view_000.png").is_file()

    change(adopted / "truth" / "truth.json", '"surface_mm2"', '"of_older_code"')
    adopted.with_suffix(".truth").write_text("older\n")
    assert not datasets.is_ready(BALL)
    pictures = (adopted / "images" / "view_001.png").stat().st_mtime_ns
    assert adopt(copy) == datasets.make(BALL) == adopted
    assert "surface_mm2" in load_truth(adopted).traits
    assert (adopted / "images" / "view_001.png").stat().st_mtime_ns == pictures
    assert datasets.is_ready(BALL)


def test_another_plan_seed_or_renderer_is_refused(copy):
    manifest = json.loads((copy / "dataset.json").read_text())
    first = manifest["frames"][0]["sha256"]
    for old, new, said in (
        ('"seed": 3', '"seed": 4', "does not fit"),
        ('"height_mm": 10.0', '"height_mm": 11.0', "rig or plan"),
        (first, "0" * 64, "differs when it is rendered"),
        ('"profile": "clean"', '"profile": "bench"', "does not fit"),
    ):
        (copy / "dataset.json").write_text(json.dumps(manifest))
        change(copy / "dataset.json", old, new)
        with pytest.raises(UserError, match=said):
            adopt(copy)
    assert not any(path.is_dir() for path in (datasets.place(BALL).parent).iterdir())
