"""The tutorials run as they stand, one after another in one folder, as a person would go through them."""

import json
import re
import runpy
from pathlib import Path

import pytest

from rhizotwin.commands import command_line
from tests.command import Command

pytestmark = pytest.mark.nightly

ROOT = Path(__file__).resolve().parents[2]
ORDER = ("my-first-root", "correct", "my-own-pictures", "my-own-rig")
"""Later ones go on from what earlier ones made."""
FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
NEEDS_A_PERSON = ("rhizotwin view ", "--rig my_rig.toml", "rig check my_rig.toml")
"""Lines that wait for a browser, or for devices that are plugged in: they are read, not run."""


def test_the_tutorials_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Command) -> None:
    assert {path.stem for path in (ROOT / "docs" / "tutorials").glob("*.md")} == set(ORDER)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    for name in ORDER:
        for language, block in FENCE.findall((ROOT / "docs" / "tutorials" / f"{name}.md").read_text(encoding="utf-8")):
            if language == "toml":
                (tmp_path / block.splitlines()[0].removeprefix("# ")).write_text(block, encoding="utf-8")
            elif language == "python":
                (tmp_path / "block.py").write_text(block, encoding="utf-8")
                runpy.run_path("block.py")
            else:
                for line in block.splitlines():
                    program, *words = line.split()
                    assert program == "rhizotwin", line
                    if any(part in line for part in NEEDS_A_PERSON):
                        command_line.bind(words)
                    else:
                        command.works(*words)
        if name == "my-first-root":
            first = json.loads((tmp_path / "my_result" / "result.json").read_text(encoding="utf-8"))
            assert first["volume_trusted"], first["volume_verdict"]
            assert 0.05 < first["volume_mm3"] / 1000.0 < 0.054, "the tutorial quotes this volume"
    assert (tmp_path / "my_corrected" / "corrected.json").is_file()
    assert (tmp_path / "my_scan_result" / "report.html").is_file()
    assert (tmp_path / "my_traits.csv").is_file()
