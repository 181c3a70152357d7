"""The demonstration: a small printed root, simulated, reconstructed from its pictures and scored."""

import shutil
from collections.abc import Callable
from pathlib import Path

from rhizotwin.arguments import Progress
from rhizotwin.command_steps import reconstruct_whole, settings_of
from rhizotwin.scene_changes import change_scene
from rhizotwin.scenes import files
from rhizotwin.scenes.atomic import temporary_path, write_json
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import contents, lock_folder

SCENE = "printed_8ml"
VIEWS = 41
"""Odd: opposite views of an even ring see nearly the same outline twice."""
IMAGE_WH = (800, 600)
VOXEL_MM = 0.27


def demo(folder: Path, *, profile: str, say: Callable[[str], None], progress: Progress) -> None:
    """Run the demonstration in a folder; a finished one in it is replaced, the pictures of a stopped one are kept.

    Parameters
    ----------
    folder : Path
        Gets ``dataset``, ``result`` and ``score.json``.
    profile : str
        Disturbance profile, see `scenes.files.load_profile`.
    say : callable
        Takes each line of text for the user.
    progress : Progress
        How much is told meanwhile.

    Raises
    ------
    UserError
        If the folder holds anything else than an earlier demonstration.
    """
    with lock_folder(folder):
        _demo(folder, profile=profile, say=say, progress=progress)


def _demo(folder: Path, *, profile: str, say: Callable[[str], None], progress: Progress) -> None:
    """Do what `demo` says in a folder that nobody else works in."""
    from rhizotwin.scoring.score import score
    from rhizotwin.sim.simulate import CannotContinueError, simulate

    _clear(folder)
    dataset, result = folder / "dataset", folder / "result"
    scene = change_scene(files.load_scene(SCENE), views=VIEWS, image_wh=IMAGE_WH, profile=profile)
    say(f"1. {SCENE}: rendering {VIEWS} views of {IMAGE_WH[0]}x{IMAGE_WH[1]} pixels through air, acrylic and water")
    with progress.bar(render=1.0) as bar:
        try:
            simulate(scene, dataset, profile_name=profile, seed=0, monitor=bar)
        except CannotContinueError:  # stopped with another profile or program
            _remove(dataset)
            simulate(scene, dataset, profile_name=profile, seed=0, monitor=bar)
    say("2. reconstructing it from the pictures alone")
    pictures = reconstruct_whole(dataset, result, settings=settings_of(None, voxel_mm=VOXEL_MM), progress=progress)
    say("3. comparing it with the truth")
    with progress.bar(score=1.0) as bar, bar.stage("score"):
        found = score(result, dataset)
    write_json(folder / "score.json", found.to_dict())
    say("")
    say(found.table())
    say("")
    say("pictures to look at:")
    for path in pictures:
        say(f"  {path}")
    say(f"every number: {folder / 'score.json'}")
    say(f"what the camera saw: {dataset / 'images'}")
    say(f"one page with all of it: {result / 'report.html'}")
    say(f"next: rhizotwin view {result}")
    say("or:   rhizotwin scenes")


def _clear(folder: Path) -> None:
    """Remove a finished demonstration, of a stopped one all but its dataset.

    Refuse a folder that holds anything else.
    """
    known = {"dataset", "result", "score.json"}
    if any(name not in known for name in contents(folder)):
        raise UserError(f"{folder} holds something that is no earlier demo; choose another folder with -o")
    dataset = folder / "dataset"
    if any(path.is_file() for path in dataset.rglob("*")) and not (dataset / "truth" / "simulate.json").is_file():
        raise UserError(f"{dataset} was not made by the demo; choose another folder with -o")
    _remove(folder / "result")
    if (folder / "score.json").exists():  # written last, removed last
        _remove(dataset)
        (folder / "score.json").unlink()


def _remove(folder: Path) -> None:
    """Remove a folder, and what a stop left of an earlier removal.

    A stop leaves nothing half-removed under the name.
    """
    if folder.exists():
        folder.rename(temporary_path(folder))
    for path in folder.parent.glob(".*.tmp"):
        shutil.rmtree(path, ignore_errors=True)
