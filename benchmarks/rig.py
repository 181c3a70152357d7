"""Benchmarks of the rig: recovery from faults, kinematics, overhead of scans, lens, and a whole scan."""

import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import rig_faults
from benchmarks.metric import Metric
from benchmarks.run import Run, Say
from rhizotwin.recon.reconstruct import reconstruct
from rhizotwin.rig.arm import inverse, kinematics
from rhizotwin.rig.clock import SystemClock
from rhizotwin.rig.lens import calibration
from rhizotwin.rig.open import open_devices
from rhizotwin.rig.rig_file import ArmPart
from rhizotwin.rig.scanning.observers import Observers
from rhizotwin.rig.scanning.scan import scan
from rhizotwin.rig.twin.camera import READOUT_S
from rhizotwin.rig.twin.server import TwinServer
from rhizotwin.rig.twin.stepper import ACCELERATION_DEG_PER_S2
from rhizotwin.rig.twin.twin import Twin
from rhizotwin.scenes import files
from rhizotwin.scenes.board import CharucoBoard
from rhizotwin.scenes.model import CapturePlan, Ring
from rhizotwin.scoring.score import score
from rhizotwin.sim.board import simulate_board

TARGETS_START_DEG = (0.0, 30.0, 30.0, 30.0, 0.0)
"""Initial pose of Newton's method for all targets."""
MOST_STEPS = 20
BOARD_PICTURES = 20


def measure(*, quick: bool, say: Say) -> Run:
    """Measure the parts of the rig in order; a failed one is recorded, and the rest continue."""
    run = Run()
    parts: dict[str, Callable[[], list[Metric]]] = {
        "inverse": lambda: _inverse(1000 if quick else 10_000),
        "faults": lambda: _faults(24 if quick else 1000, run, say),
        "overhead": _overhead,
        "calibrate": lambda: _calibrate(("bench",) if quick else ("clean", "bench")),
    }
    if not quick:
        parts["scan"] = _scan_and_reconstruct
    for name, part in parts.items():
        began = time.perf_counter()
        try:
            found = part()
        except Exception:  # noqa: BLE001 - any error must be reported to the gate
            run.crashed[name] = traceback.format_exc()
            say(f"{name}: CRASHED\n{run.crashed[name]}")
            continue
        run.metrics += found
        say(
            f"{name} ({time.perf_counter() - began:.0f} s): " + ", ".join(f"{m.key.split('/', 1)[1]} {m.value:.4g} {m.unit}" for m in found)
        )
    return run


def _inverse(count: int) -> list[Metric]:
    """Compute random poses of the arm in closed form and by Newton's method, and evaluate the results."""
    part = ArmPart()
    rng = np.random.default_rng(0)
    low, high = ([getattr(joint, name) for joint in part.joints] for name in ("min_deg", "max_deg"))
    joints_deg = rng.uniform(low, high, (count, len(part.joints)))
    goals = kinematics.arm_from_cam(part, joints_deg)
    branches = inverse.inverse(part, goals).joints_rad
    reached = kinematics.arm_from_cam(part, np.rad2deg(branches))
    off = np.nanmin(np.abs(reached - goals[:, None]).max(axis=(2, 3)), axis=1)
    found = inverse.newton(part, goals, np.deg2rad(np.broadcast_to(TARGETS_START_DEG, joints_deg.shape)))
    landed = np.abs(kinematics.arm_from_cam(part, np.rad2deg(found.joints_rad)) - goals).max(axis=(1, 2)) < 1e-6
    failed = ~(found.converged & (found.steps <= MOST_STEPS) & landed)
    return [
        Metric(key="rig/inverse/closed_form_error", value=float(off.max()), unit="mm", direction="down"),
        Metric(key="rig/inverse/newton_failed", value=float(failed.mean()), unit="1", direction="down"),
        Metric(key="rig/inverse/newton_steps", value=float(np.median(found.steps)), unit="1", direction="down"),
    ]


