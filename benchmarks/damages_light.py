"""Damages to the light of pictures, and to their files."""

from __future__ import annotations

import cv2
import numpy as np

from benchmarks.damaged_scan import Damage, Light, Scan, gamma_png, linear_png, srgb_jpeg
from rhizotwin.scenes.transfer import SRGB

_JPEG = srgb_jpeg(90)


def _numbers(light: Light) -> Light:
    return SRGB.number(np.clip(light, 0.0, 1.0))


def _place(light: Light) -> tuple[Light, Light]:
    """Return column and row (H, W) of each pixel, from -1 to 1."""
    height, width = light.shape
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, width), np.linspace(-1.0, 1.0, height))
    return x, y


def _blur(light: Light, sigma_px: float) -> Light:
    return np.asarray(cv2.GaussianBlur(light, (0, 0), sigma_px))


def _sharpen(sigma_px: float) -> Damage:
    def light(scan: Scan, k: int) -> Light:
        number = _numbers(scan.light[k])
        return SRGB.of(np.clip(2.0 * number - _blur(number, sigma_px), 0.0, 1.0))

    return Damage(name=f"sharpened-{sigma_px:g}", why="the camera sharpens its pictures", light=light, stored=_JPEG)


def _tone(scan: Scan, k: int) -> Light:
    """Compress the range of pixel values and keep details (as Durand and Dorsey 2002, with a Gaussian base layer)."""
    number = np.log(np.maximum(_numbers(scan.light[k]), 1.0 / 255.0))
    base = _blur(number, 12.0)
    return SRGB.of(np.clip(np.exp(0.5 * (base - base.max()) + number - base), 0.0, 1.0))


def _stretch(scan: Scan, k: int) -> Light:
    number = _numbers(scan.light[k])
    low, high = np.percentile(number, [1.0, 99.0])
    return SRGB.of(np.clip((number - low) / (high - low), 0.0, 1.0))


def _in_water(scan: Scan, k: int, light: Light) -> Light:
    """Return a picture that is changed where it shows the water."""
    return np.where(scan.water[k], light, scan.light[k])


def _turbid(scan: Scan, k: int) -> Light:
    """Scatter a quarter of the light through the water forward, by about 20 px."""
    return _in_water(scan, k, 0.85 * (0.75 * scan.light[k] + 0.25 * _blur(scan.light[k], 20.0)))


def _veil(scan: Scan, k: int) -> Light:
    """Add a seventh of the panel's light over the water."""
    return _in_water(scan, k, 0.85 * scan.light[k] + 0.15 * float(np.median(scan.light[k])))


def _flicker(scan: Scan, k: int) -> Light:
    _, y = _place(scan.light[k])
    phase = np.random.default_rng([1, k]).uniform(0.0, 2.0 * np.pi)
    return scan.light[k] * (1.0 + 0.1 * np.sin(4.0 * np.pi * y + phase)) / 1.1


def _shadow(scan: Scan, k: int) -> Light:
    x, _ = _place(scan.light[k])
    return scan.light[k] * (1.0 - (0.25 / (1.0 + np.exp(-(0.3 - x) / 0.1)) if 6 <= k < 10 else 0.0))


def _stamp(scan: Scan, k: int) -> Light:
    height, width = scan.light[k].shape
    mask = np.zeros((height, width), np.uint8)
    text = f"12:{3 * k:02d}:{(17 * k) % 60:02d}"
    cv2.putText(mask, text, (int(0.42 * width), int(0.95 * height)), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 255, 1, cv2.LINE_AA)
    return np.asarray(scan.light[k] * (1.0 - mask / 255.0))


def _bayer(scan: Scan, k: int) -> Light:
    light = scan.light[k].copy()
    light[::2, ::2] *= 0.6
    light[1::2, 1::2] *= 0.45
    return light


