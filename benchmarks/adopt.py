"""Take rendered datasets from elsewhere into the cache, if and only if they are what it would render."""

import os
import shutil
import tempfile
from pathlib import Path

from benchmarks import datasets
from benchmarks.cases import Pictures
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.scenes.errors import UserError


def adopt(folder: Path) -> Path:
    """Put a dataset into the cache under its key and return its place there.

    The files are linked where the disk allows it.

    It fits when the simulator takes it up as a set of its own (scene, plant, profile, seed, libraries), renders the
    first view of each ring anew, and ends with the same manifest, which holds the hash of every picture: then plant,
    disturbances and renderer do the same as when it was made. The truth is written anew.

    Raises
    ------
    UserError
        Where it does not fit, with what differs.
    """
    dataset = load_dataset(folder)
    pictures = pictures_of(dataset)
    goal = datasets.place(pictures)
    if not goal.is_dir():
        goal.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="adopting-", dir=goal.parent) as working:
            copy = Path(working) / "dataset"
            shutil.copytree(folder, copy, copy_function=_link)
            _render_firsts(copy, dataset, pictures)
            copy.rename(goal)
        datasets.sign(goal)
    return datasets.make(pictures)


def pictures_of(dataset: Dataset) -> Pictures:
    """Return what a dataset should be a rendering of, by its manifest.

    UserError where that is nothing of the ladder's kind.
    """
    scene, origin = dataset.scene, dataset.origin
    rings = len(scene.plan.rings)
    if dataset.seed is None or not isinstance(origin.get("profile"), str) or rings not in (1, 2):
        raise UserError(f"{dataset.folder}: is no rendering of one or two rings by `rhizotwin simulate`")
    return Pictures(
        scene=scene.name,
        profile=origin["profile"],
        rings=2 if rings == 2 else 1,
        views=scene.plan.rings[0].views,
        image_wh=scene.camera.image_wh,
        seed=dataset.seed,
    )


def _render_firsts(copy: Path, dataset: Dataset, pictures: Pictures) -> None:
    """Let the simulator render the first view of each ring of a copy again and write its truth.

    UserError where something differs.
    """
    from rhizotwin.sim.simulate import CannotContinueError, simulate

    before = load_dataset(copy)
    firsts = {frame.ring: frame for frame in reversed(before.frames)}
    for frame in firsts.values():
        (copy / frame.file).unlink(missing_ok=True)
    try:
        after = simulate(pictures.scene_to_render(), copy, profile_name=pictures.profile, seed=pictures.seed)
    except CannotContinueError as error:
        raise UserError(f"{dataset.folder} does not fit: {str(error).replace(str(copy), 'it')}") from None
    if after.scene != before.scene:
        raise UserError(f"{dataset.folder}: its rig or plan is not that of {pictures.name}")
    differing = [frame.file for frame, old in zip(after.frames, before.frames, strict=True) if frame.sha256 != old.sha256]
    if differing:
        raise UserError(f"{dataset.folder}: {differing[0]} comes out otherwise when it is rendered now")


def _link(source: str, target: str) -> None:
    """Give a file a second name, or copy it where that is not possible.

    Pictures are replaced and never written into.
    """
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
