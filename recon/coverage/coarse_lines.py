"""Lines of sight of one pixel in so many each way, and what is found along them for every pixel: it is smooth."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Approach, Optics


@dataclass(frozen=True)
class CoarseLines:
    """A view's lines of sight before they meet the canister."""

    line: Approach
    """(N,)"""
    through: NDArray[np.bool_]
    """(N,) whether they come through a tank's front below the liquid's surface; in the open all do."""
    shape: tuple[int, int]
    """Rows and columns of the N."""
    step: int
    image_wh: tuple[int, int]

    @staticmethod
    def of(view: View, optics: Optics, *, step: int, beyond: bool = False) -> CoarseLines:
        """Follow the lines of sight of a view.

        Parameters
        ----------
        view : View
            Camera and pose.
        optics : Optics
            The canister's.
        step : int
            One pixel in so many each way, in the middle of its square.
        beyond : bool
            A step beyond the picture's right and lower border, too, so that nothing there is carried over.
        """
        width, height = view.camera.image_wh
        more, first = step if beyond else 0, 0.5 * step - 0.5
        u, v = np.meshgrid(np.arange(first, width + more, step), np.arange(first, height + more, step))
        directions = cameras.camera_directions(view.camera, np.stack([u.ravel(), v.ravel()], axis=1))
        return CoarseLines(*cameras.approach(view, optics, directions), (u.shape[0], u.shape[1]), step, view.camera.image_wh)

    def enlarged(self, values: NDArray[np.generic], *, nearest: bool = False) -> NDArray[np.float32]:
        """Return for every pixel (H, W) what was found for the lines (N,): interpolated, or the nearest line's."""
        return enlarged(values.reshape(self.shape), self.step, self.image_wh, nearest=nearest)


def enlarged(values: NDArray[np.generic], step: int, image_wh: tuple[int, int], *, nearest: bool = False) -> NDArray[np.float32]:
    """Return for every pixel (H, W) what was found for some of them, interpolated.

    Parameters
    ----------
    values : (h, w) array
        Of one pixel in ``step`` each way, in the middle of its square.
    step, image_wh : int, tuple of int
        As in `CoarseLines`.
    nearest : bool
        The nearest one's instead.
    """
    wide, how = (values.shape[1] * step, values.shape[0] * step), cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
    fine = cv2.resize(values.astype(np.float32), wide, interpolation=how)
    return np.asarray(fine[: image_wh[1], : image_wh[0]])