def _half(scan: Scan, k: int) -> Light:
    light = scan.light[k].copy()
    if k == 7:
        light[light.shape[0] // 2 :] = 0.5
    return light


def _dead_columns(scan: Scan, k: int) -> Light:
    light = scan.light[k].copy()
    width = light.shape[1]
    light[:, width // 2 + 5], light[:, 3 * width // 8] = 0.0, 1.0
    return light


def _vignette(scan: Scan, k: int) -> Light:
    x, y = _place(scan.light[k])
    return scan.light[k] * (1.0 - 0.2 * (x**2 + y**2))


LIGHT = (
    Damage(name="none", why="unchanged pictures"),
    Damage(name="jpeg-60-420", why="a small file: quality 60, chroma at half the pixels", stored=srgb_jpeg(60, subsampled=True)),
    Damage(name="jpeg-30", why="a smaller file: quality 30", stored=srgb_jpeg(30)),
    Damage(name="gamma-1.8-as-linear", why="a program's PNG with an unstated gamma of 1.8", stored=gamma_png(1.8)),
    Damage(name="ten-bits-in-sixteen", why="values of a 10-bit converter stored right-aligned", stored=linear_png(1023)),
    Damage(name="vignetted", why="the lens darkens the corners by 40 %", light=_vignette),
    Damage(
        name="lamp-fades",
        why="the panel fades by 30 % during the scan",
        light=lambda scan, k: scan.light[k] * (1.0 - 0.3 * k / scan.count),
    ),
    Damage(
        name="lamp-tilts",
        why="half of the panel's LEDs fade, the others brighten, by 10 %",
        light=lambda scan, k: scan.light[k] * (1.0 + 0.1 * (2.0 * k / scan.count - 1.0) * _place(scan.light[k])[0]),
    ),
    Damage(name="flicker", why="a rolling shutter under a lamp at mains frequency: moving bands of 10 %", light=_flicker),
    Damage(name="shadow", why="a person in front of the panel in four pictures", light=_shadow),
    Damage(name="black-level", why="5 % of stray light on all pixels", light=lambda scan, k: 0.05 + 0.9 * scan.light[k]),
    Damage(
        name="black-crushed",
        why="black level subtracted 5 % too high",
        light=lambda scan, k: np.maximum(scan.light[k] - 0.05, 0.0) / 0.95,
    ),
    _sharpen(1.0),
    _sharpen(3.0),
    Damage(name="tone-mapped", why="a telephone's picture with high dynamic range", light=_tone, stored=_JPEG),
    Damage(name="stretched", why="a program stretched the contrast of each picture", light=_stretch, stored=_JPEG),
    Damage(
        name="s-curve",
        why="a camera's 'vivid' setting",
        light=lambda scan, k: SRGB.of(0.5 - 0.5 * np.cos(np.pi * _numbers(scan.light[k]))),
        stored=_JPEG,
    ),
    Damage(
        name="median",
        why="a median over 5 pixels against noise",
        light=lambda scan, k: cv2.medianBlur(np.float32(scan.light[k]), 5).astype(np.float64),
    ),
    Damage(name="motion-blur", why="the table is still turning: 4 px", light=lambda scan, k: cv2.blur(scan.light[k], (4, 1))),
    Damage(
        name="refocused",
        why="the camera refocuses half-way: a blur of 1.5 px, pictures larger by 0.3 %",
        light=lambda scan, k: scan.light[k] if 2 * k < scan.count else _zoom(_blur(scan.light[k], 1.5), 1.003),
    ),
    Damage(name="clipped", why="exposure twice too long", light=lambda scan, k: np.minimum(2.0 * scan.light[k], 1.0)),
    Damage(name="dark", why="a tenth of the exposure, in 8 bits", light=lambda scan, k: 0.1 * scan.light[k], stored=gamma_png(1.0)),
    Damage(name="one-dark", why="the lamp was off in one picture", light=lambda scan, k: scan.light[k] * (0.15 if k == 4 else 1.0)),
    Damage(
        name="hazy",
        why="a fingerprint on the lens spreads a fifth of the light",
        light=lambda scan, k: 0.8 * scan.light[k] + 0.2 * float(np.mean(scan.light[k])),
    ),
    Damage(name="turbid", why="milky water", light=_turbid),
    Damage(name="veiled", why="room light on the canister's front", light=_veil),
    Damage(name="tinted", why="brown water: half of the light", light=lambda scan, k: _in_water(scan, k, 0.5 * scan.light[k])),
    Damage(name="stamped", why="the time in each picture, below the roots", light=_stamp),
    Damage(name="bayer", why="a raw mosaic interpreted as grey", light=_bayer),
    Damage(name="half-written", why="the lower half of one picture is grey", light=_half),
    Damage(name="dead-columns", why="two dead columns of the sensor", light=_dead_columns),
    Damage(
        name="upscaled",
        why="stored at half the size and enlarged again",
        light=lambda scan, k: cv2.resize(
            cv2.resize(scan.light[k], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA),
            scan.light[k].shape[::-1],
            interpolation=cv2.INTER_CUBIC,
        ),
    ),
)


def _zoom(light: Light, scale: float) -> Light:
    height, width = light.shape
    cx, cy = (width - 1) / 2.0, (height - 1) / 2.0
    moved = np.array([[scale, 0.0, (1.0 - scale) * cx], [0.0, scale, (1.0 - scale) * cy]])
    return np.asarray(cv2.warpAffine(light, moved, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE))
