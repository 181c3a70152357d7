"""What ``scan``, ``twin``, ``rig`` and ``camera`` do; the work itself is in `rig`."""

import argparse
import hashlib
import json
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from tqdm import tqdm

from rhizotwin import steps
from rhizotwin.rig.devices import Camera
from rhizotwin.rig.rig_file import RigFile, load_rig
from rhizotwin.rig.scanning.homing import Ask
from rhizotwin.scenes import files
from rhizotwin.scenes.atomic import write_text
from rhizotwin.scenes.checks import check_scene
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import CapturePlan, Scene
from rhizotwin.scenes.schema import to_plain

TWIN = "twin"
TWIN_SCENE = "printed_8ml"
SHOTS_FILE = "truth/shots.jsonl"
"""What the twin's pictures truly show, kept so that the truth of a scan that was stopped can be written."""


@dataclass(frozen=True, kw_only=True)
class Bench:
    """A rig with what belongs to it, real or emulated."""

    rig: RigFile
    scene: Scene
    """As a laboratory knows it."""
    clock: Any
    twin: Any = None
    """None: the rig is real."""

    def open_camera(self) -> Camera:
        """Open the camera."""
        from rhizotwin.rig.cameras import open_camera

        if self.twin is not None:
            camera: Camera = self.twin.open_camera()
            return camera
        lens = self.scene.camera
        return open_camera(self.rig.camera, image_wh=lens.image_wh, bits=lens.bits, clock=self.clock)


def scan(options: argparse.Namespace) -> None:
    """Take the pictures of a plan."""
    from rhizotwin.rig.open import open_devices
    from rhizotwin.rig.scanning.scan import scan as take

    twin = options.rig == TWIN
    if not twin and options.scene is None:
        raise UserError("--scene is missing: give the scene file of this rig, with its canister, strip, calibrated camera and plan")
    bench = _bench(options, plan=options.plan, pictures=options.fidelity)
    settings: dict[str, Any] = {"twin": None}
    if twin:
        # what its pictures show, for the truth: a scan that is killed and taken up needs it of the pictures before, too
        bench.twin.record.keep_in(options.output.with_name(f".{options.output.name}.twin.jsonl"))
        settings = {"twin": {"profile": options.profile, "fidelity": options.fidelity, "scene_sha256": _hash(bench.twin.scene)}}
    rendered = twin and options.fidelity == "render"
    with ExitStack() as stack:
        stack.enter_context(_hang_up_stops())
        recorder = _recorder(options.record, stack)
        devices = open_devices(bench.rig, bench.scene, clock=bench.clock, camera=bench.twin and bench.open_camera(), recorder=recorder)
        stack.callback(devices.close)
        made = take(
            devices,
            bench.scene,
            options.output,
            resume=options.resume,
            settings=settings,
            seed=options.seed if twin else None,
            table_angle_deg=options.table_angle,
            ask=_ask(),
            say=tqdm.write,
            begun=(lambda: bench.twin.record.keep_in(options.output / SHOTS_FILE)) if rendered else (lambda: None),
        )
    if rendered:
        bench.twin.write_truth(options.output, made.frames)
        bench.twin.record.end()
    print(f"{len(made.frames)} pictures in {options.output / 'images'}")
    if not twin or rendered:
        print(f"next: rhizotwin reconstruct {options.output} -o my_result")


def twin(options: argparse.Namespace) -> None:
    """Run the emulated rig alone."""
    from rhizotwin.rig.twin.server import run_twin

    scene = replace(files.load_scene(options.scene), disturbances=files.load_profile(options.profile))
    if options.output is not None and options.output.exists():
        raise UserError(f"{options.output} exists already; choose another name for the rig file")
    if options.fidelity == "render":
        steps.start_engine(options)
    run_twin(
        scene,
        seed=options.seed,
        profile_name=options.profile,
        pictures=options.fidelity,
        protocol=options.protocol,
        speed=options.speed,
        write_rig=options.output,
        say=print,
        faults=options.fault,
        camera_port=options.camera_port,
    )


def rig(options: argparse.Namespace) -> None:
    """Do one step on the bench."""
    {"check": check, "jog": jog, "example": example}[options.step](options)


def check(options: argparse.Namespace) -> None:
    """Look at every device."""
    from rhizotwin.rig.bench import check as look

    bench = _bench(options)
    with ExitStack() as stack:
        recorder = _recorder(options.record, stack)
        wrong = look(
            bench.rig, bench.scene, clock=bench.clock, open_camera=bench.open_camera, say=print, folder=Path.cwd(), recorder=recorder
        )
    if wrong:
        raise UserError(f"{wrong} {'thing is' if wrong == 1 else 'things are'} wrong with {bench.rig.name}; see the lines above")


