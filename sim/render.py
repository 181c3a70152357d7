"""Pictures of a world: one view at a time, the same whether it is rendered alone or in a set."""

from __future__ import annotations

from typing import Any, Literal

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.sim import integrators, lights, optics, sensor
from rhizotwin.sim.specimen import SpecimenSolid
from rhizotwin.sim.world import TrueCamera, World

Fidelity = Literal["backlit", "path"]
DEFAULT_SAMPLES: dict[str, int] = {"backlit": 16, "path": 32}
PATH_DEPTH = 16
MAX_RAYS = 8_000_000
"""Rays a kernel launch: bounds memory on large sensors."""
MAX_PATHS = 32_000_000
"""The same for path tracing, whose kernels keep nothing but the picture."""
_TRACING = 21  # key of the path tracer's random stream

Image = NDArray[np.float32]


def checked_samples(fidelity: str, samples: int | None) -> int:
    """Return the rays a pixel to use: ``samples``, or the fidelity's default for None; `UserError` where that cannot be."""
    if fidelity not in DEFAULT_SAMPLES:
        raise UserError(f"fidelity {fidelity!r} is unknown, use one of {', '.join(DEFAULT_SAMPLES)}")
    count = DEFAULT_SAMPLES[fidelity] if samples is None else samples
    if count < 1 or (fidelity == "backlit" and round(count**0.5) ** 2 != count):
        raise UserError(f"samples {count}: give a positive number of rays a pixel, for the backlit fidelity a square such as 4, 9 or 16")
    return count


class Renderer:
    """Renders the views of a world.

    Parameters
    ----------
    scene : Scene
        The nominal rig.
    world : World
        Its drawn disturbances.
    solid : SpecimenSolid or None
        The specimen; None renders the empty canister.
    fidelity : {"backlit", "path"}
        ``backlit`` follows the primary refracted path on a regular sub-pixel lattice, without noise; ``path`` is Mitsuba's path tracer.
    samples : int or None
        Rays a pixel; a square number for ``backlit``. None: the default of the fidelity.
    """

    def __init__(
        self, scene: Scene, world: World, solid: SpecimenSolid | None, *, fidelity: Fidelity = "backlit", samples: int | None = None
    ) -> None:
        self.samples = checked_samples(fidelity, samples)
        self.side = round(self.samples**0.5)
        self.world = world
        self.fidelity = fidelity
        self.lights = scene.lights
        self.image_wh = scene.camera.image_wh
        self.mitsuba_scene = optics.build(scene, world, solid)
        wrong = scene.disturbances
        media = wrong.turbidity_per_mm > 0.0 or wrong.root_mu_per_mm is not None
        self.backlit = mi.load_dict(integrators.integrator_dict(media=media, specimen=optics.SPECIMEN))
        self.path = mi.load_dict({"type": "volpath" if media else "path", "max_depth": PATH_DEPTH, "rr_depth": 64})
        self.sensors = [
            mi.load_dict(
                sensor.sensor_dict(
                    scene.camera.focused(1.0 + wrong.focal_error),
                    distortion=world.distortion,
                    aperture_mm=wrong.aperture_mm,
                    focus_mm=ring.distance_mm / np.cos(np.deg2rad(ring.tilt_deg)) + wrong.focus_error_mm,
                    samples=self.samples,
                )
            )
            for ring in scene.plan.rings
        ]
        self.ring_of_view = [index for index, ring in enumerate(scene.plan.rings) for _ in range(ring.views)]

    def view(self, k: int) -> tuple[Image, Image]:
        """Render view k of the plan.

        Returns
        -------
        image : (H, W) float32
            Linear light; 1 is the camera's full scale.
        coverage : (H, W) float32
            Fraction of each pixel whose refracted primary rays meet the specimen.
        """
        return self.look(self.world.cameras[k], ring=self.ring_of_view[k], stream=k)

    def look(self, camera: TrueCamera, *, ring: int, stream: int = 0) -> tuple[Image, Image]:
        """Render what a camera anywhere sees.

        Parameters
        ----------
        camera : TrueCamera
            Where it is, and where the canister is.
        ring : int
            Ring of the plan whose focus the lens has.
        stream : int
            Number of the path tracer's random stream.

        Returns
        -------
        image, coverage
            As from `view`.
        """
        lights.place(self.mitsuba_scene, self.lights, camera)
        eye = self.sensors[ring]
        sensor.set_pose(eye, camera.cam_from_canister)
        image, coverage = self._lattice(eye)
        if self.fidelity == "path":
            image = self._traced(eye, stream)
        return image, coverage

    def _traced(self, eye: Any, stream: int) -> Image:
        """Path-trace a view, in as many passes as memory asks for, each with its own seed."""
        width, height = self.image_wh
        most = max(1, MAX_PATHS // (width * height))
        seeds = np.random.default_rng([self.world.seed, _TRACING, stream])
        total = np.zeros((height, width), dtype=np.float32)
        for start in range(0, self.samples, most):
            count = min(most, self.samples - start)
            seed = int(seeds.integers(2**31))
            light = mi.render(self.mitsuba_scene, sensor=eye, integrator=self.path, spp=count, seed=seed)
            total += np.array(light, dtype=np.float32).reshape(height, width) * np.float32(count / self.samples)
        return total

    def _lattice(self, eye: Any) -> tuple[Image, Image]:
        """Average the backlit integrator over a regular lattice in every pixel."""
        width, height = self.image_wh
        side = self.side if self.fidelity == "backlit" else 4
        rows = max(1, MAX_RAYS // (width * side * side))
        image, coverage = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
        for first in range(0, height, rows):
            count = min(rows, height - first)
            index = dr.arange(mi.UInt32, count * width * side * side)
            pixel, ray = index // (side * side), index % (side * side)
            u = (mi.Float(pixel % width) + (mi.Float(ray % side) + 0.5) / side) / width
            v = (mi.Float(pixel // width) + dr.opaque(mi.Float, first) + (mi.Float(ray // side) + 0.5) / side) / height
            primary, _ = eye.sample_ray(0.0, 0.0, mi.Point2f(u, v), self._on_lens(ray, side))
            light, _, extra = self.backlit.sample(self.mitsuba_scene, None, primary)
            shape = (count, width)
            image[first : first + count] = np.array(dr.block_sum(light[0], side * side)).reshape(shape) / side**2
            coverage[first : first + count] = np.array(dr.block_sum(extra[0], side * side)).reshape(shape) / side**2
        return image, coverage

    def _on_lens(self, ray: mi.UInt32, side: int) -> mi.Point2f:
        """Give every lattice ray of a pixel its place on the lens."""
        u, v = ((cell + 0.5) / side for cell in lens_cells(side))
        return mi.Point2f(*(dr.gather(mi.Float, mi.Float(place.astype(np.float32)), ray) for place in (u, v)))


def lens_cells(side: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the cell of the lens (column, row; each side^2) through which each ray of a pixel's lattice goes, row by row.

    Every cell is used once, so that the lens as a whole is centred, and the places in the pixel and on the lens form an orthogonal array of
    strength 2 (Bush 1952): in any two of the four coordinates the rays are a full lattice, so that defocus neither shifts nor sharpens
    an edge.
    Sides 2, 6, 8 ... have no such array as simple; there a trace of correlation is left.
    """
    i, j = np.arange(side * side) % side, np.arange(side * side) // side
    if side == 4:  # i + a j and i + (a + 1) j in the field of four elements, where a j is:
        a_j = np.array([0, 2, 3, 1])[j]
        return i ^ a_j, i ^ a_j ^ j
    return (i + j) % side, (i + 2 * j) % side
