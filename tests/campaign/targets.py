"""What the campaign kills: commands that write, what must be true after a kill, and when they have ended."""
# ruff: noqa: D102 - overridden methods are described once

import json
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

from rhizotwin.catalogue.store import Catalogue
from rhizotwin.catalogue.verify import check
from rhizotwin.scenes.dataset import file_sha256, load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.stored.load import load_result
from rhizotwin.timelapse.experiment import load_experiment
from rhizotwin.timelapse.runner import outcome_of
from tests.rhizotwin.timelapse.conftest import write_experiment

SMALL = ("--views", 10, "--image-wh", "320x240", "--profile", "clean")
BENCH_CASES = 3
BENCH = f"""
import shutil, sys
from dataclasses import replace
from rhizotwin.commands import cli
from rhizotwin.bench import benchmarks, run_method
ball = benchmarks.Case(name="", scene="sphere_20mm", profile="clean", views=10, image_wh=(320, 240), seed=0)
cases = tuple(replace(ball, name=f"ball{{k}}") for k in range({BENCH_CASES}))
benchmarks.BENCHMARKS["tiny-1"] = benchmarks.Benchmark(name="tiny-1", description="balls", cases=cases)
run_method.offer = lambda found, goal, **_: shutil.copytree(found, goal)
sys.exit(cli.main(sys.argv[1:]))
"""
"""A benchmark of three small cases, whose cameras are not estimated."""
METHOD = """
import os, shutil, sys, time
time.sleep(0.5)
os.makedirs(sys.argv[3], exist_ok=True)
shutil.copy(sys.argv[1], sys.argv[3] + "/shape.ply")
"""


@dataclass
class Target:
    """Command that is killed in a folder of its own."""

    work: Path
    """Folder of the command, which does not exist yet."""
    ball: Path
    """Dataset of a small ball, and its result in the folder beside it."""
    kept: dict[Path, str] = field(default_factory=dict)
    """SHA-256 of each file that must never change again."""

    def words(self) -> list[object]:
        """Prepare the folder, and return the command line."""
        raise NotImplementedError

    def parts(self) -> list[Path]:
        """Return the files that are complete; raise an error if the folder is damaged."""
        raise NotImplementedError

    def ended(self) -> None:
        """Raise an error unless everything is there."""
        raise NotImplementedError

    def lost(self) -> list[str]:
        """Return which complete files were lost or changed since the last call."""
        changed = [f"{path} was changed" for path, digest in self.kept.items() if not path.is_file() or file_sha256(path) != digest]
        self.kept = {path: file_sha256(path) for path in self.parts()}
        return changed


class Catalogues(Target):
    """Addition of scans and results to a catalogue."""

    def words(self) -> list[object]:
        for number in range(6):
            shutil.copytree(self.ball, self.work / "scans" / f"P{number}")
            shutil.copytree(self.ball.with_name("result"), self.work / "results" / f"P{number}")
        return ["catalogue", "add", self.work / "my.rhizotwin", self.work / "scans", self.work / "results"]

    def parts(self) -> list[Path]:
        path = self.work / "my.rhizotwin"
        if path.is_file() and path.stat().st_size:
            with Catalogue.open_or_create(path) as catalogue:
                found = [one for one in check(catalogue, pictures=False) if one.kind != "unlisted"]
            assert not found, found
        return []

    def ended(self) -> None:
        with Catalogue.open(self.work / "my.rhizotwin") as catalogue:
            assert (len(catalogue.scans()), check(catalogue)) == (6, [])


class TimeLapse(Target):
    """Time-lapse of two plants."""

    def words(self) -> list[object]:
        self.work.mkdir()
        return ["timelapse", "run", write_experiment(self.work, rounds=3), "--quiet"]

    def parts(self) -> list[Path]:
        datasets = [load_dataset(head.parent) for head in self.work.glob("scans/*/dataset.json")]
        return [dataset.folder / frame.file for dataset in datasets for frame in dataset.frames]

    def ended(self) -> None:
        experiment = load_experiment(self.work / "experiment.toml")
        with Catalogue.open(experiment.catalogue_path) as catalogue:
            outcome = outcome_of(experiment, catalogue)
            assert (outcome.scanned, outcome.missed, check(catalogue)) == (6, (), [])


class Reconstruct(Target):
    """Reconstruction, over an earlier result in every second folder."""

    def words(self) -> list[object]:
        self.work.mkdir()
        if int(self.work.name) % 2:
            shutil.copytree(self.ball.with_name("result"), self.work / "result")
        return ["reconstruct", self.ball, "-o", self.work / "result", "--voxel-mm", 2, "--quiet"]

    def parts(self) -> list[Path]:
        if (self.work / "result" / "result.json").is_file():
            load_result(self.work / "result")
        return []

    def ended(self) -> None:
        load_result(self.work / "result")
        assert not list(self.work.rglob(".rhizotwin-*")), list(self.work.rglob(".rhizotwin-*"))


class Batch(Target):
    """Reconstruction of three scans."""

    def words(self) -> list[object]:
        for number in range(3):
            shutil.copytree(self.ball, self.work / "scans" / f"P{number}")
        return ["batch", self.work / "scans", "-o", self.work / "results", "--voxel-mm", 2, "--workers", 1]

    def parts(self) -> list[Path]:
        heads = list(self.work.glob("results/P*/result.json"))
        for head in heads:
            load_result(head.parent)
        return heads

    def ended(self) -> None:
        assert len(self.parts()) == 3


class BenchRun(Target):
    """Benchmark of three cases with a foreign method, which ends half a second after its start."""

    def words(self) -> list[object]:
        for number in range(BENCH_CASES):
            shutil.copytree(self.ball, self.work / "sets" / f"ball{number}")
        shutil.copy(self.ball.with_name("result") / "shape.ply", self.work)
        (self.work / "method.py").write_text(METHOD)
        method = shlex.join([sys.executable, str(self.work / "method.py"), str(self.work / "shape.ply"), "{dataset}", "{output}"])
        return ["bench", "run", "tiny-1", self.work / "sets", "--method", method, "-o", self.work / "mine.json", "--cameras", "true"]

    def rows(self) -> list[str]:
        """Return the names of the finished cases."""
        path = self.work / "mine.json"
        rows = json.loads(path.read_text())["rows"] if path.is_file() else []
        assert all(row["state"] == "done" for row in rows), rows
        return [row["case"] for row in rows]

    def lost(self) -> list[str]:
        before, now = getattr(self, "before", []), self.rows()
        self.before = now
        return [f"{case} was lost" for case in before if case not in now]

    def ended(self) -> None:
        assert len(self.rows()) == BENCH_CASES


TARGETS: dict[str, type[Target]] = {
    "catalogue": Catalogues,
    "time-lapse": TimeLapse,
    "reconstruct": Reconstruct,
    "batch": Batch,
    "bench run": BenchRun,
}


def make_ball(folder: Path) -> Path:
    """Render a small ball, reconstruct it, and return its dataset; a console can reconstruct it as well."""
    folder.mkdir(parents=True)
    for words in (
        ("simulate", "sphere_20mm", *SMALL, "-o", folder / "ball", "--quiet"),
        ("reconstruct", folder / "ball", "-o", folder / "result", "--voxel-mm", 2, "--quiet"),
    ):
        done = subprocess.run([sys.executable, "-m", "rhizotwin", *map(str, words)], capture_output=True, text=True, check=False)
        if done.returncode:
            raise UserError(done.stderr)
    return folder / "ball"
