"""Commands without what only POSIX has, as far as that can be tried without Windows."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "tests" / "packaging" / "as_windows.py"


def run(folder: Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run([sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=300)


@pytest.mark.nightly
def test_scenes_simulate_reconstruct_and_view(tmp_path: Path) -> None:
    done = run(
        tmp_path,
        SCRIPT,
        "scenes",
        "simulate sphere_20mm -o dataset --views 8 --image-wh 160x120 --device cpu",
        "reconstruct dataset -o result --device cpu",
        "view result --no-browser",
    )
    assert done.returncode == 0, done.stderr
    assert "press Ctrl-C to stop" in done.stdout
    assert (tmp_path / "result" / "report.html").is_file()
    assert list(tmp_path.rglob(".*")) == []  # locks and temporary files: Windows removes none that is open
    assert (tmp_path / "dataset" / "images" / "view_000.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_a_second_run_finds_the_lock_and_a_later_one_does_not(tmp_path: Path) -> None:
    code = """
import subprocess, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from as_windows import hide_posix
hide_posix()
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.lock import lock_file
lock = Path("lock")
with lock_file(lock, what="a folder"):
    try:
        with lock_file(lock, what="a folder"):
            print("twice")
    except UserError as error:
        print("refused" if "is using it" in str(error) else error)
lock.write_text("left by a killed run")
with lock_file(lock, what="a folder") as left:
    print("left", left)
print("removed", not lock.exists())
"""
    done = run(tmp_path, "-c", code, SCRIPT.parent)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["refused", "left True", "removed True"]
