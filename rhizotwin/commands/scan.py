"""`rhizotwin scan`."""

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from rhizotwin import rigs, steps
from rhizotwin.arguments import Flag, OutputDataset, Progress, SceneName, SubjectOptions, between, named, option
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene

if TYPE_CHECKING:
    from rhizotwin.scenes.dataset import Dataset

ANGLE_LIMITS_DEG = (-360.0, 360.0)


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


def scan(
    *,
    rig: rigs.RigName,
    output: OutputDataset,
    scene: SceneName | None = None,
    options: ScanOptions = ScanOptions(),
    twin: rigs.TwinPictures = rigs.TwinPictures(),
    subject: SubjectOptions = SubjectOptions(),
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
    progress : Progress
        How much is told meanwhile.

    Examples
    --------
    rhizotwin scan --rig twin -o my_scan --fidelity sketch
    rhizotwin scan --rig twin --scene radish_day15a --profile bench --seed 3 -o my_scan
    rhizotwin scan --rig my_rig.toml --scene my_scene.toml -o my_scan --plant P7 --treatment "low N" --day 15
    rhizotwin scan --rig my_rig.toml --scene my_scene.toml -o my_scan --resume
    rhizotwin scan --rig my_rig.toml --scene my_scene.toml --plan two_rings.toml -o my_scan --record my_scan.jsonl
    """
    emulated = twin if rig == rigs.TWIN else None
    if emulated is None and scene is None:
        raise UserError("--scene is missing: give the scene file of this rig, with its canister, strip, calibrated camera and plan")
    bench = rigs.open_bench(rig, scene, errors=twin, plan=options.plan)
    told = subject.told(bench.scene)
    steps.print_marker_warnings(told)
    made = _take(bench, told, output, options=options, twin=emulated, progress=progress)
    print(f"{len(made.frames)} pictures in {output / 'images'}")
    if emulated is None or emulated.fidelity == "render":
        print(f"next: rhizotwin reconstruct {output} -o my_result")


def _take(
    bench: rigs.Bench, scene: Scene, output: Path, *, options: ScanOptions, twin: rigs.TwinPictures | None, progress: Progress
) -> "Dataset":
    """Open the devices and scan, with a bar."""
    from rhizotwin.rig.scanning.audience import Audience

    with ExitStack() as stack:
        devices = bench.open_devices(rigs.recorder(options.record, stack), stack)
        bar = stack.enter_context(progress.bar(devices=1.0, pictures=20.0))
        return rigs.take_scan(
            bench,
            devices,
            scene,
            output,
            audience=Audience(ask=rigs.asker(), say=bar.say, monitor=bar),
            twin=twin,
            resume=options.resume,
            table_angle_deg=options.table_angle_deg,
        )
