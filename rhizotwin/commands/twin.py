"""`rhizotwin twin`."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from rhizotwin import command_steps, rigs
from rhizotwin.arguments import Port, SceneName, between, option, options, output
from rhizotwin.scenes import files
from rhizotwin.scenes.errors import UserError

SPEED_LIMITS = (0.01, 1000.0)


def read_speed(text: str) -> float:
    """Read how many times faster than real time."""
    return between(text, SPEED_LIMITS, "times real time")


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class TwinPorts(rigs.TwinPictures):
    """What the emulated rig gets wrong, and how it is reached."""

    fidelity: rigs.Fidelity = "sketch"
    """Of the pictures: render: as 'simulate' makes them; sketch: strip and panel only, at once."""
    speed: Annotated[float, option(read_speed, "X")] = 1.0
    """How many times faster than real its time passes."""
    protocol: Literal["lx", "lsc"] = "lx"
    """What the arm speaks: servo bus or controller board."""
    fault: Annotated[tuple[str, ...], options(str, "FAULT")] = ()
    """Something that goes wrong, such as 'reset', or 'reply_late table amount=3 at_s=20'; may be given several \
times."""
    camera_port: Port | None = None
    """Of the camera's HTTP server; default: a free one."""


def twin(
    *,
    scene: SceneName = rigs.TWIN_SCENE,
    rig_file: Annotated[Path | None, output("RIG")] = None,
    ports: TwinPorts = TwinPorts(),
) -> None:
    """Run the emulated rig alone, on ports that any serial program can open.

    Start the emulated turntable, lights and arm on pseudo-terminals, and print the ports. They speak the bytes of the
    real devices, in real time; the camera is served over HTTP. Faults can be typed while it runs. Ctrl-C ends it.

    Parameters
    ----------
    scene : str
        A scene file, or a name from 'rhizotwin scenes'.
    rig_file : Path, optional
        Write a rig file (TOML) with these ports; must not exist yet.
    ports : TwinPorts
        What it gets wrong, and how it is reached.

    Examples
    --------
    rhizotwin twin
    rhizotwin twin --scene sphere_20mm --profile bench --seed 3 -o my_twin_rig.toml
    rhizotwin rig check my_twin_rig.toml
    """
    if sys.platform == "win32":
        raise UserError("rhizotwin twin needs pseudo-terminals, which Windows lacks; use scan --rig twin, which needs none, or WSL")
    from rhizotwin.rig.twin.faults import parse_fault
    from rhizotwin.rig.twin.server import run_twin
    from rhizotwin.rig.twin.twin import Twin, default_rig

    emulated = replace(files.load_scene(scene), disturbances=files.load_profile(ports.profile))
    if rig_file is not None and rig_file.exists():
        raise UserError(f"{rig_file} exists already; choose another name for the rig file")
    if ports.fidelity == "render":
        command_steps.start_engine(ports.device)
    made = Twin(
        emulated,
        seed=ports.seed,
        profile_name=ports.profile,
        faults=[parse_fault(text) for text in ports.fault],
        pictures=ports.fidelity,
        rig=default_rig(ports.protocol, scene=emulated),
    )
    run_twin(made, speed=ports.speed, write_rig=rig_file, say=print, camera_port=ports.camera_port or 0)
