"""Another machine's rounding, played on this one; and a real loss, for the gate to tell from it.

Two processors render the same picture to about one part in 10^6 of full scale: where that crosses a step of the
camera's converter, the stored number is another. So a few pixels in a thousand are moved by one step, and given camera
poses by 10^-6 mm. Their kernels round otherwise too: Dr.Jit's are made with vectors of another width.
"""

import ctypes
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from rhizotwin.scenes import atomic
from rhizotwin.scenes.dataset import Dataset, Frame, load_dataset, read_image, save_dataset, sha256_of
from rhizotwin.scenes.pictures import Grey, decode_grey
from rhizotwin.scenes.transfer import LINEAR

LIGHT = 1e-6
"""Largest difference of two renders, as a share of full scale."""
POSE_MM = 1e-6
MIRRORED = 20
"""Of so many pictures `lossy` mirrors one."""


def rounded(dataset_folder: Path, folder: Path, *, seed: int) -> Dataset:
    """Write a dataset as another machine may have rounded it.

    Parameters
    ----------
    dataset_folder : Path
        The dataset, left as it is.
    folder : path
        Where to; the truth in it is a link to the dataset's own.
    seed : int
        1, 2, ...: each rounds otherwise. Picture k does not depend on those before it.

    Returns
    -------
    Dataset
        The written dataset.
    """

    def one(number: int, frame: Frame, image: Grey) -> tuple[Frame, Grey]:
        rng = np.random.default_rng([seed, number])
        image = round_otherwise(image, rng)
        if frame.cam_from_canister is not None:
            pose = np.array(frame.cam_from_canister)
            pose[:3, 3] += rng.uniform(-POSE_MM, POSE_MM, 3)
            frame = replace(frame, cam_from_canister=tuple(tuple(map(float, row)) for row in pose))
        return frame, image

    return _written(dataset_folder, folder, one)


def other_vectors() -> str:
    """Let Dr.Jit make its LLVM kernels with vectors half as wide (of 4: twice).

    They fuse and approximate in other places.

    It needs fused multiply and add, so that a processor without it cannot be played. ``jit_llvm_set_target`` stands in
    its public header (``drjit-core/jit.h``), but only the C++ library has it.

    Returns
    -------
    What became of it, in a few words.
    """
    import drjit as dr
    import mitsuba as mi

    libraries = sorted(Path(dr.__file__).parent.glob("libdrjit-core.*"))
    if not libraries or not mi.variant().startswith("llvm"):
        return "vectors as they are: not LLVM on this machine"
    library = ctypes.CDLL(str(libraries[0]))
    try:
        width, processor = library._Z21jit_llvm_vector_widthv, library._Z19jit_llvm_target_cpuv
        set_target = library._Z19jit_llvm_set_targetPKcS0_j
    except AttributeError:
        return "vectors as they are: this version of Dr.Jit has no jit_llvm_set_target"
    processor.restype = ctypes.c_char_p
    set_target.argtypes = [ctypes.c_char_p, ctypes.c_char_p, ctypes.c_uint32]
    set_target(processor(), None, 8 if width() == 4 else width() // 2)
    return f"vectors of {width()}"


def lossy(dataset_folder: Path, folder: Path, *, seed: int) -> Dataset:
    """Write a rendered dataset of which one picture in twenty is mirrored.

    Left to right, from the root's top row downwards.

    The markers above stay as they are, so that the picture keeps its camera and carves what it should not.

    Parameters
    ----------
    dataset_folder : Path
        The dataset, left as it is.
    folder : Path
        New folder.
    seed : int
        1, 2, ...: which of the pictures.

    Returns
    -------
    Dataset
        The written dataset.
    """
    count = len(load_dataset(dataset_folder).frames)
    chosen = set(np.random.default_rng(seed).choice(count, max(1, count // MIRRORED), replace=False).tolist())

    def one(number: int, frame: Frame, image: Grey) -> tuple[Frame, Grey]:
        if number not in chosen:
            return frame, image
        mask_path = dataset_folder / "truth" / "masks" / Path(frame.file).name
        top = int(np.flatnonzero(decode_grey(mask_path.read_bytes(), where=str(mask_path)).any(axis=1))[0])
        return frame, np.concatenate([image[:top], image[top:, ::-1]])

    return _written(dataset_folder, folder, one)


def round_otherwise(image: Grey, rng: np.random.Generator) -> Grey:
    """Return a picture (H, W) whose light differed by up to `LIGHT` of full scale before it was rounded.

    The converter's step is the lowest bit that the picture uses. A number changes by one step with the chance that a
    border between two steps lies within the difference: on average half of `LIGHT` over the step.
    """
    full = np.iinfo(image.dtype).max
    used = int(np.bitwise_or.reduce(image, axis=None)) or 1
    step = used & -used
    changed = rng.random(image.shape) < 0.5 * LIGHT * full / step
    moved = image.astype(np.int64) + step * np.where(changed, rng.choice([-1, 1], image.shape), 0)
    return np.clip(moved, 0, full - full % step).astype(image.dtype)


def _written(dataset_folder: Path, folder: Path, one: Callable[[int, Frame, Grey], tuple[Frame, Grey]]) -> Dataset:
    dataset, frames = load_dataset(dataset_folder), []
    for number, before in enumerate(dataset.frames):
        frame, image = one(number, before, read_image(dataset, before, curve=LINEAR))
        path = folder / frame.file
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic.write_image(path, image)
        frames.append(replace(frame, sha256=sha256_of(path)))
    truth = dataset_folder / "truth"
    if truth.is_dir():
        shutil.copytree(truth, folder / "truth")
    written = replace(dataset, folder=folder, frames=tuple(frames))
    save_dataset(written)
    return written
