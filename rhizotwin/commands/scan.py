"""`rhizotwin scan`."""

import hashlib
import json
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from rhizotwin import command_steps, rigs
from rhizotwin.arguments import Flag, OutputDataset, Page, Progress, SceneName, SubjectOptions, option, read_number, with_metavar
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.schema import to_plain

if TYPE_CHECKING:
    from rhizotwin.rig.scanning.observer import Observer
    from rhizotwin.scenes.dataset import Dataset

ANGLE_LIMITS_DEG = (-360.0, 360.0)
SHOTS_FILE = "truth/shots.jsonl"
"""True state of the emulated rig at each picture, stored so that the ground truth of a resumed scan is complete."""


def read_angle_deg(text: str) -> float:
    """Read an angle."""
    return read_number(text, ANGLE_LIMITS_DEG, "deg")


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ScanOptions:
    """Options of the scan."""

    plan: Annotated[str | None, with_metavar("PLAN")] = None
    """Capture plan to use instead of the scene's: a TOML file with [[plan.rings]], or the name of a scene."""
    resume: Flag = False
    """Continue an interrupted scan; pictures that were already taken are kept."""
    table_angle_deg: Annotated[float | None, option(read_angle_deg, "DEG", name="--table-angle")] = None
    """Current angle of the turntable, if the markers cannot be detected at the start; at 0 the seam of the marker \
strip faces the camera."""
    record: Annotated[Path | None, with_metavar("FILE")] = None
    """Append all serial communication to this file (JSON lines)."""


@Parameter(name="*", group="Web page")
@dataclass(frozen=True, kw_only=True)
class Watching(Page):
    """Live page of the scan."""

    watch: Flag = False
    """Serve a live page that shows the last picture with its markers, focus, exposure, panel uniformity and motion \
with their limits, a preview of the roots and the remaining time, and has buttons to pause and stop."""


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
    """Scan a plant: take the pictures of a capture plan on a rig, or on the emulated rig.

    Check every device, move the camera to each ring of the capture plan, rotate the turntable and take the pictures.
    After an interruption (Ctrl-C, a fault, a power failure), run the same command with --resume to take the remaining
    pictures. On exit, also after an error, the lamps are switched off and the arm is parked and unpowered.

    Parameters
    ----------
    rig : str
        Rig file (TOML; 'rhizotwin rig example' writes one), or twin for the emulated rig.
    output : Path
        Dataset folder to write: new or empty, or with --resume the folder of the interrupted scan.
    scene : str, optional
        Scene with canister, marker strip, calibrated camera and capture plan: a name listed by 'rhizotwin scenes' or a
        scene file (TOML). Required with a rig file; default for the emulated rig: printed_8ml.
    options : ScanOptions
        Options of the scan.
    twin : TwinPictures
        Errors of the emulated rig and quality of its pictures.
    subject : SubjectOptions
        Plant in the canister.
    watching : Watching
        Live page of the scan.
    progress : Progress
        Progress output.

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
        raise UserError(
            "--scene is missing; give the scene file of this rig, with canister, marker strip, calibrated camera and capture plan"
        )
    bench = rigs.open_bench(rig, scene, errors=twin, plan=options.plan)
    scene_of_plant = subject.apply_to(bench.scene)
    command_steps.print_marker_warnings(scene_of_plant)
    made = _take(bench, scene_of_plant, output, options=options, twin=emulated, watching=watching, progress=progress)
    print(f"wrote {len(made.frames)} pictures to {output / 'images'}")
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
    """Take the pictures, and write the ground truth if the emulated rig renders them."""
    from rhizotwin.rig.scanning.observers import Observers
    from rhizotwin.rig.scanning.scan import scan as take

    # the true state at each picture is stored on disk, so that the ground truth of a resumed scan is complete
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
    """Start the live page if requested."""
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
    """Return the settings of the emulated pictures, which must not change when a scan is resumed."""
    digest = hashlib.sha256(json.dumps(to_plain(scene), sort_keys=True).encode()).hexdigest()
    return {"profile": twin.profile, "fidelity": twin.fidelity, "scene_sha256": digest}
