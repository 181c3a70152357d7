"""Scans of an emulated rig with faults, which must complete, or stop with the cause stated and be resumable.

A run scans a small plan with one or two random faults at random times. If it stops, the faults are removed, as a user
would do, and the scan is resumed. The true views of the twin's camera are then compared with the dataset.
"""

import itertools
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType

import numpy as np

from rhizotwin.rig.errors import RigError
from rhizotwin.rig.open import open_devices
from rhizotwin.rig.scanning.observers import Observers
from rhizotwin.rig.scanning.scan import scan
from rhizotwin.rig.scanning.session import Origin
from rhizotwin.rig.twin.faults import KIND_NAMES, draw_faults, fault_kind
from rhizotwin.rig.twin.twin import Twin, default_rig
from rhizotwin.scenes import plan
from rhizotwin.scenes.dataset import Dataset, file_sha256, load_dataset, read_image
from rhizotwin.scenes.files import load_profile, load_scene
from rhizotwin.scenes.model import CapturePlan, Ring, Scene

IMAGE_WH = (400, 300)
RINGS = (Ring(views=4), Ring(views=2, height_mm=-60.0, first_deg=30.0))
MOST_WALL_S = 120.0
MOST_VIRTUAL_S = 3600.0
SAME_STAND_DEG = 0.35
"""Maximum deviation of the differences of angles in one placement: micro-steps, backlash, and the zero from markers."""
ZERO_DEG = 3.0
"""Maximum error of the zero: the true position of the arm."""
DEVICES = ("turntable", "lights", "arm", "camera", "markers", "board")
"""Names of devices; the message of a stop must contain one of them."""


@dataclass(frozen=True, kw_only=True)
class FaultRun:
    """Result of one scan with faults."""

    seed: int
    kinds: tuple[str, ...]
    ended: str
    """Outcome: complete, or stopped."""
    stop: str = ""
    """Message with which it stopped."""
    problems: tuple[str, ...] = ()
    """Violated requirements; empty for a correct run."""
    virtual_s: float = 0.0
    wall_s: float = 0.0


class _HangError(Exception):
    """A run exceeded the maximum time of a scan."""


def small_scene() -> Scene:
    """Return the scene of the runs: bench errors, two rings, small pictures."""
    scene = load_scene("printed_8ml")
    return replace(scene, camera=scene.camera.resized(IMAGE_WH), plan=CapturePlan(rings=RINGS), disturbances=load_profile("bench"))


def draws(count: int) -> list[tuple[int, tuple[str, ...]]]:
    """Return seeds with the faults of each run: every single kind, every pair, and again from the start."""
    singles = [(kind,) for kind in KIND_NAMES]
    pairs = list(itertools.combinations_with_replacement(KIND_NAMES, 2))
    every = itertools.cycle([*singles, *pairs])
    return [(seed, next(every)) for seed in range(count)]


def run_all(count: int, *, say: Callable[[str], None], workers: int = 2) -> list[FaultRun]:
    """Execute runs in several processes; report problems, and the progress every hundred runs.

    Parameters
    ----------
    count : int
        Number of runs.
    say : callable
        Receives problems and progress.
    workers : int
        Number of processes.

    Returns
    -------
    list of FaultRun
        Result of each run.
    """
    found: list[FaultRun] = []
    with ProcessPoolExecutor(max_workers=workers) as pool:
        for run in pool.map(run_one, *zip(*draws(count), strict=True), chunksize=5):
            found.append(run)
            for problem in run.problems:
                say(f"seed {run.seed}, {' and '.join(run.kinds)}: {problem}")
            if len(found) % 100 == 0:
                say(f"{len(found)} of {count} runs: {dict(Counter(run.ended for run in found))}")
    return found


def run_one(seed: int, kinds: Sequence[str]) -> FaultRun:
    """Scan with faults, resume a stopped scan, and compare the dataset with the true views."""
    rng = np.random.default_rng([seed, 77])
    faults = draw_faults(rng, tuple(kinds), messages=120, duration_s=60.0, shots=12)
    protocol = fault_kind(kinds[0]).protocol or fault_kind(kinds[-1]).protocol or ("lx", "lsc")[seed % 2]
    twin = Twin(small_scene(), seed=seed, profile_name="bench", faults=faults, pictures="sketch", rig=default_rig(protocol))
    began = time.monotonic()
    before = signal.signal(signal.SIGALRM, _raise_hang)
    signal.alarm(int(MOST_WALL_S))
    try:
        with tempfile.TemporaryDirectory(prefix="rhizotwin-faults-") as working:
            ended, stop, problems = _run(twin, Path(working) / "dataset")
    except _HangError:
        ended, stop, problems = "hanging", "", ["hangs"]
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    if twin.clock.now_s() > MOST_VIRTUAL_S:
        problems.append(f"took {twin.clock.now_s():.0f} s of the rig's time")
    return FaultRun(
        seed=seed,
        kinds=tuple(kinds),
        ended=ended,
        stop=stop,
        problems=tuple(problems),
        virtual_s=twin.clock.now_s(),
        wall_s=time.monotonic() - began,
    )


