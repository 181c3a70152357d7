"""A console of a small emulated rig, served on this computer."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from rhizotwin import rigs
from rhizotwin.console import client
from rhizotwin.console.access import Access
from rhizotwin.console.console import Console
from rhizotwin.console.serve import Served, serve
from rhizotwin.scenes.files import save_scene
from rhizotwin.scenes.model import Camera, CapturePlan, MarkerStrip, Ring, Scene

VIEWS = 4
TWIN = rigs.TwinPictures(fidelity="sketch", profile="clean", seed=2)
PORT = 8760
LONG_S = 600.0
"""Limit of each wait, s. Waits end with their condition; the limit only ends a test that hangs, even on a busy computer."""


def until(found: Callable[[], Any]) -> Any:
    """Wait for a value that is true."""
    end = time.monotonic() + LONG_S
    while time.monotonic() < end:
        if value := found():
            return value
        time.sleep(0.02)
    raise AssertionError(f"waited {LONG_S:g} s in vain")


class Lab:
    """Served consoles in a folder; `stop` ends the latest one."""

    def __init__(self, folder: Path, scene: Path, password: str) -> None:
        self.folder, self._scene, self._password = folder, scene, password
        self._stack = ExitStack()
        self.console: Console
        self.served: Served
        self.start()

    def start(self) -> None:
        """Start a console in the folder."""
        bench = rigs.open_bench(rigs.TWIN, str(self._scene), errors=TWIN)
        self.bench = bench
        self.console = Console(bench, self.folder, twin=TWIN)
        self._stack.callback(self.console.close)
        self.served = serve(self.console, Access(password=self._password), host="127.0.0.1", port=PORT)
        self._stack.callback(self.served.stop)

    def stop(self) -> None:
        """End the console."""
        self._stack.close()

    def client(self, name: str = "") -> client.Console:
        """Return a client, in control if it has a name."""
        made = client.Console(self.served.address)
        if name:
            made.take_control(name)
        return made


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    small = Scene(
        camera=Camera().resized((400, 300)),
        strip=MarkerStrip(columns=22, rows=1, marker_mm=18.0, bottom_mm=2.0),
        plan=CapturePlan(rings=(Ring(views=VIEWS, height_mm=-20.0),)),
    )
    save_scene(small, tmp_path / "scene.toml")
    return tmp_path / "scene.toml"


@pytest.fixture
def make_lab(tmp_path: Path, scene_file: Path) -> Iterator[Callable[..., Lab]]:
    with ExitStack() as stack:

        def make(password: str = "") -> Lab:
            lab = Lab(tmp_path / "lab", scene_file, password)
            stack.callback(lab.stop)
            return lab

        yield make


@pytest.fixture
def lab(make_lab: Callable[..., Lab]) -> Lab:
    return make_lab()