def _faults(count: int, run: Run, say: Say) -> list[Metric]:
    runs = rig_faults.run_all(count, say=say)
    run.details["faults"] = [asdict(one) for one in runs]
    ended = Counter(one.ended for one in runs)
    return [
        Metric(key="rig/faults/problems", value=float(sum(bool(one.problems) for one in runs)), unit="1", direction="down"),
        Metric(key="rig/faults/runs", value=float(len(runs)), unit="1", direction="up"),
        Metric(key="rig/faults/complete_at_once", value=ended["complete"] / len(runs), unit="1", direction="up"),
        Metric(key="rig/faults/longest", value=max(one.virtual_s for one in runs), unit="s", direction="down"),
    ]


def _overhead() -> list[Metric]:
    """Scan a twin in real time, and subtract motion, pause and exposure from the time between two pictures."""
    views = 9
    scene = files.load_scene("printed_8ml")
    scene = replace(scene, plan=CapturePlan(rings=(Ring(views=views),)), disturbances=files.load_profile("bench"))
    twin = Twin(scene, seed=0, profile_name="bench", pictures="sketch")
    with tempfile.TemporaryDirectory(prefix="rhizotwin-rig-") as working:
        (Path(working) / "ports").mkdir()
        server = TwinServer(twin, Path(working) / "ports")
        server.start()
        try:
            clock = SystemClock()
            rig = replace(server.rig, name="twin")
            devices = open_devices(rig, twin.calibrated_scene(), clock=clock)
            try:
                dataset = scan(devices, twin.calibrated_scene(), Path(working) / "dataset", observers=Observers(say=lambda _: None))
            finally:
                devices.close()
        finally:
            server.stop()
    times = [frame.time_s for frame in dataset.frames if frame.time_s is not None]
    part, step_deg = rig.turntable, 360.0 / views
    motion_s = step_deg / part.speed_deg_per_s + part.speed_deg_per_s / ACCELERATION_DEG_PER_S2
    exposed_s = rig.camera.exposure_s + READOUT_S  # the rows of a sensor are read out one after the other
    rest_s = np.diff(times) - motion_s - part.settle_s - exposed_s
    return [Metric(key="rig/overhead/per_view", value=float(np.median(rest_s)), unit="s", direction="down")]


def _calibrate(profiles: tuple[str, ...]) -> list[Metric]:
    metrics = []
    for profile in profiles:
        scene = replace(files.load_scene("printed_8ml"), disturbances=files.load_profile(profile))
        with tempfile.TemporaryDirectory(prefix="rhizotwin-rig-") as working:
            folder = Path(working) / "pictures"
            simulate_board(scene, CharucoBoard(), folder, pictures=BOARD_PICTURES, seed=0)
            found = calibration.calibrate(sorted(folder.glob("*.png")), CharucoBoard())
        true_px = scene.camera.focal_px
        error = max(abs(found.camera.focal_px[k] / true_px[k] - 1.0) for k in range(2))
        metrics += [
            Metric(key=f"rig/calibrate/{profile}/focal_error", value=error, unit="1", direction="down"),
            Metric(key=f"rig/calibrate/{profile}/rms", value=found.fit.rms_px, unit="px", direction="down"),
        ]
    return metrics


def _scan_and_reconstruct() -> list[Metric]:
    """Scan the printed root on the twin as in a laboratory, and reconstruct it."""
    scene = replace(files.load_scene("printed_8ml"), disturbances=files.load_profile("bench"))
    twin = Twin(scene, seed=0, profile_name="bench", pictures="render")
    with tempfile.TemporaryDirectory(prefix="rhizotwin-rig-") as working:
        folder, result = Path(working) / "dataset", Path(working) / "result"
        dataset = rig_faults.run_scan(twin, folder)
        result.mkdir()
        reconstruct(folder).save(result)
        twin.write_truth(folder, dataset.frames)
        found: dict[str, Any] = score(result, folder).to_dict()
    return [
        Metric(key="rig/scan/volume_error", value=found["volume_error"], unit="1", direction="zero"),
        Metric(key="rig/scan/iou", value=found["iou"], unit="1", direction="up"),
    ]
