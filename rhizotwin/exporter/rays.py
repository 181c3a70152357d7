"""Lines of sight in the water, for programs that accept rays instead of cameras.

Behind a round wall, the lines of sight of a picture do not meet in a point, so that no camera model describes them. In
the water, each is a straight line again. A program that samples a scene along given rays, such as a radiance field,
needs no other description of the refraction.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage import background
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes import atomic, frames, polyline
from rhizotwin.scenes.model import Scene

Array = NDArray[np.float64]

NOTE = (
    "lines of sight in the water, canister frame, mm; NaN where no root in the water can be visible. Points of a ray between the two "
    "distances in single_mm appear in no other pixel; the others, near the wall, may"
)
LOADER = '''"""Rays of an exported picture: python load_rays.py prints their number for each picture."""

import json
from pathlib import Path

import numpy as np


def load(folder):
    """Yield each picture's file name, and origin_mm and direction (H, W, 3), length_mm (H, W), single_mm (H, W, 2)."""
    for picture in json.loads((Path(folder) / "rays.json").read_text(encoding="utf-8"))["pictures"]:
        with np.load(Path(folder) / picture["rays"]) as rays:
            yield picture["file"], {name: rays[name] for name in rays.files}


if __name__ == "__main__":
    for file, rays in load(Path(__file__).parent):
        print(file, np.isfinite(rays["length_mm"]).sum(), "rays")
'''
"""Program in the exported folder that reads the rays with NumPy."""
_SUPPORTS = 0.25, 0.75
"""Two places on a ray, relative to its length, through which it is drawn if the roots moved: then it is slightly curved
in the reconstructed shape."""
_AT_ONCE = 250_000
"""Approximate number of pixels that are traced at once, to limit memory. One takes about 400 bytes."""
_SWAY_STEPS = 3
"""Iterations of the inverse of the roots' motion in a picture. Each reduces the error by the motion per depth, which is
a few hundredths at most."""


@dataclass(frozen=True)
class Rays:
    """Lines of sight of all pixels of a picture in the water."""

    origin_mm: NDArray[np.float32]
    """(H, W, 3) points at which they enter the water, canister frame, mm. All fields are NaN where no root in the water
    can be visible."""
    direction: NDArray[np.float32]
    """(H, W, 3) unit vectors, away from the camera."""
    length_mm: NDArray[np.float32]
    """(H, W) lengths up to the opposite wall, the floor or the surface of the water."""
    single_mm: NDArray[np.float32]
    """(H, W, 2) distances from the origin between which the points of a ray appear in no other pixel."""

    def write(self, file: Path) -> None:
        """Write the rays as a compressed NumPy file."""
        packed = io.BytesIO()
        np.savez_compressed(packed, **{field.name: getattr(self, field.name) for field in fields(self)})
        atomic.write_bytes(file, packed.getvalue())


def single_radius_mm(optics: Optics) -> float:
    """Return the distance from the axis within which each point appears in at most one pixel of a picture, mm.

    It is R_o n_around / n_water: at this distance, the rays of a distant camera form a caustic.
    """
    return min(optics.inner_radius_mm, optics.outer_radius_mm * optics.n_around / optics.n_water)


def trace(view: View, optics: Optics, scene: Scene) -> Rays:
    """Trace the lines of sight of all pixels of a picture into the water.

    Parameters
    ----------
    view, optics : View, Optics
        Calibrated camera, and optics of the canister. If the roots moved between the pictures, the rays are those in
        the reconstructed shape.
    scene : Scene
        Scene with the opaque parts, such as the net pot.
    """
    width, height = view.camera.image_wh
    shown = background.water_mask(view, optics, scene)
    rows = max(1, _AT_ONCE // width)
    bands = [_trace_band(view, optics, shown[first : first + rows], first) for first in range(0, height, rows)]
    origin, direction, length, single = (np.concatenate(part) for part in zip(*bands, strict=True))
    return Rays(origin_mm=origin, direction=direction, length_mm=length[..., 0], single_mm=single)


def _trace_band(view: View, optics: Optics, shown: NDArray[np.bool_], first: int) -> list[NDArray[np.float32]]:
    """Return the fields of `Rays`, each with three axes, for the rows of a mask ``shown`` (h, W) from a first row."""
    height, width = shown.shape
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(first, first + height, dtype=np.float64))
    line, enters = cameras.water_lines(view, optics, np.stack([u.ravel(), v.ravel()], axis=1))
    with np.errstate(invalid="ignore"):
        half_mm, single_mm = (np.sqrt(np.maximum(r**2 - line.b_mm**2, 0.0)) for r in (optics.inner_radius_mm, single_radius_mm(optics)))
        to_top, to_floor = ((z_mm - line.entry_z_mm) / line.slope for z_mm in (optics.water_z_mm, optics.floor_z_mm))
        level_mm = np.minimum(2.0 * half_mm, np.maximum(to_top, to_floor))  # horizontal; one of both is behind
    climb = np.column_stack([line.t, line.slope])
    begin = np.column_stack([line.b_mm[:, None] * line.nu - half_mm[:, None] * line.t, line.entry_z_mm])
    straight = [begin + (share * level_mm)[:, None] * climb for share in (0.0, *_SUPPORTS)]
    origin, near, far = (_without_sway(view, optics, frames.apply(frames.invert(view.azimuth_from_canister), end)) for end in straight)
    steep = np.linalg.norm(climb, axis=1)[:, None]
    traced = (
        origin,
        polyline.unit_vectors(far - near),
        steep * level_mm[:, None],
        steep * np.clip(np.column_stack([half_mm - single_mm, half_mm + single_mm]), 0.0, level_mm[:, None]),
    )
    known = (enters & shown.ravel())[:, None]
    return [np.where(known, values, np.nan).astype(np.float32).reshape(height, width, -1) for values in traced]


def _without_sway(view: View, optics: Optics, points_mm: Array) -> Array:
    """Return the points (N, 3) of the shape that a view's sway moves to given points (N, 3)."""
    found = points_mm
    for _ in range(_SWAY_STEPS):
        found = found + points_mm - cameras.apply_sway(view, optics, found)
    return found
