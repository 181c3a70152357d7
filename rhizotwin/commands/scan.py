"""Command `rhizotwin scan`."""

from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import count
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.subject import Subject
from rhizotwin.steps import command_steps, rigs
from rhizotwin.steps.arguments import Flag, OutputDataset, Progress, SceneName, SubjectOptions, option, read_number, with_metavar

if TYPE_CHECKING:
    from collections.abc import Callable

    from rhizotwin.catalogue.store import Catalogue
    from rhizotwin.rig.open import Devices
    from rhizotwin.scenes.dataset import Dataset
    from rhizotwin.scenes.picture_codec import Grey

ANGLE_LIMITS_DEG = (-360.0, 360.0)


def read_angle_deg(text: str) -> float:
    """Convert text to an angle in degrees."""
    return read_number(text, ANGLE_LIMITS_DEG, "deg")


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ScanOptions:
    """Options of the scan."""

    scene: SceneName | None = None
    """Scene, which describes canister, marker strip, calibrated camera and camera positions: a name listed by \
'rhizotwin scenes', or a scene file (TOML). Required with a rig file; default for the emulated rig: printed_8ml."""
    plan: Annotated[str | None, with_metavar("PLAN")] = None
    """Camera positions that replace those of the scene: a TOML file with [[plan.rings]], or the name of a scene."""
    resume: Flag = False
    """Continue an interrupted scan, and keep the pictures that were already taken."""
    table_angle_deg: Annotated[float | None, option(read_angle_deg, "DEG", name="--table-angle")] = None
    """Initial angle of the turntable in degrees; needed only if the markers cannot be detected. At 0 the joint \
between the ends of the marker strip faces the camera."""
    catalogue: Annotated[Path | None, with_metavar("CATALOGUE")] = None
    """Catalogue (.rhizotwin) from which the plant's name, species, treatment and age are read, and to which the scan \
is added. The plant is identified by the numbers of its markers; with --plant, a different plant on the turntable \
is an error."""
    record: Annotated[Path | None, with_metavar("FILE")] = None
    """File to which all serial communication is appended (JSON lines)."""


def scan(
    *,
    rig: rigs.RigName,
    output: OutputDataset,
    options: ScanOptions = ScanOptions(),
    twin: rigs.TwinPictures = rigs.TwinPictures(),
    subject: SubjectOptions = SubjectOptions(),
    progress: Progress = Progress(),
) -> None:
    """Scan a plant with the rig, or with the emulated rig.

    After a check of all devices, the camera is moved to each planned height, and pictures are taken all around the
    plant while the turntable rotates the canister. After an interruption (Ctrl-C, a fault, a power failure), run the
    same command with --resume to take the remaining pictures. On exit, even after an error, the lamps are switched off
    and the arm is parked and unpowered.

    Parameters
    ----------
    rig : str
        Rig file (TOML; 'rhizotwin rig example' writes an example), or twin for the emulated rig.
    output : Path
        Folder for the dataset: new or empty, or with --resume the folder of the interrupted scan.
    options : ScanOptions
        Options of the scan.
    twin : TwinPictures
        Options of the emulated rig.
    subject : SubjectOptions
        Plant in the canister.
    progress : Progress
        Progress output.

    Examples
    --------
    rhizotwin scan --rig twin -o my_scan --fidelity sketch
    rhizotwin scan --rig twin --scene radish_day15a --profile bench --seed 3 -o my_scan
    rhizotwin scan --rig my_rig.toml --scene my_scene.toml -o my_scan --plant P7 --treatment "low N" --day 15
    rhizotwin scan --rig my_rig.toml --scene my_scene.toml -o my_scan --catalogue my.rhizotwin
    rhizotwin scan --rig my_rig.toml --scene my_scene.toml -o my_scan --resume
    rhizotwin scan --rig my_rig.toml --scene my_scene.toml --plan two_rings.toml -o my_scan --record my_scan.jsonl
    """
    rigs.check_rig(rig)
    if rig != rigs.TWIN and options.scene is None:
        raise UserError(
            "--scene is missing; give the scene file of this rig, with canister, marker strip, calibrated camera and camera positions"
        )
    bench = rigs.open_bench(rig, options.scene, errors=twin, plan=options.plan)
    made = _scan(bench, output, subject, options=options, progress=progress)
    print(f"wrote {count(len(made.frames), 'picture')} to {output / 'images'}")
    if bench.pictures is None or bench.pictures.fidelity == "render":
        print(f"next: rhizotwin reconstruct {output} -o my_result")


def _scan(bench: rigs.Bench, output: Path, subject: SubjectOptions, *, options: ScanOptions, progress: Progress) -> "Dataset":
    """Open the devices and scan the plant.

    If a catalogue is given, the plant is identified first.
    """
    from rhizotwin.catalogue.adding import add_scan
    from rhizotwin.catalogue.store import Catalogue
    from rhizotwin.rig.scanning.observers import Observers

    with ExitStack() as stack:
        devices = bench.open_devices(rigs.recorder(options.record, stack), stack)
        observers = Observers(ask=rigs.asker(), table_angle_deg=options.table_angle_deg)
        known = None if options.catalogue is None else stack.enter_context(Catalogue.open(options.catalogue))
        if known is None:
            scene = subject.apply_to(bench.scene)
        else:
            scene, identify = _identified(known, bench, devices, subject)
            observers = replace(observers, identify=identify)
        command_steps.print_marker_warnings(scene)
        with progress.bar(devices=1.0, pictures=20.0) as bar:
            observers = replace(observers, say=bar.say, monitor=bar)
            made = rigs.take_scan(bench, devices, scene, output, observers=observers, resume=options.resume)
        if known is not None:
            add_scan(known, output)
        return made


def _identified(
    known: "Catalogue", bench: rigs.Bench, devices: "Devices", subject: SubjectOptions
) -> "tuple[Scene, Callable[[Grey], object]]":
    """Identify the plant on the turntable, and return its scene and a function that checks the first picture.

    The date and age of a resumed scan must be the same as at its start, and therefore must be given again.
    """
    from rhizotwin.catalogue import identity
    from rhizotwin.rig.scanning.first_look import take_first_look
    from rhizotwin.rig.scanning.observers import Observers

    plants = known.plants()
    strip = bench.scene.strip
    if subject.plant is None:
        image = take_first_look(devices, bench.scene, Observers(ask=rigs.asker()))
        plant = identity.identify(image, plants, strip)
    else:
        plant = known.plant(subject.plant)
    if plant.tag is None:
        raise UserError(f"{known.path}: the plant {plant.name} has no marker strip; add its canister with `rhizotwin catalogue plant`")
    when = datetime.now().astimezone().date().isoformat()
    named = Subject(plant=plant.name, date=when, notes=bench.scene.subject.notes)
    scene = rigs.scene_of_plant(subject.apply_to(replace(bench.scene, subject=named)), plant)
    print(f"plant: {scene.subject}")
    return replace(scene, solution=subject.solution or scene.solution), identity.check_plant(plant, plants, strip)
