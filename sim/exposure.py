"""Convert linear light to pixel values.

The conversion includes vignetting, noise, clipping, quantisation, the transfer curve and the white balance.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from rhizotwin.scenes import transfer
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.model import Camera

DEFAULT_FULL_WELL_E = 8000.0
"""Full-well capacity for profiles with read noise but without photon noise, electrons. It is similar to that of the
pixels of the Pi HQ camera."""
MANY_E = 25.0
"""Mean number of electrons above which the quantiles in `photons` are computed with the Cornish-Fisher expansion. Below
it they are found by summation."""


def expose(
    light: NDArray[np.float32], camera: Camera, disturbances: Disturbances, *, rng: np.random.Generator
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Convert a picture of linear light to the pixel values that the camera stores.

    Parameters
    ----------
    light : (H, W) float32
        Linear light, as a fraction of full scale.
    camera : Camera
        Camera with the bit depth of its converter, ``bits``, and its transfer curve, ``transfer``.
    disturbances : Disturbances
        Noise, variation of exposure and white balance, vignetting, bit depth of stored pictures, and transfer curve
        that replaces the curve of the camera.
    rng : Generator
        Random generator for the picture.

    Returns
    -------
    (H, W) array, or (H, W, 3) RGB array if the white balance varies
        Pixel values, uint8, or uint16 with left-aligned values for more than 8 bits.
    """
    wrong = disturbances
    signal = np.maximum(light.astype(np.float64), 0.0)
    if wrong.vignetting > 0.0:
        signal = signal * _falloff(light.shape, wrong.vignetting)
    if wrong.exposure_wander > 0.0:
        signal = signal * rng.uniform(1.0 - wrong.exposure_wander, 1.0 + wrong.exposure_wander)
    full_well_e = wrong.full_well_e or DEFAULT_FULL_WELL_E
    if wrong.full_well_e is not None:
        signal = photons(signal * full_well_e, rng.standard_normal(signal.shape)) / full_well_e
    if wrong.read_noise_e > 0.0:
        signal = signal + rng.normal(0.0, wrong.read_noise_e / full_well_e, signal.shape)
    if wrong.white_balance_wander > 0.0:
        red, blue = rng.uniform(1.0 - wrong.white_balance_wander, 1.0 + wrong.white_balance_wander, 2)
        signal = signal[..., None] * np.array([red, 1.0, blue])
    shown = stored_camera(camera, wrong)
    number = np.rint(np.clip(signal, 0.0, 1.0) * (2**camera.bits - 1)) / (2**camera.bits - 1)
    number = transfer.camera_curve(shown).number(number) if shown.transfer != "linear" else number
    stored = np.rint(number * (2**shown.bits - 1))
    return np.asarray(stored.astype(np.uint8) if shown.bits <= 8 else stored.astype(np.uint16) << np.uint16(16 - shown.bits))


def stored_camera(camera: Camera, disturbances: Disturbances) -> Camera:
    """Return the camera with the transfer curve and the bit depth of the pictures that it stores."""
    curve = camera.transfer if disturbances.transfer == "linear" else disturbances.transfer
    return replace(camera, transfer=curve, bits=disturbances.stored_bits or camera.bits)


def _falloff(shape: tuple[int, ...], share: float) -> NDArray[np.float64]:
    """Return the relative transmission of the lens (H, W).

    It decreases from 1 in the centre to 1 - ``share`` in the corners.
    """
    y, x = (np.linspace(-1.0, 1.0, size) for size in shape[:2])
    return np.asarray(1.0 - 0.5 * share * (x[None, :] ** 2 + y[:, None] ** 2))


def photons(mean: NDArray[np.float64], chance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Draw numbers (H, W) from Poisson distributions with the given means.

    Each number is the quantile at the probability of a standard normal random value, which is an element of ``chance``
    (H, W). Random generators draw Poisson numbers by rejection. A rounding difference in one pixel may then consume an
    additional random value and change the noise of all subsequent pixels. Here a small change of a pixel's mean changes
    its value by at most one electron, and no other pixel.

    For means below `MANY_E` the quantile is found by summation. For larger means m it is computed with the
    Cornish-Fisher expansion (Abramowitz and Stegun 26.2.49) with skewness m^-1/2 and excess m^-1. Fewer than 1 % of the
    pixels are wrong by one electron.
    """
    root, z = np.sqrt(np.maximum(mean, MANY_E)), chance
    found: NDArray[np.float64] = mean + root * z + (z**2 - 1.0) / 6.0 + ((z**3 - 3.0 * z) / 24.0 - (2.0 * z**3 - 5.0 * z) / 36.0) / root
    found = np.rint(found)
    few = mean < MANY_E
    if few.any():
        m, level = mean[few], ndtr(chance[few])
        term = np.exp(-m)
        below, count = term.copy(), np.zeros(len(m))
        for k in range(1, int(MANY_E + 10.0 * np.sqrt(MANY_E))):
            count += level > below
            term *= m / k
            below += term
        found[few] = count
    return found


def mask_picture(coverage: NDArray[Any]) -> NDArray[np.uint16]:
    """Convert a coverage (H, W) from 0 to 1 to 16-bit pixel values."""
    return np.asarray(np.rint(np.clip(coverage, 0.0, 1.0) * 65535.0), dtype=np.uint16)
