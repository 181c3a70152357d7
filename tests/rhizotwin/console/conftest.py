"""A console of a small emulated rig, served on this computer."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from rhizotwin.console import client
from rhizotwin.console.access import Access
from rhizotwin.console.console import Console
from rhizotwin.console.serve import serve
from rhizotwin.scenes.files import save_scene
from rhizotwin.steps import rigs
from rhizotwin.timelapse.experiment import Experiment
from tests.rhizotwin.timelapse.conftest import small_scene

ROOT = Path(__file__).resolve().parents[3]
VIEWS = 4
TWIN = rigs.TwinPictures(fidelity="sketch", profile="clean", seed=2)


@contextmanager
def console_process(*words: object, port: int, stderr: int | None = None) -> Iterator[tuple[subprocess.Popen[str], list[str]]]:
    """Run `rhizotwin console` in a process of its own, killed at the end; return it and the lines it printed, the last its address."""
    command = [sys.executable, "-m", "rhizotwin", "console", *map(str, words), "--no-browser", "--port", str(port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, text=True, cwd=ROOT) as process:
        try:
            assert process.stdout is not None
            printed = [""]
            while not printed[-1].startswith("http"):
                printed.append(next(process.stdout).strip())
            yield process, printed
        finally:
            process.kill()


class Lab:
    """Served consoles in a folder; `stop` ends the latest one, and `start` starts another."""

    def __init__(self, folder: Path, scene: Path, *, password: str = "", experiment: Experiment | None = None) -> None:
        self.folder, self._scene, self._password, self._experiment = folder, scene, password, experiment
        self._stack = ExitStack()
        self.stop = self._stack.close
        self.start()

    def start(self) -> None:
        """Start a console in the folder."""
        self.bench = rigs.open_bench(rigs.TWIN, str(self._scene), errors=TWIN)
        self.console = Console(self.bench, self.folder, experiment=self._experiment)
        self._stack.callback(self.console.close)
        self.served = serve(self.console, Access(password=self._password), host="127.0.0.1", port=8760)
        self._stack.callback(self.served.stop)

    def client(self, name: str = "") -> client.Console:
        """Return a client, in control if it has a name."""
        made = client.Console(self.served.address)
        if name:
            made.take_control(name)
        return made


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    save_scene(small_scene(VIEWS), tmp_path / "scene.toml")
    return tmp_path / "scene.toml"


@pytest.fixture
def make_lab(tmp_path: Path, scene_file: Path) -> Iterator[Callable[..., Lab]]:
    """Return a maker of served consoles; its keywords are those of `Lab`."""
    with ExitStack() as stack:

        def make(folder: Path = tmp_path / "lab", **options: Any) -> Lab:
            lab = Lab(folder, scene_file, **options)
            stack.callback(lab.stop)
            return lab

        yield make


@pytest.fixture
def lab(make_lab: Callable[..., Lab]) -> Lab:
    return make_lab()
