"""Folders as somebody hostile would send them: nothing outside is touched, and commands that read change nothing at all."""

import subprocess
import sys
from pathlib import Path

import pytest

from rhizotwin.commands import cli
from tests.fuzz.folders import MARKS, Given, prepared, snapshot, variants

READING = ("traits {f}", "export {f} -o {out}/x.stl", "report {f} -o {out}/p.html")
HOSTILE = {
    ".rhizotwin-whole: files of paths": 0,
    ".rhizotwin-moving: link to a folder": 0,
    "lock: text 7, half moved": 2,
    "images: link to a folder": 2,
    "roots.rsml: pipe": 2,
}
"""Variants, and how `traits` ends: with its numbers, or with a sentence."""


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("words", READING, ids=lambda words: words.split()[0])
def test_commands_that_read_leave_a_foreign_folder_alone(words: str, name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    place = tmp_path / "place"
    line = prepared(Given(words, base="all"), variants()[name], place)
    (place / "out").rename(tmp_path / "out")
    before = snapshot(place)
    code = cli.main([word.replace(str(place / "out"), str(tmp_path / "out")) for word in line])
    assert snapshot(place) == before
    assert code == HOSTILE[name] or (code in (0, cli.EXIT_MISTAKE) and not words.startswith("traits"))
    assert "\x1b" not in "".join(capfd.readouterr())


@pytest.mark.parametrize("mark", MARKS[:5])
@pytest.mark.parametrize("shape", ["link to a folder", "links in it", "other link"])
def test_a_command_that_writes_touches_nothing_outside(mark: str, shape: str, tmp_path: Path) -> None:
    line = prepared(Given("export {r} --dataset {d} -o {f}"), variants()[f"{mark}: {shape}"], tmp_path)
    before = snapshot(tmp_path / "outside")
    assert cli.main(line) in (0, cli.EXIT_MISTAKE)
    assert snapshot(tmp_path / "outside") == before


@pytest.mark.slow
def test_a_sample_of_every_command() -> None:
    """The campaign itself (./run fuzz --folders), which also hears what is opened, on some of its ten thousand pairs."""
    words = [sys.executable, "-m", "tests.fuzz", "--folders", "--inputs", "30"]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=300, cwd=Path(__file__).parents[2])
    assert done.returncode == 0, done.stdout + done.stderr
