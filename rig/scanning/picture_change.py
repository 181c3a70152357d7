"""Detection of differences between two pictures beyond noise.

It is used for rings in which no marker can be read, as a table that turns changes the picture. Noise differs from pixel
to pixel: averaged over a block of n pixels, a difference of noise alone has 1/n of its variance, while a rotation
changes whole blocks.
"""

import numpy as np

from rhizotwin.scenes.picture_codec import Grey

BLOCK_PX = 8
LEAST_SHARE = 1e-3
"""Fraction of blocks with different means that indicates a rotation: a root 100 rows long crosses this many blocks of
800x600 pixels."""
SIGMAS = 6.0
"""Significance of a difference in a block's mean, in standard deviations: by chance it occurs once in 5e8 blocks."""


def changed_share(image: Grey, before: Grey) -> float:
    """Return the fraction of blocks whose mean differs from that of an earlier picture by more than noise.

    Changes by flickering lamps are removed.

    Parameters
    ----------
    image, before : (H, W) uint8 or uint16 array
        Pictures of a static camera.
    """
    now, then = image.astype(np.float32), before.astype(np.float32)
    gain = float(np.vdot(now, then) / max(float(np.vdot(then, then)), 1.0))
    difference = now - np.float32(gain) * then
    high, wide = (size // BLOCK_PX * BLOCK_PX for size in difference.shape)
    blocks = difference[:high, :wide].reshape(high // BLOCK_PX, BLOCK_PX, wide // BLOCK_PX, BLOCK_PX)
    means = blocks.mean(axis=(1, 3))
    noise = np.sqrt(blocks.var(axis=(1, 3)) + 1.0 / 12.0) / BLOCK_PX  # including rounding
    return float(np.mean(np.abs(means) > SIGMAS * np.maximum(noise, np.median(noise))))
