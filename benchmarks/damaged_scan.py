"""A rendered scan whose pictures are to be spoilt: its light, its true cameras, and what is drawn over it."""

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

from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes import atomic
from rhizotwin.scenes.dataset import Dataset, Frame, load_dataset, read_image, save_dataset, sha256_of
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.pictures import encode_light_png, encode_png
from rhizotwin.scenes.transfer import SRGB
from rhizotwin.scenes.truth import Truth, load_truth

Light = NDArray[np.float64]
"""(H, W) picture, linear in light, 1 at full scale."""
Mask = NDArray[np.bool_]

EVERY = 2
"""One view of so many is used: 20 of a printed phantom's 40, which are reconstructed in half the time."""
_FACES_CAMERA = 0.1
"""Cosine between wall and line of sight above which the near wall is drawn: it is a line beyond."""


@dataclass(frozen=True, kw_only=True)
class Scan:
    """A rendered scan, read."""

    dataset: Dataset
    frames: tuple[Frame, ...]
    light: tuple[Light, ...]
    views: tuple[View, ...]
    """As they really were."""
    truth: Truth

    @staticmethod
    def read(folder: Path) -> Scan:
        """Read one view of `EVERY` of a rendered dataset."""
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
        """Return the canister."""
        return Optics.from_scene(self.dataset.scene)

    @cached_property
    def water(self) -> tuple[Mask, ...]:
        """Return which pixels (H, W) of each picture look into the water."""
        height, width = self.light[0].shape
        px = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2).astype(np.float64)
        return tuple(cameras.water_lines(view, self.optics, px)[1].reshape(height, width) for view in self.views)

    @cached_property
    def surface_mm(self) -> Light:
        """Return the vertices (N, 3) of the specimen."""
        mesh = trimesh.load_mesh(self.dataset.folder / "truth" / "specimen.ply")
        return np.asarray(mesh.vertices, np.float64)

    def azimuth_rad(self, k: int) -> float:
        """Return where a picture's camera stood about the canister."""
        x, y, _ = self.views[k].centre_mm
        return float(np.arctan2(y, x))

    def wall_patch(self, k: int, azimuth_rad: tuple[float, float], z_mm: tuple[float, float]) -> Light:
        """Return the share (H, W) of each pixel that a patch of the canister's wall covers, near or far.

        Parameters
        ----------
        k : int
            Number of the view.
        azimuth_rad : (2,) float
            From where to where round the canister, canister frame.
        z_mm : (2,) float
            From which height to which.

        Returns
        -------
        (H, W) float64 array
            0 to 1.
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
        far, _ = cameras.project(self.views[k], self.optics, at(self.optics.inner_radius_mm - 0.1).reshape(-1, 3))
        shown = np.where((facing > _FACES_CAMERA)[..., None], px.reshape(*around.shape, 2), np.nan)
        through = np.where((facing < -_FACES_CAMERA)[..., None], far[:, 0].reshape(*around.shape, 2), np.nan)
        return np.maximum(self._quads(shown), self._quads(through))

    def disc(self, px: Light, radius_px: float) -> Light:
        """Return the share (H, W) of each pixel that a disc about a pixel (2,) covers."""
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
    """Return a picture (H, W) with something of one grey over a share (H, W) of its pixels.

    Parameters
    ----------
    light : (H, W) float64 array
        The picture.
    share : (H, W) float64 array
        How much of each pixel is covered, 0 to 1.
    grey : float
        Light of what covers, 1 at full scale.

    Returns
    -------
    (H, W) float64 array
        The covered picture.
    """
    return np.asarray(light * (1.0 - share) + grey * share)


@dataclass(frozen=True, kw_only=True)
class Stored:
    """How a camera stores its pictures, and what the scene says of them."""

    suffix: str
    transfer: Literal["linear", "srgb"]
    bits: int
    encode: Callable[[Light], bytes]


def _steps(share: Light, full: int, kind: type[np.uint8] | type[np.uint16]) -> NDArray[np.uint8 | np.uint16]:
    return np.asarray(np.clip(np.rint(full * share), 0, full).astype(kind))


_WARM = (0.8, 0.95, 1.0)
"""Blue, green and red light of a warm white panel, over red."""


def _jpeg(quality: int, subsampled: bool) -> Callable[[Light], bytes]:
    def encode(light: Light) -> bytes:
        colours = SRGB.number(np.clip(light[..., None] * np.array(_WARM), 0.0, 1.0))
        sampling = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420 if subsampled else cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
        flags = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling]
        return bytes(cv2.imencode(".jpg", _steps(colours, 255, np.uint8), flags)[1].tobytes())

    return encode


def linear_png(full: int = 65535) -> Stored:
    """Return PNGs of 16 bits that are linear in light, with ``full`` where light is 1, and say so themselves."""
    return Stored(suffix=".png", transfer="linear", bits=16, encode=lambda light: encode_light_png(_steps(light, full, np.uint16)))


def srgb_jpeg(quality: int, *, subsampled: bool = False) -> Stored:
    """Return JPEGs of a slightly warm panel, of which the scene says that they are sRGB."""
    return Stored(suffix=".jpg", transfer="srgb", bits=8, encode=_jpeg(quality, subsampled))


def gamma_png(exponent: float) -> Stored:
    """Return PNGs of 8 bits bent by a gamma, of which the scene says that they are linear."""

    def encode(light: Light) -> bytes:
        return encode_png(_steps(np.clip(light, 0.0, 1.0) ** (1.0 / exponent), 255, np.uint8))

    return Stored(suffix=".png", transfer="linear", bits=8, encode=encode)


@dataclass(frozen=True, kw_only=True)
class Damage:
    """One way in which a laboratory's pictures go wrong."""

    name: str
    why: str
    """How it comes about."""
    light: Callable[[Scan, int], Light] = lambda scan, k: scan.light[k]
    """The picture (H, W) in place of the scan's k-th."""
    stored: Stored = field(default_factory=linear_png)
    scene: Callable[[Scene], Scene] = lambda scene: scene
    """What the scene says; the pictures stay as they are."""
    table_deg: Callable[[Scan, int], float | None] = lambda scan, k: scan.frames[k].table_deg
    """What is said of the table's angle."""
    keeps: Callable[[Scan, int], bool] = lambda _scan, _k: True
    """Which pictures there are at all."""

    def write(self, scan: Scan, folder: Path) -> Dataset:
        """Write the damaged dataset, with a link to the scan's truth."""
        frames = []
        for k, before in enumerate(scan.frames):
            if self.keeps(scan, k):
                path = folder / Path(before.file).with_suffix(self.stored.suffix)
                path.parent.mkdir(parents=True, exist_ok=True)
                atomic.write_bytes(path, self.stored.encode(self.light(scan, k)))
                name = path.relative_to(folder).as_posix()
                frames.append(replace(before, file=name, sha256=sha256_of(path), table_deg=self.table_deg(scan, k)))
        shutil.copytree(scan.dataset.folder / "truth", folder / "truth")
        camera = replace(scan.dataset.scene.camera, transfer=self.stored.transfer, bits=self.stored.bits)
        scene = self.scene(replace(scan.dataset.scene, camera=camera))
        written = replace(scan.dataset, folder=folder, scene=scene, frames=tuple(frames))
        return save_dataset(written)
