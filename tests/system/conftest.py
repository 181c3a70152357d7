"""Faults that are injected into commands, and copies of the shared scan to be spoilt."""

import errno
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.files import save_scene
from tests.conftest import Reconstructed


class Fault:
    """Makes functions fail until `mend`, and counts their calls."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.patch, self.mend = patch, patch.undo

    def full_disk(self, target: Any, name: str, *, at: int) -> SimpleNamespace:
        """Let nothing fit on the disk from a call on."""
        return self._set(target, name, at, OSError(errno.ENOSPC, "No space left on device"))

    def stop(self, target: Any, name: str, *, at: int = 1) -> SimpleNamespace:
        """Press Ctrl-C at a call."""
        return self._set(target, name, at, KeyboardInterrupt())

    def _set(self, target: Any, name: str, at: int, error: BaseException) -> SimpleNamespace:
        function, fault = getattr(target, name), SimpleNamespace(calls=0)

        def failing(*arguments: Any, **options: Any) -> Any:
            fault.calls += 1
            if fault.calls == at or (fault.calls > at and isinstance(error, OSError)):
                raise error
            return function(*arguments, **options)

        self.patch.setattr(target, name, failing)
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
