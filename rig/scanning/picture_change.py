"""Detection of differences between two pictures that exceed noise.

A rotation of the table changes the picture. This is used to confirm the rotation in rings in which no marker can be
read. Noise is independent between pixels: averaged over a block of n pixels, a difference due to noise has 1/n of its
variance, whereas a rotation changes whole blocks.
"""

import numpy as np

from rhizotwin.scenes.picture_codec import Grey

BLOCK_PX = 8
LEAST_SHARE = 1e-3
"""Fraction of blocks that must have changed for a rotation of the table to be confirmed. A root that is 100 rows long
changes this fraction of the blocks in a picture of 800x600 pixels."""
SIGMAS = 6.0
"""Threshold for the difference between the means of a block in two pictures, in standard deviations. Noise alone
exceeds the threshold in one of 5e8 blocks."""


def changed_share(image: Grey, before: Grey) -> float:
    """Return the fraction of blocks whose mean has changed significantly since an earlier picture.

    Differences in overall brightness, as from flickering lamps, are removed first.

    Parameters
    ----------
    image, before : (H, W) uint8 or uint16 array
        Pictures from a static camera.
    """
    now, then = image.astype(np.float32), before.astype(np.float32)
    gain = float(np.vdot(now, then) / max(float(np.vdot(then, then)), 1.0))
    difference = now - np.float32(gain) * then
    high, wide = (size // BLOCK_PX * BLOCK_PX for size in difference.shape)
    blocks = difference[:high, :wide].reshape(high // BLOCK_PX, BLOCK_PX, wide // BLOCK_PX, BLOCK_PX)
    means = blocks.mean(axis=(1, 3))
    noise = np.sqrt(blocks.var(axis=(1, 3)) + 1.0 / 12.0) / BLOCK_PX  # including rounding
    return float(np.mean(np.abs(means) > SIGMAS * np.maximum(noise, np.median(noise))))
