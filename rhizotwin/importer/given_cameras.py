"""Cameras of pictures from a file of another program, and the one camera of the dataset."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from rhizotwin.importer.given_lens import Lens
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import Camera

LARGEST = 1e9
"""Upper limit of the numbers in a file, whether they are in pixels or in mm."""
LEAST_SHARED = 0.75
"""Minimum width and height of the part that the pictures of all lenses show, as a fraction of a picture's width and
height. It admits lenses that were focused differently, but not those with different focal lengths."""
_CELLS = 200
"""Number of cells along each side of a picture in the search for the part that all lenses show."""


@dataclass(frozen=True, kw_only=True)
class GivenPicture:
    """Lens and pose of one picture."""

    lens: Lens
    cam_from_canister: Array
    """Pose (4, 4) with OpenCV axes, in mm."""


@dataclass(frozen=True, kw_only=True)
class GivenCameras:
    """Lenses and camera poses of a file."""

    camera: Camera
    """Camera of the dataset. Pictures with another lens must be resampled to it."""
    pictures: Mapping[str, GivenPicture]
    """Lens and pose of each picture. The key is the file name of the picture as written in the file, with or without
    its suffix."""
    notes: tuple[str, ...] = ()
    """Sentences for the user about values that were assumed or ignored."""

    def of(self, path: Path) -> GivenPicture | None:
        """Return the lens and the pose of a picture file; None if it has none."""
        return self.pictures.get(path.name, self.pictures.get(path.stem))

    @property
    def lenses(self) -> set[Lens]:
        """Lenses of the pictures."""
        return {picture.lens for picture in self.pictures.values()}

    @property
    def picture_wh(self) -> tuple[int, int]:
        """Size of the pictures, px. That of the camera is smaller if they are resampled."""
        return next(iter(self.lenses)).image_wh

    @property
    def is_resampled(self) -> bool:
        """Whether the pictures must be resampled, because one of the lenses is not that of the camera."""
        return not all(lens.is_same(self.camera) for lens in self.lenses)


def collect_cameras(found: Iterable[tuple[str, str, GivenPicture]], camera: Camera) -> GivenCameras:
    """Collect the pictures of a file.

    Parameters
    ----------
    found : iterable of (str, str, GivenPicture)
        Path of each picture as written in the file, its place in the file for messages, and its lens and pose.
    camera : Camera
        Source of the properties that a lens does not include, such as the bit depth.

    Raises
    ------
    UserError
        If two pictures have the same file name, or see `common_camera`.
    """
    pictures: dict[str, GivenPicture] = {}
    for path, where, picture in found:
        name = PurePosixPath(path.replace("\\", "/")).name
        if name in pictures:
            raise UserError(f"{where}: the picture {name} has two cameras; each picture name must be unique")
        pictures[name] = picture
    return GivenCameras(camera=common_camera({name: picture.lens for name, picture in pictures.items()}, camera), pictures=pictures)


def common_camera(lenses: Mapping[str, Lens], other: Camera) -> Camera:
    """Return one camera for pictures with given lenses, to which pictures with another lens can be resampled.

    It is the lens of most pictures if it is one of this project's lenses, and otherwise a pinhole camera. If the lenses
    differ, it is cropped to the part that the pictures of all lenses show.

    Parameters
    ----------
    lenses : mapping of str to Lens
        Lens of each picture.
    other : Camera
        See `collect_cameras`.

    Raises
    ------
    UserError
        If the pictures have different sizes, or the lenses differ so much that all pictures share only a small part.
    """
    sizes = {lens.image_wh: name for name, lens in lenses.items()}
    if len(sizes) > 1:
        (first_wh, first), (other_wh, other_name), *_ = sizes.items()
        raise UserError(
            f"the picture {first} has {first_wh[0]}x{first_wh[1]} px, but {other_name} has {other_wh[0]}x{other_wh[1]} px; "
            "all pictures must have the same size"
        )
    most = Counter(lenses.values()).most_common(1)[0][0]
    exact = most.as_camera(other)
    if exact is not None and all(lens.is_same(exact) for lens in set(lenses.values())):
        return exact
    camera = exact or most.as_pinhole(other)
    (width, height), target = camera.image_wh, Lens.of(camera)
    u, v = (np.unique(np.round(np.linspace(0, side - 1, min(side, _CELLS)))) for side in (width, height))
    rays = target.rays(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    shown = np.ones((len(v), len(u)), bool)
    for lens, name in {lens: name for name, lens in lenses.items()}.items():
        px = lens.pixels(rays)
        with np.errstate(invalid="ignore"):
            shown &= ((px >= 0.0) & (px <= np.array(lens.image_wh) - 1.0)).all(axis=1).reshape(shown.shape)
        top, bottom, left, right = _inner(shown)
        size = int(u[right] - u[left]) + 1, int(v[bottom] - v[top]) + 1
        if min(size[0] / width, size[1] / height) < LEAST_SHARED:
            raise UserError(
                f"the lens of {name} differs too much from that of most pictures, with which it shares only {size[0]}x{size[1]} px; "
                "import only pictures of one lens"
            )
    return camera.cropped((int(u[left]), int(v[top])), size)


def _inner(shown: "np.ndarray[tuple[int, int], np.dtype[np.bool_]]") -> tuple[int, int, int, int]:
    """Return first row, last row, first column and last column of a rectangle in which all cells are True.

    Starting from the whole, the side with the largest fraction of cells that are False is moved inwards.
    """
    top = 0
    bottom = shown.shape[0] - 1
    left = 0
    right = shown.shape[1] - 1
    while top < bottom and left < right:
        across = shown[:, left : right + 1]
        down = shown[top : bottom + 1]
        share = [1.0 - float(side.mean()) for side in (across[top], across[bottom], down[:, left], down[:, right])]
        worst = int(np.argmax(share))
        if share[worst] == 0.0:
            break
        top = top + (worst == 0)
        bottom = bottom - (worst == 1)
        left = left + (worst == 2)
        right = right - (worst == 3)
    return top, bottom, left, right
