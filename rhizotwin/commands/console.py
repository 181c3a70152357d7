"""`rhizotwin console`."""

import getpass
import ipaddress
import os
import socket
import sys
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING, Annotated

from rhizotwin import rigs, steps
from rhizotwin.arguments import OutputFolder, Page, SceneName, named
from rhizotwin.scenes.errors import UserError

if TYPE_CHECKING:
    from rhizotwin.console.serve import Served

PASSWORD_VARIABLE = "RHIZOTWIN_CONSOLE_PASSWORD"
LEAST_LETTERS = 8
"""Length of a password."""


def console(
    *,
    rig: rigs.RigName,
    output: OutputFolder,
    scene: SceneName | None = None,
    plan: Annotated[str | None, named("PLAN")] = None,
    twin: rigs.TwinPictures = rigs.TwinPictures(),
    page: Page = Page(),
) -> None:
    """Serve the laboratory console: control the rig, scan and reconstruct in a browser.

    The page shows the devices, a live picture with markers, focus and exposure, the running scan with a sketch of the
    roots, and the queue of reconstructions with their reports. The arm, the table and the lights are moved from there,
    and scans are started, paused, stopped and finished. The same actions are available to programs as a REST API
    (/api/openapi.json).

    The console is served on this computer only, to those who have the printed address with its token. With another
    --host it asks for a password, which is read from the environment variable RHIZOTWIN_CONSOLE_PASSWORD or typed at
    the start. Ctrl-C ends it: a running scan is stopped safely and can be finished later.

    Parameters
    ----------
    rig : str
        Rig file (TOML; 'rhizotwin rig example' writes one), or the word twin: emulated devices in this program.
    output : Path
        Folder for scans, results, single pictures and the queue; an existing one is continued.
    scene : str, optional
        A scene file, or a name from 'rhizotwin scenes': canister, strip, calibrated lens and plan; needed for a rig
        file; the twin's default: printed_8ml.
    plan : str, optional
        Take the rings from here instead of the scene: a file with [[plan.rings]], or a scene's name.
    twin : TwinPictures
        Errors of the emulated rig, and how its pictures are made.
    page : Page
        Where the page is served.

    Examples
    --------
    rhizotwin console --rig twin -o my_laboratory --fidelity sketch
    rhizotwin console --rig twin --scene radish_day15a -o my_laboratory
    rhizotwin console --rig my_rig.toml --scene my_scene.toml -o my_laboratory
    rhizotwin console --rig my_rig.toml --scene my_scene.toml -o my_laboratory --host 0.0.0.0 --no-browser
    """
    emulated = twin if rig == rigs.TWIN else None
    if emulated is None and scene is None:
        raise UserError("--scene is missing: give the scene file of this rig")
    password = "" if _is_local(page.host) else _password()
    bench = rigs.open_bench(rig, scene, errors=twin, plan=plan)
    steps.print_marker_warnings(bench.scene)
    from rhizotwin.console.access import Access
    from rhizotwin.console.console import Console
    from rhizotwin.console.serve import serve

    with rigs.hang_up_stops(), ExitStack() as stack:
        opened = Console(bench, output, twin=emulated)
        stack.callback(opened.close)
        served = serve(opened, Access(password=password), host=page.host, port=page.port)
        stack.callback(served.stop)
        _print_address(served, page, password=password)
        while True:
            time.sleep(1.0)


def _print_address(served: "Served", page: Page, *, password: str) -> None:
    """Print where the console is, and open it in a browser."""
    if password:
        print(f"in the network: http://{socket.gethostname()}:{served.port}/ with the password", flush=True)
        print("the connection is not encrypted: use a network that you trust, or ssh -L", flush=True)
    if served.host in ("0.0.0.0", "::"):
        print(f"http://127.0.0.1:{served.port}/?token={served.access.token}", flush=True)
    else:
        steps.open_page(served.address, served.port, page)
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
        given = getpass.getpass(f"password for the console (at least {LEAST_LETTERS} letters): ")
    if len(given) < LEAST_LETTERS:
        raise UserError(
            f"--host with an address of the network needs a password of at least {LEAST_LETTERS} letters: "
            f"set the environment variable {PASSWORD_VARIABLE}, or type it on a terminal"
        )
    return given
