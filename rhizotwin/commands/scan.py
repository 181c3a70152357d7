"""`rhizotwin scan`."""

import hashlib
import json
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

from rhizotwin import rigs
from rhizotwin.arguments import Flag, OutputDataset, SceneName, SubjectOptions, between, named, option
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.schema import to_plain

ANGLE_LIMITS_DEG = (-360.0, 360.0)
SHOTS_FILE = "truth/shots.jsonl"
"""What the twin's pictures truly show, kept so that the truth of a scan that was stopped can be written."""


def read_angle_deg(text: str) -> float:
    """Read an angle."""
    return between(text, ANGLE_LIMITS_DEG, "deg")


def scan(
    *,
    rig: rigs.RigName,
    output: OutputDataset,
    scene: SceneName | None = None,
    plan: Annotated[str | None, named("PLAN")] = None,
    resume: Flag = False,
    table_angle_deg: Annotated[float | None, option(read_angle_deg, "DEG", name="--table-angle")] = None,
    record: Annotated[Path | None, named("FILE")] = None,
    twin: rigs.TwinPictures = rigs.TwinPictures(),
    subject: SubjectOptions = SubjectOptions(),
) -> None:
    """Take the pictures of a plan on a rig, or on its emulated twin.

    Look at every device, bring the camera to the rings of the plan, turn the table and take the pictures. Stopped half-way (Ctrl-C, a
    fault, a power cut), the same command with --resume takes what is missing. Whatever ends it, the lights go off and the arm is parked
    and let go.

    Parameters
    ----------
    rig : str
        Rig file (TOML; 'rhizotwin rig example' writes one), or the word twin: emulated devices in this program.
    output : Path
        Folder to make the dataset in: new or empty; with --resume one that a stopped scan left.
    scene : str, optional
        A scene file, or a name from 'rhizotwin scenes': canister, strip, calibrated lens and plan; needed for a rig file; the twin's
        default: printed_8ml.
    plan : str, optional
        Take the rings from here instead of the scene: a file with [[plan.rings]], or a scene's name.
    resume : bool
        Finish a stopped scan: what it took is kept and not taken again.
    table_angle_deg : float, optional
        The table's angle now, if the markers cannot be read at the start; 0: the strip's seam faces the camera.
    record : Path, optional
        Keep every byte on the wire in this file (JSON lines); it grows.
    twin : TwinPictures
        What the emulated rig gets wrong, and how its pictures are made.
    subject : SubjectOptions
        Whose roots they are.

    Examples
    --------
    rhizotwin scan --rig twin -o my_scan --fidelity sketch
    rhizotwin scan --rig twin --scene radish_day15a --profile bench --seed 3 -o my_scan
    rhizotwin scan --rig my_rig.toml --scene my_scene.toml -o my_scan --plant P7 --treatment "low N" --day 15
    rhizotwin scan --rig my_rig.toml --scene my_scene.toml -o my_scan --resume
    rhizotwin scan --rig my_rig.toml --scene my_scene.toml --plan two_rings.toml -o my_scan --record my_scan.jsonl
    """
    from tqdm import tqdm

    from rhizotwin.rig.open import open_devices
    from rhizotwin.rig.scanning.scan import scan as take

    emulated = rig == rigs.TWIN
    if not emulated and scene is None:
        raise UserError("--scene is missing: give the scene file of this rig, with its canister, strip, calibrated camera and plan")
    bench = rigs.open_bench(rig, scene, errors=twin, plan=plan)
    told = subject.told(bench.scene)
    settings: dict[str, Any] = {"twin": None}
    if emulated:
        settings = {"twin": {"profile": twin.profile, "fidelity": twin.fidelity, "scene_sha256": _hash(bench.twin.scene)}}
    # what the twin's pictures show, for the truth: a scan that is killed and taken up needs it of the pictures before, too
    rendered = emulated and twin.fidelity == "render"
    with ExitStack() as stack:
        stack.enter_context(rigs.hang_up_stops())
        recorder = rigs.recorder(record, stack)
        devices = open_devices(bench.rig, bench.scene, clock=bench.clock, camera=bench.twin and bench.open_camera(), recorder=recorder)
        stack.callback(devices.close)
        made = take(
            devices,
            told,
            output,
            resume=resume,
            settings=settings,
            seed=twin.seed if emulated else None,
            table_angle_deg=table_angle_deg,
            ask=rigs.asker(),
            say=tqdm.write,
            begun=(lambda: bench.twin.record.keep_in(output / SHOTS_FILE)) if rendered else (lambda: None),
        )
    if rendered:
        bench.twin.write_truth(output, made.frames)
        bench.twin.record.end()
    print(f"{len(made.frames)} pictures in {output / 'images'}")
    if not emulated or rendered:
        print(f"next: rhizotwin reconstruct {output} -o my_result")


def _hash(scene: Scene) -> str:
    return hashlib.sha256(json.dumps(to_plain(scene), sort_keys=True).encode()).hexdigest()
