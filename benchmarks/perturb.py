"""Harmless changes of pictures, under which results should not change, and a real loss of accuracy.

Two processors render the same picture to about one part in 10^6 of full scale; where this crosses a step of the
camera's converter, the stored value differs. Therefore a few pixels in a thousand are changed by one step, and given
camera poses by 10^-6 mm. Kernels also round differently: those of Dr.Jit are compiled with vectors of another width.
"""

import ctypes
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import atomic
from rhizotwin.scenes.dataset import Dataset, Frame, file_sha256, load_dataset, read_image, save_dataset
from rhizotwin.scenes.picture_codec import Grey, decode_grey
from rhizotwin.scenes.transfer import LINEAR

LIGHT = 1e-6
"""Maximum difference of two renderings, as a fraction of full scale."""
POSE_MM = 1e-6
DITHER = 0.5
"""Standard deviation of `write_dithered`, in steps of the camera's converter."""
MIRRORED = 20
"""One in this number of pictures is mirrored by `write_lossy`."""


def write_rounded(dataset_folder: Path, folder: Path, *, seed: int) -> Dataset:
    """Write a dataset with the rounding of another machine.

    Parameters
    ----------
    dataset_folder : Path
        Folder of the original dataset, which is not changed.
    folder : path
        New folder; its truth is a link to that of the original.
    seed : int
        Random seed (1, 2, ...) of the rounding. Picture k does not depend on the others.

    Returns
    -------
    Dataset
        Written dataset.
    """

    def one(number: int, frame: Frame, image: Grey) -> tuple[Frame, Grey]:
        rng = np.random.default_rng([seed, number])
        image = perturb_rounding(image, rng)
        if frame.cam_from_canister is not None:
            pose = np.array(frame.cam_from_canister)
            pose[:3, 3] += rng.uniform(-POSE_MM, POSE_MM, 3)
            frame = replace(frame, cam_from_canister=tuple(tuple(map(float, row)) for row in pose))
        return frame, image

    return _write_dataset(dataset_folder, folder, one)


