"""A rendered scan to be damaged: its light, its true cameras, and functions that draw over its pictures."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from benchmarks.projection import all_images
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes import atomic
from rhizotwin.scenes.dataset import Dataset, Frame, file_sha256, load_dataset, read_image, save_dataset
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import encode_light_png, encode_png
from rhizotwin.scenes.transfer import SRGB
from rhizotwin.scenes.truth import Truth, load_truth

Light = NDArray[np.float64]
"""(H, W) picture, linear in light; 1 is full scale."""
Mask = NDArray[np.bool_]

EVERY = 2
"""Interval of the views used: 20 of a printed phantom's 40, which halves the time of reconstruction."""
_FACES_CAMERA = 0.1
"""Minimum cosine between the wall's normal and the line of sight at which the near wall is drawn; at smaller values its
projection degenerates to a line."""


@dataclass(frozen=True, kw_only=True)
class Scan:
    """A rendered scan in memory."""

    dataset: Dataset
    frames: tuple[Frame, ...]
    light: tuple[Light, ...]
    views: tuple[View, ...]
    """True views."""
    truth: Truth

    @staticmethod
    def read(folder: Path) -> Scan:
        """Read a rendered dataset, with one in `EVERY` views."""
        dataset, truth = load_dataset(folder), load_truth(folder)
        frames = dataset.frames[::EVERY]
        light = tuple(image / np.iinfo(image.dtype).max for image in (read_image(dataset, frame) for frame in frames))
        true = {view.file: np.array(view.cam_from_canister) for view in truth.views}
        views = tuple(View(camera=dataset.scene.camera, cam_from_canister=true[frame.file]) for frame in frames)
        return Scan(dataset=dataset, frames=frames, light=light, views=views, truth=truth)

    @property
    def count(self) -> int:
        """Return the number of pictures."""
        return len(self.light)

    @cached_property
    def optics(self) -> Optics:
        """Return the optics of the canister."""
        return Optics.from_scene(self.dataset.scene)

    @cached_property
    def water(self) -> tuple[Mask, ...]:
        """Return the mask (H, W) of pixels that show the water, for each picture."""
        height, width = self.light[0].shape
        px = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2).astype(np.float64)
        return tuple(cameras.water_lines(view, self.optics, px)[1].reshape(height, width) for view in self.views)

    @cached_property
    def surface_mm(self) -> Light:
        """Return the vertices (N, 3) of the specimen."""
        mesh = trimesh.load_mesh(self.dataset.folder / "truth" / "specimen.ply")
        return np.asarray(mesh.vertices, np.float64)

    def azimuth_rad(self, k: int) -> float:
        """Return the azimuth of a picture's camera about the canister."""
        x, y, _ = self.views[k].centre_mm
        return float(np.arctan2(y, x))

    def wall_patch(self, k: int, azimuth_rad: tuple[float, float], z_mm: tuple[float, float]) -> Light:
        """Return the fraction (H, W) of each pixel covered by a patch of the canister's wall, near or far.

        Parameters
        ----------
        k : int
            Number of the view.
        azimuth_rad : (2,) float
            Range of azimuths, canister frame.
        z_mm : (2,) float
            Range of heights.

        Returns
        -------
        (H, W) float64 array
            Fraction, 0 to 1.
        """
        azimuth = np.linspace(*azimuth_rad, 16)
        height = np.linspace(*z_mm, 12)
        around, along = np.meshgrid(azimuth, height)

        def at(radius_mm: float) -> Light:
            return np.stack([radius_mm * np.cos(around), radius_mm * np.sin(around), along], axis=-1)

        facing = np.cos(around - self.azimuth_rad(k))
        pose, camera = self.views[k].cam_from_canister, self.dataset.scene.camera
        near = at(self.optics.outer_radius_mm).reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3]
        px = (near @ cameras.matrix(camera).T)[:, :2] / near[:, 2:]
        far, _ = all_images(self.views[k], self.optics, at(self.optics.inner_radius_mm - 0.1).reshape(-1, 3))
        shown = np.where((facing > _FACES_CAMERA)[..., None], px.reshape(*around.shape, 2), np.nan)
        through = np.where((facing < -_FACES_CAMERA)[..., None], far[:, 0].reshape(*around.shape, 2), np.nan)
        return np.maximum(self._quads(shown), self._quads(through))

    def disc(self, px: Light, radius_px: float) -> Light:
        """Return the fraction (H, W) of each pixel covered by a disc about a pixel (2,)."""
        mask = np.zeros(self.light[0].shape, np.uint8)
        if np.isfinite(px).all() and np.abs(px).max() < 10 * max(mask.shape):
            centre = (round(16 * float(px[0])), round(16 * float(px[1])))
            cv2.circle(mask, centre, max(1, round(16 * radius_px)), 255, -1, cv2.LINE_AA, 4)
        return mask / 255.0

    def _quads(self, px: Light) -> Light:
        mask = np.zeros(self.light[0].shape, np.uint8)
        for i in range(px.shape[0] - 1):
            for j in range(px.shape[1] - 1):
                quad = np.array([px[i, j], px[i, j + 1], px[i + 1, j + 1], px[i + 1, j]])
                if np.isfinite(quad).all() and np.abs(quad).max() < 10 * max(mask.shape):
                    cv2.fillPoly(mask, [np.round(16 * quad).astype(np.int32)], 255, cv2.LINE_AA, 4)
        return mask / 255.0


