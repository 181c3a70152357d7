"""What is imported, listed or drawn first waits for no library that takes long to load, or that a small computer does not have."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SLOW = ("mitsuba", "drjit", "trimesh", "skimage", "matplotlib", "manifold3d")
CASES = {
    "import rhizotwin": ("import rhizotwin", (*SLOW, "numpy", "scipy", "cv2", "tqdm", "cyclopts")),
    "help of every command and the list of scenes": (
        "from rhizotwin import cli; from rhizotwin.commands import COMMANDS\n"
        "for command in ('', *COMMANDS): cli.main([*command.split(), '--help'])\n"
        "cli.main(['scenes'])",
        (*SLOW, "numpy", "scipy", "cv2"),
    ),
    "the rig on a Raspberry Pi, until the twin renders": (
        "from rhizotwin.commands import scan, rig, camera, twin; from rhizotwin.rig import jog, bench, open\n"
        "from rhizotwin.rig.scanning import scan",
        SLOW,
    ),
    "the viewer, until something is corrected": (
        "from rhizotwin.viewer import app, panels",
        ("mitsuba", "drjit", "trimesh", "scipy", "matplotlib", "skimage"),
    ),
}


@pytest.mark.parametrize(("program", "heavy"), CASES.values(), ids=CASES.keys())
def test_nothing_heavy_is_loaded(program: str, heavy: tuple[str, ...]) -> None:
    whole = f"import sys\n{program}\nprint([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", whole], cwd=ROOT, capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.splitlines()[-1] == "[]"
