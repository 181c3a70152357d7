"""Access to a real or emulated rig with its scene and devices, shared by several commands."""

import hashlib
import json
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from cyclopts import Parameter

from rhizotwin.scenes import files
from rhizotwin.scenes.checks import check_scene
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import CapturePlan, Scene
from rhizotwin.scenes.schema import Place, from_plain, suggestion, to_plain
from rhizotwin.steps import command_steps
from rhizotwin.steps.arguments import Device, Profile, Seed, with_metavar

if TYPE_CHECKING:
    from rhizotwin.catalogue.records import Plant
    from rhizotwin.rig.devices import Camera
    from rhizotwin.rig.open import Devices
    from rhizotwin.rig.rig_file import RigFile
    from rhizotwin.rig.scanning.observers import Observers
    from rhizotwin.rig.serial_line.recording import Recorder
    from rhizotwin.scenes.dataset import Dataset

TWIN = "twin"
TWIN_SCENE = "printed_8ml"
SHOTS_FILE = "truth/shots.jsonl"
"""File with the true state of the emulated rig at the time of each picture. The ground truth of a scan is computed from
it."""

RigName: TypeAlias = Annotated[str, with_metavar("RIG|twin")]
Fidelity: TypeAlias = Literal["render", "sketch"]


@Parameter(name="*", group="Emulated rig")
@dataclass(frozen=True, kw_only=True)
class TwinErrors:
    """Options for the simulated imperfections of the emulated rig."""

    profile: Profile = "bench"
    """Simulated imperfections of rig and pictures: clean (none), bench (well-built rig), camera (bench with an \
ordinary camera), harsh (badly adjusted rig), real (first scan of a living plant), or a TOML file."""
    seed: Seed = 0
    """Random seed for all simulated errors and noise."""


