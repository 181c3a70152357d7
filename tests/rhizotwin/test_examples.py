"""The example notebooks run from the first cell to the last, in a process and a folder of their own."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.nightly

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))
assert len(NOTEBOOKS) >= 2
SHOW = "_shown = {}\nassert getattr(_shown, '_repr_html_', lambda: None)() or repr(_shown)"
"""What a notebook does with the last line of a cell, if it is a value: HTML where it has any, else its text."""


def program_of(notebook: dict) -> str:
    """Return the code cells as one program, in which the last line of each is shown as a notebook shows it."""
    cells = []
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            *before, last = "".join(cell["source"]).splitlines()
            cells.append("\n".join([*before, SHOW.format(last) if last.replace(".", "").isidentifier() else last]))
    return "\n".join(cells)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_example_runs(path: Path, tmp_path: Path) -> None:
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert not any(cell.get("outputs") for cell in notebook["cells"]), "clear the outputs before committing"
    (tmp_path / "example.py").write_text(program_of(notebook), encoding="utf-8")
    words, env = [sys.executable, "example.py"], os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(words, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
