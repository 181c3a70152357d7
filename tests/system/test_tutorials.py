"""The tutorials run as they stand, one after another in one folder, as a person would go through them."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from rhizotwin import command_line

ROOT = Path(__file__).resolve().parents[2]
ORDER = ("my-first-root", "correct", "my-own-pictures", "my-own-rig")
"""Later ones go on from what earlier ones made."""
FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
NEEDS_A_PERSON = ("rhizotwin view ", "--rig my_rig.toml", "rig check my_rig.toml")
"""Lines that wait for a browser, or for devices that are plugged in: they are read, not run."""


def run(words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a program of this Python in a folder."""
    settings = os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "120"}
    return subprocess.run([sys.executable, *words], cwd=folder, env=settings, capture_output=True, text=True, timeout=900, check=False)


def test_every_tutorial_is_gone_through() -> None:
    assert {path.stem for path in (ROOT / "docs" / "tutorials").glob("*.md")} == set(ORDER)


def test_the_tutorials_run(tmp_path: Path) -> None:
    for name in ORDER:
        for language, block in FENCE.findall((ROOT / "docs" / "tutorials" / f"{name}.md").read_text(encoding="utf-8")):
            if language == "toml":
                (tmp_path / block.splitlines()[0].removeprefix("# ")).write_text(block, encoding="utf-8")
                continue
            for line in block.splitlines() if language == "bash" else [block]:
                if any(part in line for part in NEEDS_A_PERSON):
                    command_line.bind(line.split()[1:])
                    continue
                words = ["-m", *line.split()] if language == "bash" else ["-c", block]
                done = run(words, tmp_path)
                assert done.returncode == 0, f"{name}: {line}\n{done.stderr}"
    assert (tmp_path / "my_corrected" / "corrected.json").is_file()
    assert (tmp_path / "my_scan_result" / "report.html").is_file()
    assert (tmp_path / "my_traits.csv").is_file()


@pytest.mark.parametrize("word", ["Soil", "Dark field", "Square tanks"])
def test_what_it_cannot_do_is_said(word: str) -> None:
    assert f"**{word}" in (ROOT / "docs" / "limits.md").read_text(encoding="utf-8")
