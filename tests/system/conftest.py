"""One small dataset for all system tests, and the command line run in this process."""

import errno
import json
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import trimesh

from rhizotwin import cli
from rhizotwin.recon.results import result

VIEWS = 10


@dataclass(frozen=True)
class Outcome:
    """How a command ended."""

    code: int
    out: str
    err: str
    sentence: str
    """The line on stderr that is the program's own."""


STAGE = re.compile(r"[a-z ]+: \d+\.\d s")


class Command:
    """The command line, with everything it printed: also what libraries write past Python."""

    def __init__(self, capfd: pytest.CaptureFixture[str]) -> None:
        self.capfd = capfd

    def __call__(self, *words: object) -> Outcome:
        """Run a command line."""
        self.capfd.readouterr()
        code = cli.main([str(word) for word in words])
        out, err = self.capfd.readouterr()
        said = [line for line in err.splitlines() if line.startswith("rhizotwin: ")]
        return Outcome(code, out, err, said[-1] if said else "")

    def works(self, *words: object) -> Outcome:
        """Run a command line that must succeed."""
        done = self(*words)
        assert done.code == 0, done.err
        return done

    def fails(self, *words: object, named: Sequence[object], code: int = cli.EXIT_MISTAKE) -> Outcome:
        """Run a command line that must fail in one sentence that holds every word of ``named``."""
        done = self(*words)
        assert done.code == code, done.err + done.out
        # bars apart, and the line that each stage leaves where nothing moves
        rest = [line for line in done.err.splitlines() if line and "%|" not in line and not STAGE.fullmatch(line)]
        assert rest == [done.sentence], done.err
        assert "unexpected error" not in done.sentence
        for name in named:
            assert str(name) in done.sentence, f"{name!s} is not in: {done.sentence}"
        return done


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


@dataclass(frozen=True)
class Reconstructed:
    """A result folder, and the result that was written to it."""

    folder: Path
    result: result.Result


@pytest.fixture
def command(capfd: pytest.CaptureFixture[str]) -> Command:
    return Command(capfd)


@pytest.fixture
def fault() -> Any:
    with pytest.MonkeyPatch.context() as patch:
        yield Fault(patch)


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Simulate the dataset, once: a ball beside the axis, so that its silhouette goes about in the pictures."""
    folder = tmp_path_factory.mktemp("system")
    ball = trimesh.creation.icosphere(subdivisions=3, radius=8.0)
    ball.apply_translation((18.0, 0.0, -60.0))
    ball.export(folder / "ball.stl")
    words = ["--specimen", str(folder / "ball.stl"), "--views", str(VIEWS), "--image-wh", "320x240", "--device", "cpu"]
    assert cli.main(["simulate", "sphere_20mm", "-o", str(folder / "dataset"), *words]) == 0
    return folder / "dataset"


@pytest.fixture(scope="session")
def found(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Reconstructed:
    """Reconstruct the dataset, once."""
    folder = tmp_path_factory.mktemp("found") / "result"
    kept: list[result.Result] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(result.Result, "save", lambda made, folder, save=result.Result.save: (kept.append(made), save(made, folder)))
        assert cli.main(["reconstruct", str(made), "-o", str(folder), "--device", "cpu", "--voxel-mm", "2"]) == 0
    return Reconstructed(folder, kept[0])


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
    from rhizotwin.scenes.dataset import load_dataset
    from rhizotwin.scenes.files import save_scene

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
