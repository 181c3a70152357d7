"""Adoption of rendered datasets into the cache, if they are identical to its own rendering."""

import os
import shutil
import tempfile
from pathlib import Path

from benchmarks import datasets
from benchmarks.cases import Pictures
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.scenes.errors import UserError


def adopt(folder: Path) -> Path:
    """Add a dataset to the cache under its key, and return its path there.

    The files are linked if the file system supports it.

    It is accepted if the simulator can resume it (same scene, plant, profile, seed, libraries), renders the first view
    of each ring again, and ends with the same manifest, which contains the hash of every picture: plant, disturbances
    and renderer are then unchanged. The truth is written again.

    Raises
    ------
    UserError
        If it does not match, with the differences.
    """
    dataset = load_dataset(folder)
    pictures = read_pictures(dataset)
    goal = datasets.place(pictures)
    if not goal.is_dir():
        goal.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="adopting-", dir=goal.parent) as working:
            copy = Path(working) / "dataset"
            shutil.copytree(folder, copy, copy_function=link)
            _render_firsts(copy, dataset, pictures)
            copy.rename(goal)
        datasets.sign(goal)
    return datasets.make(pictures)


def read_pictures(dataset: Dataset) -> Pictures:
    """Return the pictures of which a dataset is a rendering, according to its manifest.

    Raise UserError if it is not a rendering of the ladder's kind.
    """
    scene, origin = dataset.scene, dataset.origin
    rings = len(scene.plan.rings)
    if dataset.seed is None or not isinstance(origin.get("profile"), str) or rings not in (1, 2):
        raise UserError(f"{dataset.folder}: is not a rendering of one or two rings by `rhizotwin simulate`")
    return Pictures(
        scene=scene.name,
        profile=origin["profile"],
        rings=2 if rings == 2 else 1,
        views=scene.plan.rings[0].views,
        image_wh=scene.camera.image_wh,
        seed=dataset.seed,
    )


def _render_firsts(copy: Path, dataset: Dataset, pictures: Pictures) -> None:
    """Let the simulator render the first view of each ring of a copy again, and write its truth.

    Raise UserError if anything differs.
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
        raise UserError(f"{dataset.folder}: {differing[0]} differs when it is rendered again")


def link(source: str, target: str) -> None:
    """Create a hard link to a file, or copy it if that is not possible.

    Pictures are replaced, and never modified in place.
    """
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
