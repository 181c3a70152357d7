"""Cost of the viewer's server alone, in its own process without a browser.

It is measured in processor time, which is reproducible on a busy machine, in contrast to the times of a browser.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from rhizotwin.scenes.errors import UserError

VOXELS = 1000
"""Number of voxels deleted at once."""


def measure(result: Path, dataset: Path | None) -> dict[str, tuple[float, str]]:
    """Run the server in a process without a browser; return its processor times and its peak memory."""
    words = [sys.executable, "-P", "-m", "benchmarks.viewer_server", str(result), *([str(dataset)] if dataset else [])]
    root = str(Path(__file__).resolve().parents[1])  # benchmarks are not installed
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": root})
    assert process.stdout is not None
    told = process.stdout.read()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise UserError(f"the viewer of {result} failed")
    return {f"server/{name}": (value, "s") for name, value in json.loads(told).items()} | {
        "server/peak_memory": (used.ru_maxrss / 1024.0, "MiB")
    }


def answers(result: Path, dataset: Path | None) -> dict[str, float]:
    """Serve a result without a client, and return the processor time (s) of the start and until each response."""
    from rhizotwin.viewer import app
    from rhizotwin.viewer.picking import Ray

    found: dict[str, float] = {}
    answered: list[float] = []

    def timed(name: str, act: Callable[[], object]) -> None:
        answered.clear()
        begun_s = time.process_time()
        act()
        found[name] = (answered[0] if answered else time.process_time()) - begun_s

    viewer = app.start([result], dataset)
    viewer.on_change.append(lambda: answered.append(time.process_time()))
    found["start"] = time.process_time()  # of the whole process up to here
    timed("divide", viewer.prepare)
    session = viewer.shown.session
    lines = session.state.lines
    if lines:
        longest = max(lines, key=lambda number: lines[number].length_mm)
        point = lines[longest].points_mm[len(lines[longest].points_mm) // 2]
        way = np.array([-1.0, 0.3, -0.1]) / np.linalg.norm([-1.0, 0.3, -0.1])
        timed("pick", lambda: viewer.clicked(Ray(point - 400.0 * way, way)))
        timed("delete_root", viewer.delete)
        timed("undo", viewer.undo)
    measured = session.measure()
    rows = np.flatnonzero(measured.volumes_mm3 > 0.0)
    middle = np.linalg.norm(measured.solid.centre_mm[rows] - measured.solid.centre_mm[rows].mean(axis=0), axis=1)
    viewer.deselect()
    viewer.look.layers -= {"surface"}  # it is updated after the number
    viewer.voxels = {int(row) for row in rows[np.argsort(middle)[:VOXELS]]}
    timed("delete_1000_voxels", viewer.delete)
    viewer.look.layers |= {"voxels"}
    timed("voxels_shown", viewer.refresh)
    viewer.served.stop()
    return found


if __name__ == "__main__":
    sys.stdout.write(json.dumps(answers(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else None)))
