"""From linear light to the camera's numbers.

Lens, photons, electrons, noise, clipping, converter, the camera's curve and colours.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from rhizotwin.scenes import transfer
from rhizotwin.scenes.model import Camera, Disturbances

DEFAULT_FULL_WELL_E = 8000.0
"""Electrons at full scale where a profile has read noise but no photon noise (about that of the Pi HQ camera's
pixels)."""
MANY_E = 25.0
"""From so many electrons on their quantiles are an expansion."""


def expose(
    light: NDArray[np.float32], camera: Camera, disturbances: Disturbances, *, rng: np.random.Generator
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Turn a picture of linear light into what the camera stores.

    Parameters
    ----------
    light : (H, W) float32
        1 is full scale.
    camera : Camera
        Its ``bits`` are the converter's depth, its ``transfer`` its curve.
    disturbances : Disturbances
        What the camera does besides: noise, exposure, white balance, vignetting, the depth of the stored picture,
        another curve.
    rng : Generator
        The picture's own.

    Returns
    -------
    (H, W), or (H, W, 3) RGB where the white balance wanders; uint8, or uint16 with the numbers left-aligned where they
    have over 8 bits.
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
    shown = as_taken(camera, wrong)
    number = np.rint(np.clip(signal, 0.0, 1.0) * (2**camera.bits - 1)) / (2**camera.bits - 1)
    number = transfer.of_camera(shown).number(number) if shown.transfer != "linear" else number
    stored = np.rint(number * (2**shown.bits - 1))
    return np.asarray(stored.astype(np.uint8) if shown.bits <= 8 else stored.astype(np.uint16) << np.uint16(16 - shown.bits))


def as_taken(camera: Camera, disturbances: Disturbances) -> Camera:
    """Return the camera with the curve and the depth of the pictures that it stores."""
    curve = camera.transfer if disturbances.transfer == "linear" else disturbances.transfer
    return replace(camera, transfer=curve, bits=disturbances.stored_bits or camera.bits)


def _falloff(shape: tuple[int, ...], share: float) -> NDArray[np.float64]:
    """Return what the lens leaves of the light (H, W): all in the middle, 1 - ``share`` in the corners."""
    y, x = (np.linspace(-1.0, 1.0, size) for size in shape[:2])
    return np.asarray(1.0 - 0.5 * share * (x[None, :] ** 2 + y[:, None] ** 2))


def photons(mean: NDArray[np.float64], chance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Poisson numbers (H, W) of given means: the quantiles of normal chances (H, W), each pixel's own.

    A generator's own Poisson numbers are drawn by rejection: one pixel that differs in its last bit then draws once
    more, and every pixel after it gets other noise. Here a pixel that changes by little changes by at most one
    electron, and no other does.

    Few photons are counted up to the quantile. From `MANY_E` on it is Cornish and Fisher's expansion (Abramowitz and
    Stegun 26.2.49), whose skewness is m^-1/2 and excess m^-1: less than one pixel in a hundred is one electron off.
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
    """Return coverage (H, W) in [0, 1] as 16-bit numbers."""
    return np.asarray(np.rint(np.clip(coverage, 0.0, 1.0) * 65535.0), dtype=np.uint16)
