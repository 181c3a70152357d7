"""`rhizotwin scan`."""

from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from rhizotwin import rigs, steps
from rhizotwin.arguments import Flag, OutputDataset, Progress, SceneName, SubjectOptions, between, named, option
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene

if TYPE_CHECKING:
    from collections.abc import Callable

    from rhizotwin.catalogue.store import Catalogue
    from rhizotwin.rig.open import Devices
    from rhizotwin.scenes.dataset import Dataset
    from rhizotwin.scenes.pictures import Grey

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
    catalogue: Annotated[Path | None, named("CATALOGUE")] = None
    """Read from the numbers of the strip which plant is on the table; its name, species, treatment and day come from \
this catalogue, and the scan is added to it. With --plant, another plant on the table is an error."""
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
    rhizotwin scan --rig my_rig.toml --scene my_scene.toml -o my_scan --catalogue my.rhizotwin
    rhizotwin scan --rig my_rig.toml --scene my_scene.toml -o my_scan --resume
    rhizotwin scan --rig my_rig.toml --scene my_scene.toml --plan two_rings.toml -o my_scan --record my_scan.jsonl
    """
    emulated = twin if rig == rigs.TWIN else None
    if emulated is None and scene is None:
        raise UserError("--scene is missing: give the scene file of this rig, with its canister, strip, calibrated camera and plan")
    bench = rigs.open_bench(rig, scene, errors=twin, plan=options.plan)
    made = _scan(bench, output, subject, options=options, twin=emulated, progress=progress)
    print(f"{len(made.frames)} pictures in {output / 'images'}")
    if emulated is None or emulated.fidelity == "render":
        print(f"next: rhizotwin reconstruct {output} -o my_result")


def _scan(
    bench: rigs.Bench, output: Path, subject: SubjectOptions, *, options: ScanOptions, twin: rigs.TwinPictures | None, progress: Progress
) -> "Dataset":
    """Open the devices, identify the plant if there is a catalogue, and scan."""
    with ExitStack() as stack:
        devices = bench.open_devices(rigs.recorder(options.record, stack), stack)
        if options.catalogue is None:
            scene = subject.told(bench.scene)
            steps.print_marker_warnings(scene)
            return _take(bench, devices, scene, output, options=options, twin=twin, progress=progress, identify=None)
        from rhizotwin.catalogue.adding import add_scan
        from rhizotwin.catalogue.store import Catalogue

        known = stack.enter_context(Catalogue.open(options.catalogue))
        scene, identify = _identified(known, bench, devices, subject)
        steps.print_marker_warnings(scene)
        made = _take(bench, devices, scene, output, options=options, twin=twin, progress=progress, identify=identify)
        add_scan(known, output)
        return made


def _take(
    bench: rigs.Bench,
    devices: "Devices",
    scene: Scene,
    output: Path,
    *,
    options: ScanOptions,
    twin: rigs.TwinPictures | None,
    progress: Progress,
    identify: "Callable[[Grey], object] | None",
) -> "Dataset":
    """Scan, with a bar."""
    from rhizotwin.rig.scanning.audience import Audience

    with progress.bar(devices=1.0, pictures=20.0) as bar:
        audience = Audience(ask=rigs.asker(), say=bar.say, monitor=bar)
        return rigs.take_scan(
            bench,
            devices,
            scene,
            output,
            audience=audience if identify is None else replace(audience, identify=identify),
            twin=twin,
            resume=options.resume,
            table_angle_deg=options.table_angle_deg,
        )


def _identified(
    known: "Catalogue", bench: rigs.Bench, devices: "Devices", subject: SubjectOptions
) -> "tuple[Scene, Callable[[Grey], object]]":
    """Return the scene of the plant on the table, and the check of the scan's first picture.

    A scan that is resumed keeps the date and day at which it was begun; they must be given again.
    """
    from rhizotwin.catalogue import identity
    from rhizotwin.rig.scanning.audience import Audience
    from rhizotwin.rig.scanning.first_look import take_first_look

    plants, strip = known.plants(), bench.scene.strip
    if subject.plant is None:
        image = take_first_look(devices, bench.scene, Audience(ask=rigs.asker()))
        plant = identity.identify(image, plants, strip)
    else:
        plant = known.plant(subject.plant)
    if plant.tag is None:
        raise UserError(f"{known.path}: the strip of plant {plant.name} is not known; add it with `rhizotwin catalogue plant`")
    own = replace(strip, dictionary=plant.tag.dictionary, first_id=plant.tag.first_id)
    today = date.fromisoformat(subject.date) if subject.date else date.today()  # noqa: DTZ011 - the laboratory's calendar
    day = float((today - date.fromisoformat(plant.sown)).days) if plant.sown and subject.day is None else subject.day
    whose = replace(bench.scene.subject, plant=plant.name, species=plant.species, treatment=plant.treatment, replicate=plant.replicate)
    scene = replace(bench.scene, strip=own, subject=replace(whose, day=day, date=today.isoformat()))
    if plant.solution.known:
        scene = replace(scene, solution=plant.solution)
    print(f"plant: {scene.subject}")
    return subject.told(scene), identity.check_plant(plant, plants, strip)