def over(light: Light, share: Light, grey: float) -> Light:
    """Return a picture (H, W) with a uniform grey object that covers a fraction (H, W) of its pixels.

    Parameters
    ----------
    light : (H, W) float64 array
        Picture to cover.
    share : (H, W) float64 array
        Covered fraction of each pixel, 0 to 1.
    grey : float
        Light of the object; 1 is full scale.

    Returns
    -------
    (H, W) float64 array
        Covered picture.
    """
    return np.asarray(light * (1.0 - share) + grey * share)


@dataclass(frozen=True, kw_only=True)
class StorageFormat:
    """Storage format of a camera's pictures, and the corresponding settings of the scene."""

    suffix: str
    transfer: Literal["linear", "srgb"]
    bits: int
    encode: Callable[[Light], bytes]


def _steps(share: Light, full: int, kind: type[np.uint8] | type[np.uint16]) -> NDArray[np.uint8 | np.uint16]:
    return np.asarray(np.clip(np.rint(full * share), 0, full).astype(kind))


_WARM = (0.8, 0.95, 1.0)
"""Blue, green and red light of a warm white panel, relative to red."""


def _jpeg(quality: int, subsampled: bool) -> Callable[[Light], bytes]:
    def encode(light: Light) -> bytes:
        colours = SRGB.number(np.clip(light[..., None] * np.array(_WARM), 0.0, 1.0))
        sampling = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420 if subsampled else cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
        flags = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling]
        return bytes(cv2.imencode(".jpg", _steps(colours, 255, np.uint8), flags)[1].tobytes())

    return encode


def linear_png(full: int = 65535) -> StorageFormat:
    """Return 16-bit PNGs, linear in light as stated in the file, with ``full`` for a light of 1."""
    return StorageFormat(suffix=".png", transfer="linear", bits=16, encode=lambda light: encode_light_png(_steps(light, full, np.uint16)))


def srgb_jpeg(quality: int, *, subsampled: bool = False) -> StorageFormat:
    """Return JPEGs of a slightly warm panel, stated as sRGB in the scene."""
    return StorageFormat(suffix=".jpg", transfer="srgb", bits=8, encode=_jpeg(quality, subsampled))


def gamma_png(exponent: float) -> StorageFormat:
    """Return 8-bit PNGs with a gamma, stated as linear in the scene."""

    def encode(light: Light) -> bytes:
        return encode_png(_steps(np.clip(light, 0.0, 1.0) ** (1.0 / exponent), 255, np.uint8))

    return StorageFormat(suffix=".png", transfer="linear", bits=8, encode=encode)


@dataclass(frozen=True, kw_only=True)
class Damage:
    """One kind of damage to a laboratory's pictures."""

    name: str
    why: str
    """Cause of the damage."""
    light: Callable[[Scan, int], Light] = lambda scan, k: scan.light[k]
    """Function that returns the damaged k-th picture (H, W)."""
    stored: StorageFormat = field(default_factory=linear_png)
    scene: Callable[[Scene], Scene] = lambda scene: scene
    """Function that returns the stated scene; the pictures do not change."""
    table_deg: Callable[[Scan, int], float | None] = lambda scan, k: scan.frames[k].table_deg
    """Function that returns the stated table angle."""
    keeps: Callable[[Scan, int], bool] = lambda _scan, _k: True
    """Function that returns whether a picture is kept."""

    def write(self, scan: Scan, folder: Path) -> Dataset:
        """Write the damaged dataset, with a link to the scan's truth."""
        frames = []
        for k, before in enumerate(scan.frames):
            if self.keeps(scan, k):
                path = folder / Path(before.file).with_suffix(self.stored.suffix)
                path.parent.mkdir(parents=True, exist_ok=True)
                atomic.write_bytes(path, self.stored.encode(self.light(scan, k)))
                name = path.relative_to(folder).as_posix()
                frames.append(replace(before, file=name, sha256=file_sha256(path), table_deg=self.table_deg(scan, k)))
        shutil.copytree(scan.dataset.folder / "truth", folder / "truth")
        camera = replace(scan.dataset.scene.camera, transfer=self.stored.transfer, bits=self.stored.bits)
        scene = self.scene(replace(scan.dataset.scene, camera=camera))
        written = replace(scan.dataset, folder=folder, scene=scene, frames=tuple(frames))
        return save_dataset(written)
