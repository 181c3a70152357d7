"""Reduction of large pictures for the detection of markers with OpenCV.

Corners of the markers are measured in the full picture.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8 | np.uint16]

LONGEST_PX = 2100
"""Maximum side length of a picture, px. Larger pictures are halved repeatedly. Pictures of the Pi HQ camera with a
width of 4056 px are halved once, and those with 2028 px (binned) are not halved."""


def reduce_picture(image: Picture) -> tuple[Picture, NDArray[np.float64]]:
    """Halve a picture (H, W) repeatedly by averaging, until no side is longer than `LONGEST_PX`.

    Returns
    -------
    small : (h, w) uint8 or uint16 array
        Reduced picture, or the picture itself if it is small enough.
    scale : (2,) float64 array
        Ratios W / w and H / h. Position x in ``small`` corresponds to (x + 0.5) scale - 0.5 in the picture.
    """
    small, shrink = image, 1
    while max(image.shape) / shrink > LONGEST_PX:
        shrink *= 2
    if shrink > 1:
        small = cv2.resize(image, None, fx=1.0 / shrink, fy=1.0 / shrink, interpolation=cv2.INTER_AREA)
    return small, np.array([image.shape[1] / small.shape[1], image.shape[0] / small.shape[0]])
