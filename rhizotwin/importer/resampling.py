"""Resampling of pictures from their own lens to the lens of the dataset."""

from functools import cached_property

import cv2
import numpy as np

from rhizotwin.importer.given_lens import Lens
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import Camera
from rhizotwin.scenes.picture_codec import Grey

_STEP_PX = 4
"""Spacing of the pixels for which the mapping between the lenses is computed. It is interpolated linearly between them,
with an error below 0.01 px."""


class Resampler:
    """Resamples pictures with other lenses to the lens of one camera at the same place.

    Parameters
    ----------
    camera : Camera
        Camera of the resampled pictures. All of its pixels must be within the original pictures.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera = camera

    @cached_property
    def _rays(self) -> Array:
        """Rays (rows, columns, 2) of every `_STEP_PX`-th pixel of the camera."""
        u, v = (np.arange(0.0, side + _STEP_PX, _STEP_PX) for side in self._camera.image_wh)
        return Lens.of(self._camera).rays(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)).reshape(len(v), len(u), 2)

    def resample(self, picture: Grey, lens: Lens, *, masks: bool = False) -> Grey:
        """Return the picture (H, W) that the camera would have taken.

        Parameters
        ----------
        picture : (H, W) uint8 or uint16 array
            Picture, linear in light.
        lens : Lens
            Lens of the picture.
        masks : bool
            The picture is a silhouette. It is interpolated linearly, which keeps its area, instead of cubically.
        """
        px = lens.pixels(self._rays.reshape(-1, 2)).reshape(self._rays.shape).astype(np.float32)
        finer = np.array([[1.0 / _STEP_PX, 0.0, 0.0], [0.0, 1.0 / _STEP_PX, 0.0]])
        x, y = (
            cv2.warpAffine(np.ascontiguousarray(part), finer, self._camera.image_wh, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
            for part in (px[..., 0], px[..., 1])
        )
        how = cv2.INTER_LINEAR if masks else cv2.INTER_CUBIC
        return np.asarray(cv2.remap(picture, x, y, how, borderMode=cv2.BORDER_REPLICATE))
