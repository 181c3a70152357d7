"""Demonstration that simulates pictures of a small printed root, reconstructs the root and scores the result."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rhizotwin.scenes import files
from rhizotwin.scenes.atomic import temporary_path, write_json
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.figures import FigureFormat
from rhizotwin.scenes.folders import contents, lock_folder
from rhizotwin.steps.arguments import Progress, SceneChanges
from rhizotwin.steps.command_steps import Wanted, reconstruct_whole, settings_of
from rhizotwin.steps.scene_changes import change_scene

SCENE = "printed_8ml"


@dataclass(frozen=True)
class Size:
    """Size of a demonstration."""

    views: int
    """Number of views. It is odd, because opposite views of a ring with an even number of views have nearly identical
    silhouettes."""
    image_wh: tuple[int, int]
    voxel_mm: float
    figures: FigureFormat | None


FULL = Size(41, (800, 600), 0.27, "png")
SMALL = Size(15, (400, 300), 0.5, None)


def demo(folder: Path, *, profile: str, size: Size, say: Callable[[str], None], progress: Progress) -> None:
    """Run the demonstration.

    An interrupted run in the same folder is continued, and a finished run is replaced.

    Parameters
    ----------
    folder : Path
        Output folder for ``dataset``, ``result`` and ``score.json``.
    profile : str
        Profile of simulated imperfections, see `scenes.files.load_profile`.
    size : Size
        Pictures and voxels: `FULL` or `SMALL`.
    say : callable
        Function that is called with each line of output.
    progress : Progress
        Progress output.

    Raises
    ------
    UserError
        If the folder contains files of anything other than an earlier demonstration.
    """
    with lock_folder(folder):
        _demo(folder, profile=profile, size=size, say=say, progress=progress)


def _demo(folder: Path, *, profile: str, size: Size, say: Callable[[str], None], progress: Progress) -> None:
    """Implement `demo` in a locked folder."""
    from rhizotwin.scoring.score import score
    from rhizotwin.sim.simulate import CannotContinueError, simulate

    _clear(folder)
    dataset, result = folder / "dataset", folder / "result"
    scene = change_scene(files.load_scene(SCENE), SceneChanges(views=size.views, image_wh=size.image_wh, profile=profile))
    say(f"1. rendering {size.views} views of {SCENE} ({size.image_wh[0]}x{size.image_wh[1]} pixels) through air, acrylic and water")
    with progress.bar(render=1.0) as bar:
        try:
            simulate(scene, dataset, profile_name=profile, seed=0, monitor=bar)
        except CannotContinueError:  # interrupted with another profile or version
            _remove(dataset)
            simulate(scene, dataset, profile_name=profile, seed=0, monitor=bar)
    say("2. reconstructing the root from the pictures")
    wanted = Wanted(settings=settings_of(None, voxel_mm=size.voxel_mm))
    pictures = reconstruct_whole(dataset, result, wanted, figures=size.figures, progress=progress)
    say("3. comparing the result with the ground truth")
    with progress.bar(score=1.0) as bar, bar.stage("score"):
        scores = score(result, dataset)
    write_json(folder / "score.json", scores.to_dict())
    say("")
    say(scores.table(every=False))
    say("")
    say("pictures of the result:")
    for path in pictures:
        say(f"  {path}")
    say(f"all scores: {folder / 'score.json'}")
    say(f"simulated pictures: {dataset / 'images'}")
    say(f"report: {result / 'report.html'}")
    say(f"to see the result in 3D: rhizotwin view {result}")
    say("to list other scenes: rhizotwin scenes")


def _clear(folder: Path) -> None:
    """Remove the files of an earlier demonstration.

    The dataset of an interrupted demonstration is kept.

    Raises
    ------
    UserError
        If the folder contains other files.
    """
    known = {"dataset", "result", "score.json"}
    if any(name not in known for name in contents(folder)):
        raise UserError(f"{folder} contains files that were not written by an earlier demo; choose another folder with -o")
    dataset = folder / "dataset"
    if any(path.is_file() for path in dataset.rglob("*")) and not (dataset / "truth" / "simulate.json").is_file():
        raise UserError(f"{dataset} was not written by the demo; choose another folder with -o")
    _remove(folder / "result")
    if (folder / "score.json").exists():  # written last, removed last
        _remove(dataset)
        (folder / "score.json").unlink()


def _remove(folder: Path) -> None:
    """Remove a folder, and the remains of an interrupted removal.

    The folder is renamed first, so that an interruption leaves no incomplete folder under its name.
    """
    if folder.exists():
        folder.rename(temporary_path(folder))
    for path in folder.parent.glob(".*.tmp"):
        shutil.rmtree(path, ignore_errors=True)
