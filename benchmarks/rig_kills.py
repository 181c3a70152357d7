"""Scans that are killed (SIGKILL) at random times and resumed, compared with an undisturbed scan.

The emulated rig runs in this process with pseudo-terminals; the scans are separate processes, as on a bench. On a
tripod the camera is static, so that the two datasets must agree in every pixel; an arm is placed again after each kill,
which is recorded in ``Frame.placement`` and changes the pictures.
"""

import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.rig_faults import IMAGE_WH
from rhizotwin.rig.rig_file import RigFile
from rhizotwin.rig.twin.server import TwinServer, rig_text
from rhizotwin.rig.twin.twin import Twin, default_rig
from rhizotwin.scenes import atomic, files
from rhizotwin.scenes.dataset import Dataset, Frame, file_sha256, load_dataset, read_image
from rhizotwin.scenes.model import CapturePlan, Ring, Scene

VIEWS = 12
SPEED = 40.0
"""Speed of the twin's time relative to real time."""
MOST_S = 120.0
KILLS_EACH = 5
"""Number of kills of one dataset before it is completed."""


@dataclass(frozen=True, kw_only=True)
class KillRuns:
    """Result of the killed scans."""

    kills: int
    datasets: int
    problems: tuple[str, ...]


def run_all(kills: int, *, say: Callable[[str], None]) -> KillRuns:
    """Kill scans the given number of times, half of them on a tripod and half with an arm."""
    problems: list[str] = []
    made = done = 0
    for arm in (False, True):
        with tempfile.TemporaryDirectory(prefix="rhizotwin-kills-") as name:
            folder = Path(name)
            whole, _ = _scan_with_kills(folder / "whole", arm=arm, kills=0, seed=0)
            share = kills // 2 + (kills % 2 if arm else 0)
            left, number = share, 0
            while left > 0:  # a scan may end before it was killed as often as intended
                number += 1
                found, killed = _scan_with_kills(folder / f"killed_{number}", arm=arm, kills=min(KILLS_EACH, left), seed=number)
                left -= killed
                new = _differences(whole, found, same_pixels=not arm)
                problems += [f"{'arm' if arm else 'tripod'}, dataset {number}, after {killed} kills: {problem}" for problem in new]
                made, done = made + 1, done + killed
                say(f"{'arm' if arm else 'tripod'}: {killed} kills, {len(found.frames)} frames, {len(new)} differences")
    return KillRuns(kills=done, datasets=made, problems=tuple(problems))


def _scene() -> Scene:
    scene = files.load_scene("printed_8ml")
    return replace(
        scene, camera=scene.camera.resized(IMAGE_WH), plan=CapturePlan(rings=(Ring(views=VIEWS),)), disturbances=files.load_profile("bench")
    )


def _remove_pauses(rig: RigFile) -> RigFile:
    """Remove the pauses, which take real time."""
    arm = None if rig.arm is None else replace(rig.arm, settle_s=0.05)
    return replace(rig, turntable=replace(rig.turntable, settle_s=0.02), lights=replace(rig.lights, settle_s=0.05), arm=arm)


def _scan_with_kills(folder: Path, *, arm: bool, kills: int, seed: int) -> tuple[Dataset, int]:
    """Scan a new twin to the end with kills; return the dataset and the number of kills."""
    (folder / "ports").mkdir(parents=True)
    rig = default_rig("lx") if arm else replace(default_rig("lx"), arm=None)
    twin = Twin(_scene(), seed=0, profile_name="bench", pictures="sketch", rig=rig)
    server = TwinServer(twin, folder / "ports", speed=SPEED)
    server.start()
    try:
        atomic.write_text(folder / "rig.toml", rig_text(_remove_pauses(server.rig)))
        files.save_scene(twin.calibrated_scene(), folder / "scene.toml")
        words = [sys.executable, "-m", "rhizotwin", "scan", "--rig", str(folder / "rig.toml"), "--scene", str(folder / "scene.toml")]
        words += ["-o", str(folder / "dataset")]
        moments = random.Random(seed)
        longest_s, killed = 6.0, 0
        while True:
            began = time.monotonic()
            resume = ["--resume"] if (folder / "dataset" / "dataset.json").is_file() else []
            with subprocess.Popen([*words, *resume], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
                try:
                    _, said = process.communicate(timeout=moments.uniform(0.5, longest_s) if killed < kills else MOST_S)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()
                    if killed >= kills:
                        raise
                    killed += 1
                    continue
            if process.returncode != 0:
                raise RuntimeError(f"the scan ended with code {process.returncode}: {said[-2000:]}")
            if killed >= kills or load_dataset(folder / "dataset").origin.get("complete"):
                return load_dataset(folder / "dataset"), killed
            longest_s = min(longest_s, time.monotonic() - began)
    finally:
        server.stop()


def _differences(whole: Dataset, found: Dataset, *, same_pixels: bool) -> list[str]:
    """Return the differences between a resumed dataset and an uninterrupted one."""
    problems = []
    if [_stable(frame) for frame in whole.frames] != [_stable(frame) for frame in found.frames]:
        problems.append("its frames differ")
    if not found.origin.get("complete"):
        problems.append("it is not marked as complete")
    if whole.scene != found.scene:
        problems.append("its scene differs")
    for one, other in zip(whole.frames, found.frames, strict=False):
        path = found.folder / other.file
        if not path.is_file() or file_sha256(path) != other.sha256:
            problems.append(f"{other.file} is not the recorded picture")
        elif same_pixels and (read_image(whole, one) != read_image(found, other)).any():
            problems.append(f"{other.file} has other contents")
    files_there = sorted(path.name for path in (found.folder / "images").iterdir())
    if files_there != [Path(frame.file).name for frame in found.frames]:
        problems.append(f"its folder contains {files_there}")
    return problems


def _stable(frame: Frame) -> tuple[object, ...]:
    """Return the part of a frame that must not depend on interruptions."""
    return frame.file, frame.kind, frame.ring, frame.table_deg, frame.table_read_deg, frame.exposure_s, frame.gain
