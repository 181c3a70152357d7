"""Command `rhizotwin console`."""

import getpass
import ipaddress
import os
import socket
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from rhizotwin.scenes.errors import UserError
from rhizotwin.steps import command_steps, rigs
from rhizotwin.steps.arguments import OutputFolder, Page, SceneName, with_metavar

if TYPE_CHECKING:
    from rhizotwin.console.serve import Served
    from rhizotwin.timelapse.experiment import Experiment

PASSWORD_VARIABLE = "RHIZOTWIN_CONSOLE_PASSWORD"
LEAST_LETTERS = 8
"""Minimum number of characters of a password."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Laboratory:
    """Options for a rig and the folder of its scans, without an experiment."""

    rig: rigs.RigName | None = None
    """Rig file (TOML), or twin for the emulated rig; required unless --experiment is given."""
    output: OutputFolder | None = None
    """Folder of scans, results and catalogue, new or existing; required unless --experiment is given."""
    scene: SceneName | None = None
    """Scene of the rig: a name listed by 'rhizotwin scenes', or a scene file (TOML). Required with a rig file; \
default for the emulated rig: printed_8ml."""
    plan: Annotated[str | None, with_metavar("PLAN")] = None
    """Camera positions that replace those of the scene: a TOML file with [[plan.rings]], or the name of a scene."""


def console(
    *,
    laboratory: Laboratory = Laboratory(),
    experiment: Annotated[Path | None, with_metavar("FILE")] = None,
    twin: rigs.TwinPictures = rigs.TwinPictures(),
    page: Page = Page(),
) -> None:
    """Control the rig, scan and reconstruct in a browser.

    Start the console in one of two ways: with --rig and --output for individual scans, or with --experiment for a
    time-lapse experiment, whose file specifies rig and folders.

    The web page shows the devices, a live picture, the running scan with a coarse hull of the roots, the plants with
    their schedule, and the reconstructions. Other programs can use the same functions through a REST API.

    By default, the page can be opened only on this computer. For other computers, set --host and a password (typed, or
    in the environment variable RHIZOTWIN_CONSOLE_PASSWORD). Ctrl-C stops the console and a running scan safely.

    Parameters
    ----------
    laboratory : Laboratory
        Rig, and folder of its scans.
    experiment : Path, optional
        Experiment file (TOML; 'rhizotwin timelapse example' writes an example), which replaces --rig and --output.
    twin : TwinPictures
        Options of the emulated rig.
    page : Page
        Address of the web page.

    Examples
    --------
    rhizotwin console --rig twin -o my_laboratory --fidelity sketch
    rhizotwin console --experiment my_experiment.toml
    rhizotwin console --rig my_rig.toml --scene my_scene.toml -o my_laboratory --host 0.0.0.0 --no-browser
    """
    password = "" if _is_local(page.host) else _password()
    place = _place(laboratory, twin) if experiment is None else _of_experiment(experiment, laboratory)
    command_steps.print_marker_warnings(place.bench.scene)
    from rhizotwin.console.access import Access
    from rhizotwin.console.console import Console
    from rhizotwin.console.serve import serve

    with rigs.hang_up_stops(), ExitStack() as stack:
        opened = Console(place.bench, place.folder, experiment=place.experiment)
        stack.callback(opened.close)
        served = serve(opened, Access(password=password), host=page.host, port=page.port)
        stack.callback(served.stop)
        _print_address(served, page, password=password)
        while True:
            time.sleep(1.0)


@dataclass(frozen=True, kw_only=True)
class _Place:
    """Rig, folder and experiment of a console."""

    bench: rigs.Bench
    folder: Path
    experiment: "Experiment | None" = None


def _place(laboratory: Laboratory, twin: rigs.TwinPictures) -> _Place:
    """Return the rig and the folder for a console without an experiment."""
    rig, scene = laboratory.rig, laboratory.scene
    if rig is None or laboratory.output is None:
        raise UserError("the console needs either --rig RIG and --output FOLDER, or --experiment FILE; see rhizotwin console --help")
    rigs.check_rig(rig)
    if rig != rigs.TWIN and scene is None:
        raise UserError("--scene is missing; give the scene file of this rig")
    return _Place(bench=rigs.open_bench(rig, scene, errors=twin, plan=laboratory.plan), folder=laboratory.output)


def _of_experiment(file: Path, laboratory: Laboratory) -> _Place:
    """Return the rig and the folder of a time-lapse experiment."""
    if laboratory.rig is not None or laboratory.output is not None:
        raise UserError("--rig and --output cannot be used with --experiment, whose file specifies rig and folders; remove them")
    from rhizotwin.timelapse.experiment import load_experiment

    loaded = load_experiment(file)
    scene = loaded.base_scene()
    if not loaded.is_emulated:
        bench = rigs.open_bench(str(loaded.folder / loaded.rig), None, errors=rigs.TwinErrors())
        return _Place(bench=replace(bench, scene=scene), folder=loaded.folder, experiment=loaded)
    part = loaded.twin
    twin = rigs.TwinPictures(profile=part.profile, seed=part.seed, fidelity=part.fidelity)
    if part.fidelity == "render":
        command_steps.start_engine(twin.device)
    bench = rigs.twin_bench(replace(scene, disturbances=loaded.disturbances()), twin)
    return _Place(bench=bench, folder=loaded.folder, experiment=loaded)


def _print_address(served: "Served", page: Page, *, password: str) -> None:
    """Print the address of the console's page, and open the page in a browser."""
    if password:
        print(f"address for other computers: http://{socket.gethostname()}:{served.port}/ (with the password)", flush=True)
        print("the connection is not encrypted; use a trusted network, or ssh -L", flush=True)
    if served.host in ("0.0.0.0", "::"):
        print(f"http://127.0.0.1:{served.port}/?token={served.access.token}", flush=True)
    else:
        command_steps.open_page(served.address, served.port, page)
    print("press Ctrl-C to stop", flush=True)


def _is_local(host: str) -> bool:
    """Return whether an address is reachable only from this computer."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _password() -> str:
    """Read the password from the environment variable or the terminal.

    Raises
    ------
    UserError
        If the password is missing or too short.
    """
    given = os.environ.get(PASSWORD_VARIABLE, "")
    if not given and sys.stdin.isatty():
        given = getpass.getpass(f"password for the console (at least {LEAST_LETTERS} characters): ")
    if len(given) < LEAST_LETTERS:
        raise UserError(
            f"a console with this --host needs a password of at least {LEAST_LETTERS} characters; "
            f"set the environment variable {PASSWORD_VARIABLE}, or enter the password when asked"
        )
    return given