def _raise_hang(_: int, __: FrameType | None) -> None:
    raise _HangError


def _run(twin: Twin, folder: Path) -> tuple[str, str, list[str]]:
    problems: list[str] = []
    ended, stop = "complete", ""
    kept: dict[str, str] = {}
    try:
        dataset = run_scan(twin, folder)
    except RigError as error:
        ended, stop = "stopped", str(error)
        if not any(name in stop for name in DEVICES):
            problems.append(f"the cause is not stated: {stop}")
        if (folder / "dataset.json").is_file():
            kept = {frame.file: frame.sha256 for frame in load_dataset(folder).frames}
        shots = len(twin.record.shots)
        twin.repair()
        try:
            dataset = run_scan(twin, folder, resume=True)
        except Exception as error:  # noqa: BLE001 - any error is a result
            return ended, stop, [*problems, f"cannot be resumed: {type(error).__name__}: {error}"]
        if len(dataset.frames) - len(kept) > len(twin.record.shots) - shots:
            problems.append("more new frames than new pictures")
    except Exception as error:  # noqa: BLE001 - any error is a result
        return "crashed", str(error), [f"crashed: {type(error).__name__}: {error}"]
    problems += _find_errors(twin, dataset, kept)
    twin.clock.sleep(1.0)  # lamps fade
    if twin.world.panel.level > 0.0 or twin.world.front.level > 0.0:
        problems.append("the lights are still on")
    return ended, stop, problems


def run_scan(twin: Twin, folder: Path, *, resume: bool = False) -> Dataset:
    """Scan an emulated rig.

    Parameters
    ----------
    twin : Twin
        The emulated rig, with its scene.
    folder : Path
        Folder of the dataset to write.
    resume : bool
        Whether to resume a stopped scan.

    Returns
    -------
    Dataset
        Dataset of the scan.
    """
    scene = twin.calibrated_scene()
    devices = open_devices(twin.rig, scene, clock=twin.clock, camera=twin.open_camera())
    try:
        return scan(devices, scene, folder, resume=resume, origin=Origin(seed=twin.seed), observers=Observers(say=lambda _: None))
    finally:
        devices.close()


def _find_errors(twin: Twin, dataset: Dataset, kept: dict[str, str]) -> list[str]:
    """Return the errors of a finished dataset."""
    problems = []
    planned = plan.views(dataset.scene)
    if [frame.table_deg for frame in dataset.frames] != [view.table_deg for view in planned]:
        problems.append("the frames are not those of the plan")
    if not dataset.origin.get("complete"):
        problems.append("not marked as complete")
    found = {frame.file: frame.sha256 for frame in dataset.frames}
    problems += [f"{file} was taken twice" for file, sha256 in kept.items() if found.get(file) not in (None, sha256)]
    off: dict[tuple[int, int], list[float]] = {}
    seen = set()
    for frame in dataset.frames:
        if file_sha256(dataset.folder / frame.file) != frame.sha256:
            problems.append(f"{frame.file} is not the recorded picture")
            continue
        shot = twin.record.shot_of(read_image(dataset, frame))
        if shot is None:
            problems.append(f"{frame.file} is not a picture of this twin")
            continue
        if id(shot) in seen:
            problems.append(f"{frame.file} is the picture of another view")
        seen.add(id(shot))
        if frame.table_read_deg is None or abs(frame.table_read_deg - (frame.table_deg or 0.0)) > twin.rig.turntable.tolerance_deg:
            problems.append(f"{frame.file}: read {frame.table_read_deg}, commanded {frame.table_deg}")
            continue
        off.setdefault(frame.station, []).append((shot.sight.table_deg - frame.table_read_deg + 180.0) % 360.0 - 180.0)
    for station, degrees in off.items():
        if np.ptp(degrees) > SAME_STAND_DEG:
            problems.append(f"wrong angles: ring and placement {station} differ from the true ones by {np.round(degrees, 2).tolist()}")
        if np.abs(degrees).max() > ZERO_DEG:
            problems.append(f"wrong zero: ring and placement {station} are {np.round(degrees, 2).tolist()} off")
    return problems