def halve_vectors() -> str:
    """Let Dr.Jit compile its LLVM kernels with vectors of half the width (for 4: twice).

    They fuse and approximate operations differently. Fused multiply-add is required, so that processors without it
    cannot be simulated. ``jit_llvm_set_target`` is in the public header (``drjit-core/jit.h``), but only available in
    the C++ library.

    Returns
    -------
    str
        Description of the vectors in use.
    """
    import drjit as dr
    import mitsuba as mi

    libraries = sorted(Path(dr.__file__).parent.glob("libdrjit-core.*"))
    if not libraries or not mi.variant().startswith("llvm"):
        return "default vectors: not LLVM on this machine"
    library = ctypes.CDLL(str(libraries[0]))
    try:
        width, processor = library._Z21jit_llvm_vector_widthv, library._Z19jit_llvm_target_cpuv
        set_target = library._Z19jit_llvm_set_targetPKcS0_j
    except AttributeError:
        return "default vectors: this version of Dr.Jit has no jit_llvm_set_target"
    processor.restype = ctypes.c_char_p
    set_target.argtypes = [ctypes.c_char_p, ctypes.c_char_p, ctypes.c_uint32]
    set_target(processor(), None, 8 if width() == 4 else width() // 2)
    return f"vectors of {width()}"


def write_lossy(dataset_folder: Path, folder: Path, *, seed: int) -> Dataset:
    """Write a rendered dataset with one picture in twenty mirrored.

    Pictures are mirrored left to right, from the roots' top row downwards.

    The markers above are not changed, so that the camera is correct, but the picture carves wrongly.

    Parameters
    ----------
    dataset_folder : Path
        Folder of the original dataset, which is not changed.
    folder : Path
        New folder.
    seed : int
        Random seed (1, 2, ...) of the mirrored pictures.

    Returns
    -------
    Dataset
        Written dataset.
    """
    count = len(load_dataset(dataset_folder).frames)
    chosen = set(np.random.default_rng(seed).choice(count, max(1, count // MIRRORED), replace=False).tolist())

    def one(number: int, frame: Frame, image: Grey) -> tuple[Frame, Grey]:
        if number not in chosen:
            return frame, image
        mask_path = dataset_folder / "truth" / "masks" / Path(frame.file).name
        top = int(np.flatnonzero(decode_grey(mask_path.read_bytes(), where=str(mask_path)).any(axis=1))[0])
        return frame, np.concatenate([image[:top], image[top:, ::-1]])

    return _write_dataset(dataset_folder, folder, one)


def write_dithered(dataset_folder: Path, folder: Path, *, seed: int) -> Dataset:
    """Write a dataset with additional noise of half a grey level.

    Parameters
    ----------
    dataset_folder : Path
        Folder of the original dataset, which is not changed.
    folder : Path
        New folder.
    seed : int
        Random seed (1, 2, ...).

    Returns
    -------
    Dataset
        Written dataset.
    """

    def one(number: int, frame: Frame, image: Grey) -> tuple[Frame, Grey]:
        noise = np.random.default_rng([seed, number]).normal(0.0, DITHER, image.shape)
        return frame, _move(image, np.round(noise).astype(np.int64))

    return _write_dataset(dataset_folder, folder, one)


def write_shuffled(dataset_folder: Path, folder: Path, *, seed: int) -> Dataset:
    """Write a dataset with its pictures in random order.

    Parameters
    ----------
    dataset_folder : Path
        Folder of the original dataset, which is not changed.
    folder : Path
        New folder.
    seed : int
        Random seed (1, 2, ...).

    Returns
    -------
    Dataset
        Written dataset.
    """
    written = _write_dataset(dataset_folder, folder, lambda _number, frame, image: (frame, image))
    order = np.random.default_rng(seed).permutation(len(written.frames))
    shuffled = replace(written, frames=tuple(written.frames[k] for k in order))
    save_dataset(shuffled)
    return shuffled


WRITERS: dict[str, Callable[..., Dataset]] = {
    "rounded": write_rounded,
    "dithered": write_dithered,
    "shuffled": write_shuffled,
    "lossy": write_lossy,
}
"""Changes of pictures by their names."""


def perturb_rounding(image: Grey, rng: np.random.Generator) -> Grey:
    """Return a picture (H, W) whose light differed by up to `LIGHT` of full scale before rounding.

    The converter's step is the lowest bit that the picture uses. A value changes by one step with the probability that
    the border between two steps is within the difference: on average half of `LIGHT` over the step.
    """
    changed = rng.random(image.shape) < 0.5 * LIGHT * np.iinfo(image.dtype).max / _step(image)
    return _move(image, np.where(changed, rng.choice([-1, 1], image.shape), 0))


def _step(image: Grey) -> int:
    used = int(np.bitwise_or.reduce(image, axis=None)) or 1
    return used & -used


def _move(image: Grey, steps: NDArray[np.int64]) -> Grey:
    """Add steps (H, W) of the converter to a picture (H, W)."""
    full, step = np.iinfo(image.dtype).max, _step(image)
    return np.clip(image.astype(np.int64) + step * steps, 0, full - full % step).astype(image.dtype)


def _write_dataset(dataset_folder: Path, folder: Path, one: Callable[[int, Frame, Grey], tuple[Frame, Grey]]) -> Dataset:
    dataset, frames = load_dataset(dataset_folder), []
    for number, before in enumerate(dataset.frames):
        frame, image = one(number, before, read_image(dataset, before, curve=LINEAR))
        path = folder / frame.file
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic.write_image(path, image)
        frames.append(replace(frame, sha256=file_sha256(path)))
    truth = dataset_folder / "truth"
    if truth.is_dir():
        shutil.copytree(truth, folder / "truth")
    written = replace(dataset, folder=folder, frames=tuple(frames))
    save_dataset(written)
    return written
