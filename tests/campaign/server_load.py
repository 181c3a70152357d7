"""Load on a running console: idle connections, wrong passwords, slow bodies and many clients, each in a process of its own.

It is measured how much each load slows down a scan with the emulated rig.
"""

import asyncio
import json
import resource
import subprocess
import sys
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from urllib.parse import urlsplit

from rhizotwin.console import console as server
from rhizotwin.console.access import Access
from rhizotwin.console.client import Console
from rhizotwin.console.serve import serve
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import save_scene
from rhizotwin.steps import rigs
from tests.rhizotwin.timelapse.conftest import small_scene

ROOT = Path(__file__).resolve().parents[2]
MODULE = "tests.campaign.server_load"
PASSWORD = "a right password"
DESCRIPTORS = 1024
"""Limit of open files of the console, which is the default of most Linux distributions."""
CAMPAIGN = {
    "1100 idle connections": ("idle", 1100),
    "300 slow bodies": ("slow_body", 300),
    "60 wrong passwords": ("wrong_password", 60),
    "40 clients": ("page", 40),
}
"""Load and number of connections, by the label of the result."""


async def _ask(address: str, request: str, *, hold_s: float = 0.0) -> bytes:
    """Send a text on a new connection; return the answer, or wait without one."""
    parts = urlsplit(address)
    reader, writer = await asyncio.open_connection(parts.hostname, parts.port)
    try:
        writer.write(request.encode())
        if hold_s:
            await asyncio.sleep(hold_s)
            return b""
        head = await reader.readuntil(b"\r\n\r\n")
        length = int(head.lower().partition(b"content-length:")[2].partition(b"\r\n")[0] or 0)
        return await reader.readexactly(length)
    finally:
        writer.close()


async def idle(address: str) -> None:
    """Open a connection, and send nothing."""
    await _ask(address, "", hold_s=60.0)


async def slow_body(address: str) -> None:
    """Log in with a body that never ends."""
    await _ask(address, "POST /login HTTP/1.1\r\nHost: x\r\nContent-Length: 60000\r\n\r\npassword=", hold_s=60.0)


async def wrong_password(address: str) -> None:
    """Try a wrong password."""
    await _ask(address, "GET /api/state HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer wrong\r\n\r\n")


async def page(address: str) -> None:
    """Do what the page of the console does: wait for the next state, and load its picture if it is another one."""
    token, seen, picture = urlsplit(address).query.removeprefix("token="), 0, None
    head = f"HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {token}\r\nX-Rhizotwin-Client: {id(asyncio.current_task())}\r\n\r\n"
    while True:
        state = json.loads(await _ask(address, f"GET /api/state?after={seen}&wait_s=20 {head}"))
        seen, shown = state["version"], (state["picture"] or {}).get("number")
        if shown != picture:
            await _ask(address, f"GET /api/picture.jpg {head}")
        picture = shown


LOADS = {one.__name__: one for one in (idle, slow_body, wrong_password, page)}


async def _repeat(load: Callable[[str], Awaitable[None]], address: str) -> None:
    while True:
        with suppress(OSError, asyncio.IncompleteReadError, ValueError):
            await load(address)
        await asyncio.sleep(0.02)  # a refused connection is tried again


async def _run(name: str, address: str, count: int) -> None:
    tasks = [asyncio.create_task(_repeat(LOADS[name], address)) for _ in range(count)]
    _say("started")
    await asyncio.gather(*tasks)


def serve_console(folder: Path) -> None:
    """Serve a console with a password and the usual limit of open files, until the process is killed."""
    resource.setrlimit(resource.RLIMIT_NOFILE, (DESCRIPTORS, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
    twin = rigs.TwinPictures(fidelity="sketch", profile="clean")
    console = server.Console(rigs.open_bench(rigs.TWIN, str(folder / "scene.toml"), errors=twin), folder / "lab")
    _say(serve(console, Access(password=PASSWORD), host="127.0.0.1", port=8770).address)
    threading.Event().wait()


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


@contextmanager
def _started(*words: object) -> Iterator[str]:
    """Run this module in a process of its own, which is killed at the end; return the first line that it prints."""
    with subprocess.Popen([sys.executable, "-m", MODULE, *map(str, words)], cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            line = process.stdout.readline().strip()
            time.sleep(0.5)  # so that the connections are there
            yield line
        finally:
            process.kill()


def longest_s(action: Callable[[], object], *, times: int = 20) -> float:
    """Return the longest duration of an action, s."""
    found = []
    for _ in range(times):
        begun = time.monotonic()
        action()
        found.append(time.monotonic() - begun)
    return max(found)


def scan_s(console: Console) -> float:
    """Perform a scan, and return its duration, s."""
    begun = time.monotonic()
    console.start_scan(reconstruct=False)
    console.wait_for_scan(timeout_s=600.0)
    return time.monotonic() - begun


def stop_is_safe(console: Console) -> bool:
    """Return whether a request to stop the scan was answered, although no scan is running."""
    with suppress(UserError):
        console.stop_scan()
    return True


def measure(folder: Path, *, repeats: int = 3, views: int = 12) -> dict[str, float]:
    """Measure the console under each load.

    Returns
    -------
    dict of float
        Shortest duration of a scan under each load, relative to that without a load (``scan under ...``), and longest
        time until the right password is accepted and a request to stop the scan is answered, s.
    """
    folder.mkdir(parents=True, exist_ok=True)
    save_scene(small_scene(views), folder / "scene.toml")
    with _started("serve", folder) as address:
        console, found = Console(address, password=PASSWORD), {}
        console.take_control("load")
        for label, (name, count) in CAMPAIGN.items():
            alone_s, loaded_s = [], []
            for _ in range(repeats):  # in turn, because other programs on the computer come and go
                alone_s.append(scan_s(console))
                with _started(name, address, count):
                    loaded_s.append(scan_s(console))
                    found[f"stop under {label}, s"] = longest_s(lambda: stop_is_safe(console))
            found[f"scan under {label}"] = min(loaded_s) / min(alone_s)
        return found


if __name__ == "__main__":
    if sys.argv[1] == "serve":
        serve_console(Path(sys.argv[2]))
    else:
        asyncio.run(_run(sys.argv[1], sys.argv[2], int(sys.argv[3])))
