"""Whether a picture differs from another by more than noise.

For rings in which no marker can be read: a table that turns changes the picture.

Noise differs from pixel to pixel: averaged over a block of n pixels, a difference that is noise alone has 1/n of its
variance. What turned differs over whole blocks.
"""

import numpy as np

from rhizotwin.scenes.pictures import Grey

BLOCK_PX = 8
LEAST_SHARE = 1e-3
"""Blocks whose mean differs, of all, by which a turn is told: a root 100 rows long passes through as many of
800x600."""
SIGMAS = 6.0
"""Of a block's mean, beyond which it differs: by chance once in 5e8 blocks."""


def changed_share(image: Grey, before: Grey) -> float:
    """Return the share of blocks whose mean differs from that of an earlier picture by more than noise.

    Lamps that flicker are set aside.

    Parameters
    ----------
    image, before : (H, W) uint8 or uint16 array
        Of one camera that stood still.
    """
    now, then = image.astype(np.float32), before.astype(np.float32)
    gain = float(np.vdot(now, then) / max(float(np.vdot(then, then)), 1.0))
    difference = now - np.float32(gain) * then
    high, wide = (size // BLOCK_PX * BLOCK_PX for size in difference.shape)
    blocks = difference[:high, :wide].reshape(high // BLOCK_PX, BLOCK_PX, wide // BLOCK_PX, BLOCK_PX)
    means = blocks.mean(axis=(1, 3))
    noise = np.sqrt(blocks.var(axis=(1, 3)) + 1.0 / 12.0) / BLOCK_PX  # and rounding
    return float(np.mean(np.abs(means) > SIGMAS * np.maximum(noise, np.median(noise))))
