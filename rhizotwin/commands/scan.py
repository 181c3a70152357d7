"""`rhizotwin scan`."""

import hashlib
import json
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from rhizotwin import command_steps, rigs
from rhizotwin.arguments import Flag, OutputDataset, Page, Progress, SceneName, SubjectOptions, between, named, option
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.schema import to_plain

if TYPE_CHECKING:
    from rhizotwin.rig.scanning.observer import Observer
    from rhizotwin.scenes.dataset import Dataset

ANGLE_LIMITS_DEG = (-360.0, 360.0)
SHOTS_FILE = "truth/shots.jsonl"
"""What the twin's pictures truly show, kept so that the truth of a scan that was stopped can be written."""


def read_angle_deg(text: str) -> float:
    """Read an angle."""
    return between(text, ANGLE_LIMITS_DEG, "deg")


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ScanOptions:
    """How the scan goes."""

    plan: Annotated[str | None, named("PLAN")] = None
    """Take the rings from here instead of the scene: a file with [[plan.rings]], or a scene's name."""
    resume: Flag = False
    """Finish a stopped scan: what it took is kept and not taken again."""
    table_angle_deg: Annotated[float | None, option(read_angle_deg, "DEG", name="--table-angle")] = None
    """The table's angle now, if the markers cannot be read at the start; 0: the strip's seam faces the camera."""
    record: Annotated[Path | None, named("FILE")] = None
    """Append every byte on the wire to this file (JSON lines)."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Watching(Page):
    """The live page."""

    watch: Flag = False
    """Serve a live page: last picture with its markers, focus, exposure, evenness of the panel and motion with their \
limits, the ring and a sketch of the roots so far, time left; pause, go on, stop."""


def scan(
    *,
    rig: rigs.RigName,
    output: OutputDataset,
    scene: SceneName | None = None,
    options: ScanOptions = ScanOptions(),
    twin: rigs.TwinPictures = rigs.TwinPictures(),
    subject: SubjectOptions = SubjectOptions(),
    watching: Watching = Watching(),
    progress: Progress = Progress(),
) -> None:
    """Take the pictures of a plan on a rig, or on its emulated twin.

    Look at every device, bring the camera to the rings of the plan, turn the table and take the pictures. Stopped
    half-way (Ctrl-C, a fault, a power cut), the same command with --resume takes what is missing. Whatever ends it, the
    lights go off and the arm is parked and let go.

    Parameters
    ----------
    rig : str
        Rig file (TOML; 'rhizotwin rig example' writes one), or the word twin: emulated devices in this program.
    output : Path
        Folder to make the dataset in: new or empty; with --resume one that a stopped scan left.
    scene : str, optional
        A scene file, or a name from 'rhizotwin scenes': canister, strip, calibrated lens and plan; needed for a rig
        file; the twin's default: printed_8ml.
    options : ScanOptions
        How the scan goes.
    twin : TwinPictures
        What the emulated rig gets wrong, and how its pictures are made.
    subject : SubjectOptions
        Whose roots they are.
    watching : Watching
        The live page.
    progress : Progress
        How much is told meanwhile.

    Examples
    --------
    rhizotwin scan --rig twin -o my_scan --fidelity sketch
    rhizotwin scan --rig twin --scene radish_day15a --profile bench --seed 3 -o my_scan --watch
    rhizotwin scan --rig my_rig.toml --scene my_scene.toml -o my_scan --plant P7 --treatment "low N" --day 15
    rhizotwin scan --rig my_rig.toml --scene my_scene.toml -o my_scan --resume
    rhizotwin scan --rig my_rig.toml --scene my_scene.toml --plan two_rings.toml -o my_scan --record my_scan.jsonl
    """
    emulated = twin if rig == rigs.TWIN else None
    if emulated is None and scene is None:
        raise UserError("--scene is missing: give the scene file of this rig, with its canister, strip, calibrated camera and plan")
    bench = rigs.open_bench(rig, scene, errors=twin, plan=options.plan)
    told = subject.told(bench.scene)
    command_steps.print_marker_warnings(told)
    made = _take(bench, told, output, options=options, twin=emulated, watching=watching, progress=progress)
    print(f"{len(made.frames)} pictures in {output / 'images'}")
    if emulated is None or emulated.fidelity == "render":
        print(f"next: rhizotwin reconstruct {output} -o my_result")


def _take(
    bench: rigs.Bench,
    scene: Scene,
    output: Path,
    *,
    options: ScanOptions,
    twin: rigs.TwinPictures | None,
    watching: Watching,
    progress: Progress,
) -> "Dataset":
    """Take the pictures, and write their truth where the twin renders them."""
    from rhizotwin.rig.scanning.observers import Observers
    from rhizotwin.rig.scanning.scan import scan as take

    # what the twin's pictures show, for the truth: a scan that is killed and taken up needs it of the pictures before,
    # too
    rendered = twin is not None and twin.fidelity == "render"
    with ExitStack() as stack:
        observer = _observer(bench.scene, watching, stack)
        devices = bench.open_devices(rigs.recorder(options.record, stack), stack)
        bar = stack.enter_context(progress.bar(devices=1.0, pictures=20.0))
        made = take(
            devices,
            scene,
            output,
            resume=options.resume,
            settings={"twin": None if twin is None else _pictures(twin, bench.twin.scene)},
            seed=None if twin is None else twin.seed,
            table_angle_deg=options.table_angle_deg,
            observers=Observers(
                ask=rigs.asker(),
                say=bar.say,
                observer=observer,
                monitor=bar,
                begun=(lambda: bench.twin.record.keep_in(output / SHOTS_FILE)) if rendered else (lambda: None),
            ),
        )
    if rendered:
        bench.twin.write_truth(output, made.frames)
        bench.twin.record.end()
    return made


def _observer(scene: Scene, watching: Watching, stack: ExitStack) -> "Observer":
    """Return who looks on: the live page, where it is asked for."""
    if not watching.watch:
        from rhizotwin.rig.scanning.observer import Observer

        return Observer()
    from rhizotwin.viewer import live_page
    from rhizotwin.viewer.live import Live

    live = Live(scene)
    served = live_page.serve(live, host=watching.host, port=watching.port)
    stack.callback(served.stop)
    stack.callback(live.close)
    command_steps.open_page(served.address, served.port, watching)
    return live


def _pictures(twin: rigs.TwinPictures, scene: Scene) -> dict[str, str]:
    """Return what the twin's pictures are made of."""
    digest = hashlib.sha256(json.dumps(to_plain(scene), sort_keys=True).encode()).hexdigest()
    return {"profile": twin.profile, "fidelity": twin.fidelity, "scene_sha256": digest}
