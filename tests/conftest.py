"""The engine, started once (Mitsuba's variant is the one global state of the project), and one small scan with its result for all tests."""

import functools
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hypothesis
import pytest
import trimesh
from xdist.scheduler import LoadFileScheduling

from rhizotwin import engine
from rhizotwin.commands import cli
from rhizotwin.recon.results import result
from tests.command import Command

ROOT = Path(__file__).resolve().parents[1]

# How long a case takes says nothing on a busy machine. In CI the cases are the same every time, so that a failure is due to the change.
hypothesis.settings.register_profile("any machine", deadline=None, derandomize="RHIZOTWIN_CI" in os.environ)
hypothesis.settings.load_profile("any machine")


def pytest_sessionstart() -> None:
    """Choose the engine before any module of tests imports Dr.Jit, which loads the first LLVM it finds at its import.

    The CPU, unless RHIZOTWIN_TEST_DEVICE says cuda.
    """
    engine.start(os.environ.get("RHIZOTWIN_TEST_DEVICE", "cpu"))


@functools.cache
def shares_the_scan(file: Path) -> bool:
    """Tell whether a file has tests that take the shared scan or its result."""
    return re.search(r"\b(made: Path|found: (Reconstructed|Any))\b", file.read_text(encoding="utf-8")) is not None


class ByFile(LoadFileScheduling):
    """Run each file in one process, and those that share one scan in the same: the scan is rendered and reconstructed once."""

    def _split_scope(self, nodeid: str) -> str:
        file: str = super()._split_scope(nodeid)
        return "shared scan" if shares_the_scan(ROOT / file) else file


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> ByFile:
    return ByFile(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with files that share one scan and with slow ones, so that no process waits for another at the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: (not shares_the_scan(item.path), item.path not in slow))


@pytest.fixture(scope="session", autouse=True)
def nothing_flushed() -> Iterator[None]:
    """Leave out what only a power cut would need: flushing to a disk is most of the time of tests that write files."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture
def command(capfd: pytest.CaptureFixture[str]) -> Command:
    return Command(capfd)


@pytest.fixture(scope="module")
def coarse_ball() -> Iterator[None]:
    """Make balls of 5120 faces, not of 81920, for tests in whose pictures that makes no difference."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rhizotwin.sim.specimen.SPHERE_SUBDIVISIONS", 4)
        yield


@dataclass(frozen=True)
class Reconstructed:
    """A result folder with its stages, and the result in memory that was written to it."""

    folder: Path
    result: result.Result


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Simulate a small dataset once for all: a ball beside the axis, whose silhouette goes about in the pictures."""
    folder = tmp_path_factory.mktemp("made")
    ball = trimesh.creation.icosphere(subdivisions=3, radius=8.0)
    ball.apply_translation((18.0, 0.0, -60.0))
    ball.export(folder / "ball.stl")
    words = ["--specimen", str(folder / "ball.stl"), "--views", "10", "--image-wh", "320x240", "--device", "cpu"]
    assert cli.main(["simulate", "sphere_20mm", "-o", str(folder / "dataset"), *words]) == 0
    return folder / "dataset"


@pytest.fixture(scope="session")
def found(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Reconstructed:
    """Reconstruct it, once for all."""
    folder = tmp_path_factory.mktemp("found") / "result"
    kept: list[result.Result] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(result.Result, "save", lambda made, folder, save=result.Result.save: (kept.append(made), save(made, folder)))
        words = ["reconstruct", str(made), "-o", str(folder), "--device", "cpu", "--voxel-mm", "1", "--keep-stages"]
        assert cli.main(words) == 0
    return Reconstructed(folder, kept[0])
