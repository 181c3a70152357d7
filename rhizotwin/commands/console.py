"""`rhizotwin console`."""

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

from rhizotwin import command_steps, rigs
from rhizotwin.arguments import OutputFolder, Page, SceneName, with_metavar
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import load_profile

if TYPE_CHECKING:
    from rhizotwin.console.serve import Served
    from rhizotwin.timelapse.experiment import Experiment

PASSWORD_VARIABLE = "RHIZOTWIN_CONSOLE_PASSWORD"
LEAST_LETTERS = 8
"""Minimum length of a password."""


def console(
    *,
    rig: rigs.RigName | None = None,
    output: OutputFolder | None = None,
    experiment: Annotated[Path | None, with_metavar("FILE")] = None,
    scene: SceneName | None = None,
    plan: Annotated[str | None, with_metavar("PLAN")] = None,
    twin: rigs.TwinPictures = rigs.TwinPictures(),
    page: Page = Page(),
) -> None:
    """Serve the laboratory console: control the rig, scan and reconstruct in a browser.

    The page shows the devices, a live picture with markers, focus and exposure, the running scan with a sketch of the
    roots, the plants with their schedule, and the queue of reconstructions with their reports. Programs use the same
    actions as a REST API (/api/openapi.json).

    The console is served on this computer only, to those who have the printed address with its token. With another
    --host it asks for a password, which is read from the environment variable RHIZOTWIN_CONSOLE_PASSWORD or typed at
    the start. Ctrl-C ends it: a running scan is stopped safely and can be finished later.

    Parameters
    ----------
    rig : str
        Rig file (TOML; 'rhizotwin rig example' writes one), or the word twin: emulated devices in this program.
    output : Path
        Folder for scans, results, single pictures, catalogue and queue; an existing one is continued.
    experiment : Path, optional
        Experiment file ('rhizotwin timelapse example' writes one) with plants, schedule, rig and folders.
    scene : str, optional
        A scene file, or a name from 'rhizotwin scenes'; needed for a rig file; the twin's default: printed_8ml.
    plan : str, optional
        Use the rings of a file with [[plan.rings]], or of another scene.
    twin : TwinPictures
        Errors of the emulated rig, and how its pictures are made.
    page : Page
        Where the page is served.

    Examples
    --------
    rhizotwin console --rig twin -o my_laboratory --fidelity sketch
    rhizotwin console --experiment my_experiment.toml
    rhizotwin console --rig my_rig.toml --scene my_scene.toml -o my_laboratory --host 0.0.0.0 --no-browser
    """
    password = "" if _is_local(page.host) else _password()
    place = _place(rig, output, scene, plan=plan, twin=twin) if experiment is None else _of_experiment(experiment, rig, output)
    command_steps.print_marker_warnings(place.bench.scene)
    from rhizotwin.console.access import Access
    from rhizotwin.console.console import Console
    from rhizotwin.console.serve import serve

    with rigs.hang_up_stops(), ExitStack() as stack:
        opened = Console(place.bench, place.folder, twin=place.twin, experiment=place.experiment)
        stack.callback(opened.close)
        served = serve(opened, Access(password=password), host=page.host, port=page.port)
        stack.callback(served.stop)
        _print_address(served, page, password=password)
        while True:
            time.sleep(1.0)


@dataclass(frozen=True, kw_only=True)
class _Place:
    """Rig and folder of a console."""

    bench: rigs.Bench
    folder: Path
    twin: rigs.TwinPictures | None
    experiment: "Experiment | None" = None


def _place(rig: str | None, output: Path | None, scene: str | None, *, plan: str | None, twin: rigs.TwinPictures) -> _Place:
    """Return the rig and the folder that the options name."""
    if rig is None or output is None:
        raise UserError("give --rig and -o, or --experiment")
    emulated = twin if rig == rigs.TWIN else None
    if emulated is None and scene is None:
        raise UserError("--scene is missing: give the scene file of this rig")
    return _Place(bench=rigs.open_bench(rig, scene, errors=twin, plan=plan), folder=output, twin=emulated)


def _of_experiment(file: Path, rig: str | None, output: Path | None) -> _Place:
    """Return the rig and the folder of an experiment."""
    if rig is not None or output is not None:
        raise UserError("--experiment names the rig and the folders: leave --rig and -o out")
    from rhizotwin.timelapse.experiment import load_experiment

    loaded = load_experiment(file)
    scene = loaded.base_scene()
    if not loaded.is_emulated:
        bench = rigs.open_bench(str(loaded.folder / loaded.rig), None, errors=rigs.TwinErrors())
        return _Place(bench=replace(bench, scene=scene), folder=loaded.folder, twin=None, experiment=loaded)
    part = loaded.twin
    twin = rigs.TwinPictures(profile=part.profile, seed=part.seed, fidelity=part.fidelity)
    if part.fidelity == "render":
        command_steps.start_engine(twin.device)
    bench = rigs.twin_bench(replace(scene, disturbances=load_profile(part.profile)), twin)
    return _Place(bench=bench, folder=loaded.folder, twin=twin, experiment=loaded)


def _print_address(served: "Served", page: Page, *, password: str) -> None:
    """Print where the console is, and open it in a browser."""
    if password:
        print(f"in the network: http://{socket.gethostname()}:{served.port}/ with the password", flush=True)
        print("the connection is not encrypted: use a network that you trust, or ssh -L", flush=True)
    if served.host in ("0.0.0.0", "::"):
        print(f"http://127.0.0.1:{served.port}/?token={served.access.token}", flush=True)
    else:
        command_steps.open_page(served.address, served.port, page)
    print("Ctrl-C ends it", flush=True)


def _is_local(host: str) -> bool:
    """Return whether an address can be reached from this computer only."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _password() -> str:
    """Return the password from the environment or the terminal.

    Raises
    ------
    UserError
        For a missing or short password.
    """
    given = os.environ.get(PASSWORD_VARIABLE, "")
    if not given and sys.stdin.isatty():
        given = getpass.getpass(f"password for the console (at least {LEAST_LETTERS} characters): ")
    if len(given) < LEAST_LETTERS:
        raise UserError(
            f"a --host reachable from the network requires a password of at least {LEAST_LETTERS} characters; "
            f"set {PASSWORD_VARIABLE}, or enter it when asked"
        )
    return given