@Parameter(name="*", group="Emulated rig")
@dataclass(frozen=True, kw_only=True)
class TwinPictures(TwinErrors):
    """Options for the emulated rig: simulated imperfections, and rendering of its pictures."""

    fidelity: Fidelity = "render"
    """Pictures of the emulated rig: render (realistic, as in 'rhizotwin simulate') or sketch (fast, of \
light panel and marker strip but not of the plant)."""
    device: Device = "auto"
    """Device for the computation: cpu, cuda (an NVIDIA GPU) or auto (the GPU if available)."""


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Real or emulated rig with its scene and clock."""

    rig: "RigFile"
    scene: Scene
    """Scene as it is known in a laboratory. It contains nominal or calibrated values, and no simulated
    imperfections."""
    clock: Any
    twin: Any = None
    """Emulated rig. It is None if the rig is real."""
    pictures: TwinPictures | None = None
    """Options of the emulated rig. It is None if the rig is real."""

    def open_camera(self) -> "Camera":
        """Open the camera of the rig, and return it."""
        from rhizotwin.rig.cameras import open_camera

        if self.twin is not None:
            camera: Camera = self.twin.open_camera()
            return camera
        lens = self.scene.camera
        linear = lens.transfer == "linear"
        return open_camera(self.rig.camera, image_wh=lens.image_wh, bits=lens.bits, clock=self.clock, linear=linear)

    def open_devices(self, recorder: "Recorder | None", stack: ExitStack) -> "Devices":
        """Open all devices, and close them when ``stack`` is left.

        They are also closed if the terminal is closed.
        """
        from rhizotwin.rig.open import open_devices

        stack.enter_context(hang_up_stops())
        camera = None if self.twin is None else self.open_camera()
        devices = open_devices(self.rig, self.scene, clock=self.clock, camera=camera, recorder=recorder)
        stack.callback(devices.close)
        return devices


def check_rig(rig: str) -> None:
    """Check that a rig is ``twin`` or the name of an existing file, before other options are required of it.

    Raises
    ------
    UserError
        If there is no such file.
    """
    if rig != TWIN and not Path(rig).is_file():
        raise UserError(f'there is no rig file {rig}{suggestion(rig, [TWIN])}; give a rig file (TOML), or "{TWIN}" for the emulated rig')


def open_bench(rig: str, scene: str | None, *, errors: TwinErrors, plan: str | None = None) -> Bench:
    """Load a rig with its scene, without opening the devices.

    Pictures of the emulated rig are sketches unless ``errors`` is a `TwinPictures` with the fidelity ``render``.

    Parameters
    ----------
    rig : str
        Rig file, or ``twin`` for the emulated rig.
    scene : str or None
        Library scene or scene file; None: default scene.
    errors : TwinErrors
        Options of the emulated rig.
    plan : str or None
        Capture plan file, or scene, whose rings replace the rings of ``scene``; None: as in the scene.

    Returns
    -------
    Bench
        Rig with its scene and clock.
    """
    check_rig(rig)
    if rig != TWIN:
        from rhizotwin.rig.clock import SystemClock
        from rhizotwin.rig.rig_file import load_rig

        real = load_rig(rig)
        known = files.load_scene(scene) if scene else Scene()
        return Bench(rig=real, scene=_with_plan(known, plan), clock=SystemClock())
    known = _with_plan(files.load_scene(scene or TWIN_SCENE), plan)
    if isinstance(errors, TwinPictures) and errors.fidelity == "render":
        command_steps.start_engine(errors.device)
    return twin_bench(replace(known, disturbances=files.load_profile(errors.profile)), errors)


def twin_bench(known: Scene, errors: TwinErrors) -> Bench:
    """Return the emulated rig with the canister of a scene on its turntable.

    Parameters
    ----------
    known : Scene
        Scene with specimen and simulated imperfections.
    errors : TwinErrors
        Options of the emulated rig. For the fidelity ``render`` of `TwinPictures`, the compute engine must have been
        started. With a plain `TwinErrors` the pictures are sketches.

    Returns
    -------
    Bench
        Emulated rig with its scene and clock.
    """
    pictures = errors if isinstance(errors, TwinPictures) else TwinPictures(profile=errors.profile, seed=errors.seed, fidelity="sketch")
    from rhizotwin.rig.twin.twin import Twin, default_rig

    rig_file = default_rig(scene=known)
    if errors.profile == "real":  # the roots in this profile swing after each move
        rig_file = replace(rig_file, turntable=replace(rig_file.turntable, rest="measured"))
    emulated = Twin(known, seed=errors.seed, profile_name=errors.profile, pictures=pictures.fidelity, rig=rig_file)
    return Bench(rig=emulated.rig, scene=emulated.calibrated_scene(), clock=emulated.clock, twin=emulated, pictures=pictures)


def scene_of_plant(scene: Scene, plant: "Plant") -> Scene:
    """Return a copy of the scene for a plant in the catalogue.

    The copy has the marker strip, nutrient solution and age of the plant, and the species, treatment and replicate that
    the scene does not specify. If the scene specifies an age, it is not changed. Otherwise the age is the number of
    days from sowing to the date of the scan, or None if the date precedes sowing.

    Raises
    ------
    UserError
        If a value in the scene differs from the catalogue.
    """
    strip, subject = scene.strip, scene.subject
    for name in ("species", "treatment", "replicate"):
        given, known = getattr(subject, name), getattr(plant, name)
        if given in ("", None):
            subject = replace(subject, **{name: known})
        elif known not in ("", None) and given != known:
            raise UserError(
                f"the {name} of plant {plant.name} is {known!r} in the catalogue, not {given!r}; correct the {name} or the plant's name"
            )
    if plant.tag is not None:
        strip = replace(strip, dictionary=plant.tag.dictionary, first_id=plant.tag.first_id)
    if subject.day is None and plant.sown:
        days = (date.fromisoformat(subject.date) - date.fromisoformat(plant.sown)).days
        subject = replace(subject, day=float(days) if days >= 0 else None)
    return replace(scene, strip=strip, subject=subject, solution=plant.solution if plant.solution.known else scene.solution)


def take_scan(bench: Bench, devices: "Devices", scene: Scene, folder: Path, *, observers: "Observers", resume: bool = False) -> "Dataset":
    """Scan with devices that are already open, and write the ground truth if the pictures are rendered.

    Parameters
    ----------
    bench, devices : Bench, Devices
        Rig and its open devices.
    scene : Scene
        Scene of the rig with the subject of this scan.
    folder : Path
        New or empty folder for the dataset; with ``resume`` the folder of the interrupted scan.
    observers : Observers
        Callbacks of the scan; the callback ``begun`` is replaced.
    resume : bool
        Continue an interrupted scan.

    Returns
    -------
    Dataset
        Complete dataset.

    Raises
    ------
    RigError
        If a device failed; the scan can be resumed.
    UserError
        If the folder or the plan cannot be used.
    """
    from rhizotwin.rig.scanning.scan import scan
    from rhizotwin.rig.scanning.session import Origin

    # a resumed scan also needs the true state of the pictures before the interruption
    twin = bench.pictures
    rendered = twin is not None and twin.fidelity == "render"
    settings = {"twin": None if twin is None else _origin_of(twin, bench.twin.scene)}
    dataset = scan(
        devices,
        scene,
        folder,
        resume=resume,
        origin=Origin(settings=settings, seed=None if twin is None else twin.seed),
        observers=replace(observers, begun=(lambda: bench.twin.record.keep_in(folder / SHOTS_FILE)) if rendered else (lambda: None)),
    )
    if rendered:
        bench.twin.write_truth(folder, dataset.frames)
        bench.twin.record.end()
    return dataset


def _origin_of(twin: TwinPictures, scene: Scene) -> dict[str, str]:
    """Return the settings of the emulated rig that are stored in the dataset, and the SHA-256 of the scene."""
    digest = hashlib.sha256(json.dumps(to_plain(scene), sort_keys=True).encode()).hexdigest()
    return {"profile": twin.profile, "fidelity": twin.fidelity, "scene_sha256": digest}


def _with_plan(scene: Scene, plan: str | None) -> Scene:
    """Return a copy of the scene with the rings of a capture plan, which is a file or another scene."""
    if plan is None:
        return scene
    path = Path(plan)
    if path.suffix == ".toml":
        table, text = files.read_toml(path)
        if "plan" not in table:
            raise UserError(f"{path}: the table [[plan.rings]] is missing; give a file with this table, or the name of a scene")
        changed = replace(scene, plan=from_plain(CapturePlan, table["plan"], Place(str(path), text).at("plan")))
    else:
        changed = replace(scene, plan=files.load_scene(plan).plan)
    check_scene(changed, where=f"scene {scene.name} with the plan of {plan}")
    return changed


def recorder(path: Path | None, stack: ExitStack) -> Any:
    """Open a file to which the serial communication is recorded.

    If ``path`` is None, nothing is recorded, and the result is None.
    """
    if path is None:
        return None
    from rhizotwin.rig.serial_line.recording import Recorder

    if path.is_file():
        with path.open("rb") as stream:
            start = stream.read(12)
        if start not in (b"", b'{"recording"'):
            raise UserError(f"{path} already exists and is not a recording of serial communication; choose another name")
    opened = Recorder(path)
    stack.callback(opened.close)
    return opened


def asker() -> Callable[[str], str] | None:
    """Return a function that asks the user a question on the terminal, and returns the answer.

    The result is None if there is no terminal.
    """
    if not sys.stdin.isatty():
        return None

    def ask(question: str) -> str:
        try:
            return input(question)
        except EOFError:
            raise UserError(
                "a question was not answered; run the command again, or answer in advance with an option (see --help)"
            ) from None

    return ask


@contextmanager
def hang_up_stops() -> Iterator[None]:
    """Treat the closing of the terminal like Ctrl-C.

    The lamps are then switched off, and the arm is parked.
    """
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "SIGHUP"):
        yield
        return
    before = signal.signal(signal.SIGHUP, signal.getsignal(signal.SIGTERM))
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, before)
