"""Command `rhizotwin twin`."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from rhizotwin.scenes import files
from rhizotwin.scenes.errors import UserError
from rhizotwin.steps import command_steps, rigs
from rhizotwin.steps.arguments import Port, SceneName, option, options, output, read_number

SPEED_LIMITS = (0.01, 1000.0)


def read_speed(text: str) -> float:
    """Convert text to a speed relative to real time."""
    return read_number(text, SPEED_LIMITS, "times real time")


@Parameter(name="*", group="Emulated rig")
@dataclass(frozen=True, kw_only=True)
class TwinPorts(rigs.TwinPictures):
    """Options for the imperfections and ports of the emulated rig."""

    fidelity: rigs.Fidelity = "sketch"
    """Pictures of the emulated rig: render (realistic, as in 'rhizotwin simulate') or sketch (fast, of \
light panel and marker strip but not of the plant)."""
    speed: Annotated[float, option(read_speed, "X")] = 1.0
    """Speed of the emulation relative to real time."""
    protocol: Literal["lx", "lsc"] = "lx"
    """Protocol of the arm: lx (serial bus servos) or lsc (servo controller board)."""
    fault: Annotated[tuple[str, ...], options(str, "FAULT")] = ()
    """Fault to simulate, such as 'reset' or 'reply_late table amount=3 at_s=20'; may be repeated."""
    camera_port: Port | None = None
    """Port of the camera's HTTP server; default: a free port."""


def twin(
    *,
    scene: SceneName = rigs.TWIN_SCENE,
    rig_file: Annotated[Path | None, output("RIG")] = None,
    ports: TwinPorts = TwinPorts(),
) -> None:
    """Run the emulated rig on ports that any serial program can open.

    Emulated turntable, lamps and arm are started on pseudo-terminals, and their ports are printed. They respond with
    the protocols of the real devices in real time, and the pictures of the camera are available over HTTP. Faults can
    be typed while the emulation is running. Press Ctrl-C to stop.

    Parameters
    ----------
    scene : str
        Scene, which describes canister, plant and rig: a name listed by 'rhizotwin scenes', or a scene file (TOML).
    rig_file : Path, optional
        Rig file to write (TOML), with which other commands use these ports; must not exist yet.
    ports : TwinPorts
        Options for the imperfections and ports of the emulated rig.

    Examples
    --------
    rhizotwin twin
    rhizotwin twin --scene sphere_20mm --profile bench --seed 3 -o my_twin_rig.toml
    rhizotwin rig check my_twin_rig.toml
    """
    if sys.platform == "win32":
        raise UserError(
            "'rhizotwin twin' needs pseudo-terminals, which are not available on Windows; use 'rhizotwin scan --rig twin', or WSL"
        )
    from rhizotwin.rig.twin.faults import parse_fault
    from rhizotwin.rig.twin.server import run_twin
    from rhizotwin.rig.twin.twin import Twin, default_rig

    emulated = replace(files.load_scene(scene), disturbances=files.load_profile(ports.profile))
    if rig_file is not None and rig_file.exists():
        raise UserError(f"{rig_file} already exists; choose another name for the rig file")
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
