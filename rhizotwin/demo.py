"""Demonstration: a small printed root is simulated, reconstructed from its pictures and scored."""

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
"""Odd, because opposite views of an even ring show nearly the same outline."""
IMAGE_WH = (800, 600)
VOXEL_MM = 0.27


def demo(folder: Path, *, profile: str, say: Callable[[str], None], progress: Progress) -> None:
    """Run the demonstration in a folder; a finished one is replaced, an interrupted one continued.

    Parameters
    ----------
    folder : Path
        Output folder for ``dataset``, ``result`` and ``score.json``.
    profile : str
        Error profile, see `scenes.files.load_profile`.
    say : callable
        Receives each line of output.
    progress : Progress
        Progress output.

    Raises
    ------
    UserError
        If the folder contains anything but an earlier demonstration.
    """
    with lock_folder(folder):
        _demo(folder, profile=profile, say=say, progress=progress)


def _demo(folder: Path, *, profile: str, say: Callable[[str], None], progress: Progress) -> None:
    """Implement `demo` in a locked folder."""
    from rhizotwin.scoring.score import score
    from rhizotwin.sim.simulate import CannotContinueError, simulate

    _clear(folder)
    dataset, result = folder / "dataset", folder / "result"
    scene = change_scene(files.load_scene(SCENE), views=VIEWS, image_wh=IMAGE_WH, profile=profile)
    say(f"1. rendering {VIEWS} views of {SCENE} ({IMAGE_WH[0]}x{IMAGE_WH[1]} pixels) through air, acrylic and water")
    with progress.bar(render=1.0) as bar:
        try:
            simulate(scene, dataset, profile_name=profile, seed=0, monitor=bar)
        except CannotContinueError:  # interrupted with another profile or version
            _remove(dataset)
            simulate(scene, dataset, profile_name=profile, seed=0, monitor=bar)
    say("2. reconstructing the root from the pictures")
    pictures = reconstruct_whole(dataset, result, settings=settings_of(None, voxel_mm=VOXEL_MM), progress=progress)
    say("3. comparing the result with the ground truth")
    with progress.bar(score=1.0) as bar, bar.stage("score"):
        found = score(result, dataset)
    write_json(folder / "score.json", found.to_dict())
    say("")
    say(found.table())
    say("")
    say("pictures of the result:")
    for path in pictures:
        say(f"  {path}")
    say(f"all scores: {folder / 'score.json'}")
    say(f"simulated pictures: {dataset / 'images'}")
    say(f"report: {result / 'report.html'}")
    say(f"next: rhizotwin view {result}")
    say("or:   rhizotwin scenes")


def _clear(folder: Path) -> None:
    """Remove a finished demonstration, or an interrupted one except for its dataset.

    A folder with other contents is rejected.
    """
    known = {"dataset", "result", "score.json"}
    if any(name not in known for name in contents(folder)):
        raise UserError(f"{folder} contains files that do not belong to an earlier demo; choose another folder with -o")
    dataset = folder / "dataset"
    if any(path.is_file() for path in dataset.rglob("*")) and not (dataset / "truth" / "simulate.json").is_file():
        raise UserError(f"{dataset} was not written by the demo; choose another folder with -o")
    _remove(folder / "result")
    if (folder / "score.json").exists():  # written last, removed last
        _remove(dataset)
        (folder / "score.json").unlink()


def _remove(folder: Path) -> None:
    """Remove a folder, and the remains of an interrupted removal.

    An interruption leaves no incomplete folder under the name.
    """
    if folder.exists():
        folder.rename(temporary_path(folder))
    for path in folder.parent.glob(".*.tmp"):
        shutil.rmtree(path, ignore_errors=True)
