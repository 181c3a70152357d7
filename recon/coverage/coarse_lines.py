"""Lines of sight on a coarse pixel grid, and interpolation of values along them to all pixels."""

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
    """Coarse grid of a view's lines of sight, before they meet the canister."""

    line: Approach
    """(N,)"""
    through: NDArray[np.bool_]
    """(N,) whether a line passes through a tank's front below the liquid's surface; without a tank, always true."""
    shape: tuple[int, int]
    """Rows and columns of the N lines."""
    step: int
    image_wh: tuple[int, int]

    @staticmethod
    def compute(view: View, optics: Optics, *, step: int, beyond: bool = False) -> CoarseLines:
        """Compute the lines of sight of a view.

        Parameters
        ----------
        view : View
            Camera and pose.
        optics : Optics
            Optics of the canister.
        step : int
            Spacing of the lines in pixels, in both directions, at the centres of the squares.
        beyond : bool
            Whether to add one step beyond the right and lower border, to avoid extrapolation there.
        """
        width, height = view.camera.image_wh
        more, first = step if beyond else 0, 0.5 * step - 0.5
        u, v = np.meshgrid(np.arange(first, width + more, step), np.arange(first, height + more, step))
        directions = cameras.camera_directions(view.camera, np.stack([u.ravel(), v.ravel()], axis=1))
        return CoarseLines(*cameras.approach(view, optics, directions), (u.shape[0], u.shape[1]), step, view.camera.image_wh)

    def upsample(self, values: NDArray[np.generic], *, nearest: bool = False) -> NDArray[np.float32]:
        """Return values for every pixel (H, W) from those of the lines (N,): interpolated, or of the nearest line."""
        return upsample(values.reshape(self.shape), self.step, self.image_wh, nearest=nearest)


def upsample(values: NDArray[np.generic], step: int, image_wh: tuple[int, int], *, nearest: bool = False) -> NDArray[np.float32]:
    """Return values for every pixel (H, W) from values on a coarse grid, interpolated.

    Parameters
    ----------
    values : (h, w) array
        Values for one pixel in ``step`` in each direction, at the centre of its square.
    step, image_wh : int, tuple of int
        As in `CoarseLines`.
    nearest : bool
        Whether to use the nearest value instead.
    """
    wide, how = (values.shape[1] * step, values.shape[0] * step), cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
    fine = cv2.resize(values.astype(np.float32), wide, interpolation=how)
    return np.asarray(fine[: image_wh[1], : image_wh[0]])
