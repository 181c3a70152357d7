"""Faults that are injected into commands, and copies of the shared scan to be spoilt."""

import errno
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.files import save_scene
from tests.conftest import Reconstructed


@dataclass
class FailingAt:
    """Stands before a function and raises an error at one of its calls; from there on at each, where the error stays."""

    function: Callable[..., Any]
    at: int
    error: BaseException
    stays: bool = False
    calls: int = field(default=0)

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Count, then raise or call."""
        self.calls += 1
        if self.calls == self.at or (self.stays and self.calls > self.at):
            raise self.error
        return self.function(*arguments, **options)


class Fault:
    """Makes functions fail until `mend`."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.patch = patch

    def full_disk(self, target: Any, name: str, *, at: int) -> FailingAt:
        """Let nothing fit on the disk from a call on."""
        return self._set(target, name, FailingAt(getattr(target, name), at, OSError(errno.ENOSPC, "No space left on device"), stays=True))

    def stop(self, target: Any, name: str, *, at: int = 1) -> FailingAt:
        """Press Ctrl-C at a call."""
        return self._set(target, name, FailingAt(getattr(target, name), at, KeyboardInterrupt()))

    def mend(self) -> None:
        """Undo all."""
        self.patch.undo()

    def _set(self, target: Any, name: str, fault: FailingAt) -> FailingAt:
        # a plain function, so that it is bound where it stands for a method
        self.patch.setattr(target, name, lambda *arguments, **options: fault(*arguments, **options))
        return fault


@pytest.fixture
def fault() -> Any:
    with pytest.MonkeyPatch.context() as patch:
        yield Fault(patch)


@pytest.fixture
def dataset(made: Path, tmp_path: Path) -> Path:
    """Return a copy to be spoilt, without its truth, which only `score` may need."""
    return Path(shutil.copytree(made, tmp_path / "dataset", ignore=shutil.ignore_patterns("truth")))


@pytest.fixture
def scan(made: Path, found: Reconstructed, tmp_path: Path) -> Path:
    """Return a folder with copies of the dataset, its truth, and its result."""
    shutil.copytree(made, tmp_path / "dataset")
    shutil.copytree(found.folder, tmp_path / "result")
    return tmp_path


@pytest.fixture
def rig(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file of the scene without its specimen's file, for `import`."""
    path = tmp_path_factory.mktemp("rig") / "rig.toml"
    save_scene(load_dataset(made).scene, path)
    return path


@pytest.fixture
def change_manifest() -> Callable[[Path, Callable[[dict[str, Any]], object]], None]:
    """Return what changes a dataset.json; pictures may differ from the recorded ones then."""

    def change(dataset: Path, edit: Callable[[dict[str, Any]], object]) -> None:
        path = dataset / "dataset.json"
        content = json.loads(path.read_text(encoding="utf-8"))
        for frame in content["frames"]:
            frame["sha256"] = ""
        edit(content)
        path.write_text(json.dumps(content), encoding="utf-8")

    return change
