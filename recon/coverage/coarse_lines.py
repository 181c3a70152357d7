"""Lines of sight on a coarse pixel grid, and interpolation of their values to all pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Approach, Optics


@dataclass(frozen=True)
class CoarseLines:
    """Lines of sight of a view up to the canister, on a coarse pixel grid."""

    line: Approach
    """(N,) lines of sight."""
    through: NDArray[np.bool_]
    """(N,) whether each line passes through a tank's front below the liquid's surface; always true without a tank."""
    shape: tuple[int, int]
    """Number of rows and columns of the coarse grid."""
    step: int
    """Spacing of the grid in both directions, px."""
    image_wh: tuple[int, int]
    """Width and height of the picture, px."""

    @staticmethod
    def compute(view: View, optics: Optics, *, step: int, beyond: bool = False) -> CoarseLines:
        """Compute the lines of sight of a view on a coarse pixel grid.

        Parameters
        ----------
        view : View
            Camera and pose of the view.
        optics : Optics
            Optics of the canister.
        step : int
            Spacing of the lines in both directions, px. Lines pass through the centres of squares of this size.
        beyond : bool
            Whether to add one row and one column beyond the lower and right border, to avoid extrapolation there.
        """
        columns, rows = (math.ceil(size / step) + beyond for size in view.camera.image_wh)
        u, v = np.meshgrid(step * (np.arange(columns) + 0.5) - 0.5, step * (np.arange(rows) + 0.5) - 0.5)
        directions = cameras.camera_directions(view.camera, np.stack([u.ravel(), v.ravel()], axis=1))
        return CoarseLines(*cameras.approach(view, optics, directions), (u.shape[0], u.shape[1]), step, view.camera.image_wh)

    def upsample(self, values: NDArray[np.generic], *, nearest: bool = False) -> NDArray[np.float32]:
        """Interpolate the values (N,) of the lines to all pixels (H, W).

        If ``nearest`` is True, each pixel receives the value of the nearest line instead.
        """
        return upsample(values.reshape(self.shape), self.step, self.image_wh, nearest=nearest)


def upsample(values: NDArray[np.generic], step: int, image_wh: tuple[int, int], *, nearest: bool = False) -> NDArray[np.float32]:
    """Interpolate values on a coarse grid to all pixels (H, W) of a picture.

    Parameters
    ----------
    values : (h, w) array
        Values at the centres of squares with a side of ``step`` pixels.
    step, image_wh : int, tuple of int
        Spacing of the grid, px, and width and height of the picture, px.
    nearest : bool
        Whether to use the nearest value instead of interpolation.
    """
    wide, how = (values.shape[1] * step, values.shape[0] * step), cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
    fine = cv2.resize(values.astype(np.float32), wide, interpolation=how)
    return np.asarray(fine[: image_wh[1], : image_wh[0]])
