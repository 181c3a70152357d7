"""From linear light to the camera's numbers: photons, electrons, noise, clipping, converter."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.model import Camera, Disturbances

DEFAULT_FULL_WELL_E = 8000.0
"""Electrons at full scale where a profile has read noise but no photon noise (about that of the Pi HQ camera's pixels)."""


def expose(
    light: NDArray[np.float32], camera: Camera, disturbances: Disturbances, *, rng: np.random.Generator
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Turn a picture of linear light into what the camera stores.

    Parameters
    ----------
    light : (H, W) float32
        1 is full scale.
    camera : Camera
        Its ``bits`` are the converter's depth.
    disturbances : Disturbances
        ``full_well_e`` for photon noise (Poisson; None: none) and ``read_noise_e`` (normal, electrons).
    rng : Generator
        The picture's own.

    Returns
    -------
    (H, W) uint8, or uint16 with the converter's numbers left-aligned where it has more than 8 bits.
    """
    signal = np.maximum(light.astype(np.float64), 0.0)
    full_well_e = disturbances.full_well_e or DEFAULT_FULL_WELL_E
    if disturbances.full_well_e is not None:
        signal = rng.poisson(signal * full_well_e) / full_well_e
    if disturbances.read_noise_e > 0.0:
        signal = signal + rng.normal(0.0, disturbances.read_noise_e / full_well_e, signal.shape)
    numbers = np.rint(np.clip(signal, 0.0, 1.0) * (2**camera.bits - 1))
    stored = numbers.astype(np.uint8) if camera.bits <= 8 else numbers.astype(np.uint16) << np.uint16(16 - camera.bits)
    return np.asarray(stored)


def mask_picture(coverage: NDArray[Any]) -> NDArray[np.uint16]:
    """Return coverage (H, W) in [0, 1] as 16-bit numbers."""
    return np.asarray(np.rint(np.clip(coverage, 0.0, 1.0) * 65535.0), dtype=np.uint16)
