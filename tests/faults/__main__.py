"""Ten faults of one line, each put into a copy of the committed sources, which the short tests must notice: ``python -m tests.faults``.

The tests of the package come first, all short ones after them where those pass. Prints which test noticed each fault; the
exit code is 1 where more than one is not noticed.
"""

import os
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MOST_UNNOTICED = 1


@dataclass(frozen=True)
class Fault:
    """A line that is wrong."""

    what: str
    file: str
    right: str
    wrong: str


FAULTS = (
    Fault(
        "refraction turns the wrong way at the inner wall", "recon/optics/refraction.py",
        right="heading + np.arcsin(b_g / r_i) - np.arcsin(b_w / r_i)", wrong="heading - np.arcsin(b_g / r_i) + np.arcsin(b_w / r_i)",
    ),
    Fault("a cube is empty at the outline", "recon/hull/marks.py", "(distance < -reach - slack_px)", "(distance < reach - slack_px)"),
    Fault("corners are off by one pixel", "recon/calibration/markers.py", "+ 0.5) * scale - 0.5)", "+ 0.5) * scale + 0.5)"),
    Fault("a one-sided term counts half", "recon/uncertainty/budget.py", "0.5 * max(this - other, 0.0)", "0.0 * max(this - other, 0.0)"),
    Fault("directions at a fork are those within it", "recon/roots/hierarchy.py", "skip_mm if way[-1] > skip_mm else 0.0", "0.0"),
    Fault("pixels are half a pixel off", "sim/sensor.py", "sample2.x * width - 0.5 -", "sample2.x * width -"),
    Fault("the strip is upside down", "sim/strip.py", "(strip.rows - 1 - row) * strip.row_pitch_mm", "row * strip.row_pitch_mm"),
    Fault("a servo frame's checksum is not inverted", "rig/arm/lx_bus.py", "(~sum(body) & 0xFF,)", "(sum(body) & 0xFF,)"),
    Fault("the table arrives from above", "rig/table/turntable.py", "(0, angle_deg - room_deg)", "(0, angle_deg + room_deg)"),
    Fault(
        "the end of the arm's way is not checked", "rig/arm/clearance.py",
        "here.distance_mm[k] < here.margin_mm).any()", "here.distance_mm[k] < -here.margin_mm).any()",
    ),
)  # fmt: skip


def noticed(fault: Fault, copy: Path) -> str:
    """Return the first test that fails under a fault; empty where none does."""
    file = copy / fault.file
    source = file.read_text(encoding="utf-8")
    if source.count(fault.right) != 1:
        raise ValueError(f"{fault.file} has {fault.right!r} {source.count(fault.right)} times, not once")
    file.write_text(source.replace(fault.right, fault.wrong), encoding="utf-8")
    words = [sys.executable, "-m", "pytest", "-q", "-x", "--numprocesses", "auto", "--dist", "loadfile", "-m", "not slow"]
    try:
        for tests in (f"tests/{Path(fault.file).parent}", "tests"):
            done = subprocess.run(
                [*words, tests], cwd=copy, env=os.environ | {"PYTHONPATH": str(copy)}, capture_output=True, text=True, check=False
            )
            if found := re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE):
                return found[1]
    finally:
        file.write_text(source, encoding="utf-8")
    return ""


def main() -> int:
    """Try every fault."""
    unnoticed = 0
    with tempfile.TemporaryDirectory(prefix="rhizotwin-faults-") as folder:
        subprocess.run(["git", "clone", "--quiet", str(ROOT), folder], check=True)
        for fault in FAULTS:
            test = noticed(fault, Path(folder))
            unnoticed += not test
            sys.stdout.write(f"{fault.what}: {test or 'NOT NOTICED'}\n")
            sys.stdout.flush()
    return int(unnoticed > MOST_UNNOTICED)


if __name__ == "__main__":
    sys.exit(main())