def jog(options: argparse.Namespace) -> None:
    """Move devices by typed lines."""
    from rhizotwin.rig.jog import Jog
    from rhizotwin.rig.open import open_devices

    bench = _bench(options)
    typed = sys.stdin.isatty()
    with ExitStack() as stack:
        stack.enter_context(_hang_up_stops())
        recorder = _recorder(options.record, stack)
        devices = open_devices(bench.rig, bench.scene, clock=bench.clock, camera=bench.twin and bench.open_camera(), recorder=recorder)
        stack.callback(devices.close)
        if typed:
            print("type help for the commands, quit to end")
        Jog(devices, bench.scene, say=print).run(_typed_lines() if typed else sys.stdin, stop_at_mistake=not typed)


def example(options: argparse.Namespace) -> None:
    """Write a complete rig file."""
    from rhizotwin.rig.example import EXAMPLE

    if options.output.exists():
        raise UserError(f"{options.output} exists already; choose another name")
    write_text(options.output, EXAMPLE)
    print(f"wrote {options.output}; change it, then try: rhizotwin rig check {options.output}")


def camera(options: argparse.Namespace) -> None:
    """Serve a camera to another computer."""
    from rhizotwin.rig.cameras.server import serve_camera

    part = load_rig(options.rig).camera
    lens = (files.load_scene(options.scene) if options.scene else Scene()).camera
    serve_camera(part, image_wh=lens.image_wh, bits=lens.bits, host=options.host, port=options.port, say=print)


def _bench(options: argparse.Namespace, *, plan: str | None = None, pictures: Literal["render", "sketch"] = "sketch") -> Bench:
    """Return the rig that the command line names, with its scene."""
    if options.rig != TWIN:
        from rhizotwin.rig.clock import SystemClock

        real = load_rig(options.rig)
        scene = files.load_scene(options.scene) if options.scene else Scene()
        return Bench(rig=real, scene=_with_plan(scene, plan), clock=SystemClock())
    scene = _with_plan(files.load_scene(options.scene or TWIN_SCENE), plan)
    scene = replace(scene, disturbances=files.load_profile(options.profile))
    if pictures == "render":
        steps.start_engine(options)
    from rhizotwin.rig.twin.twin import Twin

    emulated = Twin(scene, seed=options.seed, profile_name=options.profile, pictures=pictures)
    return Bench(rig=emulated.rig, scene=emulated.calibrated_scene(), clock=emulated.clock, twin=emulated)


def _with_plan(scene: Scene, plan: str | None) -> Scene:
    """Put the rings of another file or scene into a scene."""
    if plan is None:
        return scene
    path = Path(plan)
    if path.suffix == ".toml" and "plan" not in files.read_toml(path)[0]:
        raise UserError(f"{path}: has no [[plan.rings]]; give a file that has, or the name of a scene")
    changed = replace(scene, plan=CapturePlan(rings=files.load_scene(plan).plan.rings))
    check_scene(changed, where=f"scene {scene.name} with the plan of {plan}")
    return changed


def _recorder(path: Path | None, stack: ExitStack) -> Any:
    """Open what keeps the bytes on the wire, if it is asked for."""
    if path is None:
        return None
    from rhizotwin.rig.serial_line.recording import Recorder

    if path.is_file() and path.stat().st_size and not path.read_bytes().startswith(b'{"recording"'):
        raise UserError(f"{path} exists already and holds no record; choose another name")
    recorder = Recorder(path)
    stack.callback(recorder.close)
    return recorder


def _ask() -> Ask | None:
    """Return what asks the person at the terminal; None when nobody is there."""
    if not sys.stdin.isatty():
        return None

    def ask(question: str) -> str:
        try:
            return input(question)
        except EOFError:
            raise UserError("the question was not answered; run it again and answer, or see --help for how to say it beforehand") from None

    return ask


def _typed_lines() -> Iterator[str]:
    """Yield what a person types until the end of the input."""
    while True:
        try:
            yield input("rig> ")
        except EOFError:
            return


@contextmanager
def _hang_up_stops() -> Iterator[None]:
    """Let a closed terminal stop the program as Ctrl-C does: the lamps must go off, and the arm must be parked."""
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "SIGHUP"):
        yield
        return
    before = signal.signal(signal.SIGHUP, signal.getsignal(signal.SIGTERM))
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, before)


def _hash(scene: Scene) -> str:
    return hashlib.sha256(json.dumps(to_plain(scene), sort_keys=True).encode()).hexdigest()
