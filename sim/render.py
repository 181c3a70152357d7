"""Render the views of a scene with drawn disturbances.

Each view is rendered independently of all others. In most pixels of a backlit picture the light varies smoothly, which
is tested with rays through the corners of the pixels. All rays of a pixel are only traced if its corner rays meet
different surfaces, if the light varies nonlinearly between them, around edges on the marker strip, and around fine
structures that may lie between the corners.
"""

from __future__ import annotations

from typing import Any, Literal

import cv2
import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.sim import hanging, lights, optics, sensor, strip, tank
from rhizotwin.sim.backlit import Backlit, Way
from rhizotwin.sim.clear_wall import ClearWall
from rhizotwin.sim.specimen import SpecimenSolid, sleeve
from rhizotwin.sim.world import TrueCamera, World

Fidelity = Literal["backlit", "path"]
DEFAULT_SAMPLES: dict[str, int] = {"backlit": 16, "path": 32}
"""Default number of rays per pixel, keyed by fidelity. For ``backlit`` they form a lattice of 4 x 4 rays. For ``path``
they are twice as many random paths, whose pictures are for viewing and not for measurements."""
PATH_DEPTH = 16
"""Maximum number of surfaces on a path. It is twice the eight surfaces on the straight path through the canister or
the tank."""
MAX_RAYS = 8_000_000
"""Maximum number of rays per kernel launch. It limits the memory that is needed for large sensors."""
MAX_PATHS = 32_000_000
"""Maximum number of paths per kernel launch of the path tracer. It can be larger than `MAX_RAYS`, because these kernels
store only the picture."""
DIRT_REACH_PX = 3.0
"""Radius around a ray within which dirt is searched, in pixels on the farthest wall. It is increased in proportion to
the blur. At the flanks of the canister, where the wall is seen at 70 degrees, a pixel covers three times its width."""
MOST_BEND = 1e-3
"""Maximum second difference of the light between neighbouring corners of a smooth pixel, as a fraction of full scale.
If the light is averaged over the four corners, the error is a twelfth of this difference in each direction."""
FINEST_PX = 2.0
"""Minimum width of structures of the marker strip that the corners of pixels show, pixels. All rays are traced where
they are finer."""
BETWEEN = ((0, 1), (1, 3), (2, 0), (3, 2))
"""Cells of a 4 x 4 lattice, as column and row, through which rays search a pixel for fine structures. There is one cell
in each column and each row."""
ROOM_MARGIN_MM = 3.0
"""Margin of the region that encloses all fine structures, mm. It is wider than a pixel, so that a pixel at the region's
boundary contains no fine structure."""
SWAYS = 5.0
"""Maximum sway of a specimen that is taken into account in the region of fine structures, in standard deviations."""
_TRACING = 21  # key of the path tracer's random stream

Image = NDArray[np.float32]


def check_samples(scene: Scene, fidelity: str, samples: int | None) -> int:
    """Validate the fidelity and the number of rays per pixel, and return this number.

    Parameters
    ----------
    scene : Scene
        Scene to render.
    fidelity : str
        Method of rendering, see `Renderer`.
    samples : int or None
        Number of rays per pixel. None: default of the fidelity.

    Raises
    ------
    UserError
        If a value is invalid, or the fidelity does not support the lights of the scene.
    """
    if fidelity not in DEFAULT_SAMPLES:
        raise UserError(f"fidelity {fidelity!r} is not known; give one of: {', '.join(DEFAULT_SAMPLES)}")
    count = DEFAULT_SAMPLES[fidelity] if samples is None else samples
    if count < 1 or (fidelity == "backlit" and round(count**0.5) ** 2 != count):
        raise UserError(
            f"samples is {count}, but the number of rays per pixel must be positive, "
            "and a square number such as 4, 9 or 16 for the fidelity 'backlit'"
        )
    if fidelity == "path" and scene.lights.side_level > 0.0:
        raise UserError("fidelity 'path' has no side lights (lights.side_level); use the fidelity 'backlit'")
    return count


class Renderer:
    """Renderer for the views of a scene with drawn disturbances.

    Parameters
    ----------
    scene : Scene
        Scene with the nominal rig.
    world : World
        World with its drawn disturbances.
    solid : SpecimenSolid or None
        Specimen. None: empty canister.
    fidelity : {"backlit", "path"}
        Method of rendering. ``backlit`` traces the primary refracted path on a regular sub-pixel lattice, without
        noise. ``path`` is Mitsuba's path tracer.
    samples : int or None
        Number of rays per pixel, a square number for ``backlit``. None: default of the fidelity.
    """

    def __init__(
        self, scene: Scene, world: World, solid: SpecimenSolid | None, *, fidelity: Fidelity = "backlit", samples: int | None = None
    ) -> None:
        self.samples = check_samples(scene, fidelity, samples)
        self.side = round(self.samples**0.5)
        self.scene = scene
        self.world = world
        self.fidelity = fidelity
        self.lights = scene.lights
        self.image_wh = scene.camera.image_wh
        wrong = scene.disturbances
        hairs = None if solid is None or wrong.root_hair_mm == 0.0 else sleeve(solid, wrong.root_hair_mm)
        self.hanging: list[hanging.HangingObject] = []
        if solid is not None and wrong.sway_mm > 0.0:
            parts = {optics.SPECIMEN: solid.vertices} | ({} if hairs is None else {optics.HAIRS: hairs.vertices})
            self.hanging = [hanging.HangingObject.of(name, vertices, solid) for name, vertices in parts.items()]
        media = wrong.turbidity_per_mm > 0.0 or scene.water.absorption_per_mm > 0.0 or wrong.root_mu_per_mm is not None or hairs is not None
        self.lit_scene: mi.Scene | None = None
        if fidelity == "path":
            self.lit_scene = optics.build(scene, world, solid, hairs)
            self.path = mi.load_dict({"type": "volpath" if media else "path", "max_depth": PATH_DEPTH, "rr_depth": 64})
        farthest_mm = max(np.hypot(ring.distance_mm, ring.height_mm) for ring in scene.plan.rings) + scene.canister.outer_radius_mm
        pixel_mm = farthest_mm / min(scene.camera.as_pinhole(farthest_mm).focal_px)
        self.fine = optics.fine_things(world, solid, hairs, slack_mm=pixel_mm)
        margin_mm = ROOM_MARGIN_MM + SWAYS * wrong.sway_mm + wrong.root_hair_mm
        room = optics.fine_things_room(world, solid, margin_mm=margin_mm) if self.fine is not None else None
        self.lamps = lights.Lamps(scene, world)
        rig, specimen = optics.build_rig(scene, world), None if solid is None else optics.build_specimen(scene, world, solid, hairs)
        self.swaying = [part for part in (specimen, self.fine, self.lit_scene) if part is not None]
        parallel = scene.camera.kind == "telecentric"
        wall = ClearWall.of(scene, world, rig.shapes(), reach_mm=_reach_mm(solid) + SWAYS * wrong.sway_mm)
        self.backlit = Backlit(rig, specimen, self.lamps, media=media, room=room, wall=wall, roots=optics.SPECIMEN, parallel=parallel)
        self.targets = [optics.SHOOT if ring.kind == "shoot" else optics.SPECIMEN for ring in scene.plan.rings]
        self.strip = self.backlit.shapes[optics.STRIP]
        self.coarse = mi.Float(FINEST_PX * pixel_mm / strip.finest_mm(scene.strip, scene.net_pot))
        dr.make_opaque(self.coarse)
        self.blur_px = _blur_px(scene)
        self.near_dirt: Backlit | None = None
        if wrong.dust_specks or wrong.scratches:  # smaller than pixels
            reach_mm = DIRT_REACH_PX * (1.0 + self.blur_px) * pixel_mm
            dirty_rig = optics.build_rig(scene, world, dirt_reach_mm=reach_mm)
            self.near_dirt = Backlit(dirty_rig, None, self.lamps, media=False, parallel=parallel)
            self.near_dirt.aim(optics.OUTER_DIRT)
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
        """Render view k of the capture plan.

        Returns
        -------
        image : (H, W) float32
            Linear light, as a fraction of full scale.
        coverage : (H, W) float32
            Fraction of each pixel's refracted primary rays that meet the specimen, or the shoot in a ring of the shoot.
        """
        return self.look(self.world.cameras[k], ring=self.ring_of_view[k], stream=k)

    def look(self, camera: TrueCamera, *, ring: int, stream: int = 0, twist_deg: float | None = None) -> tuple[Image, Image]:
        """Render the view of a camera at any position.

        Parameters
        ----------
        camera : TrueCamera
            True poses of camera and canister.
        ring : int
            Index of the ring that determines the focus of the lens.
        stream : int
            Key of the path tracer's random stream, and index of the view whose sway is applied.
        twist_deg : float or None
            Twist of the lowest tips relative to the pot, deg, which replaces the sway of the view. None: sway of the
            view.

        Returns
        -------
        (H, W), (H, W) float32 arrays
            Linear light and coverage, see `view`.
        """
        if self.hanging:
            tip_mm = self.world.sway_mm[stream] if twist_deg is None else (0.0, 0.0)
            for scene in self.swaying:
                hanging.sway(scene, self.hanging, tip_mm, twist_deg or 0.0)
        eye = self.sensors[ring]
        sensor.set_pose(eye, camera.cam_from_canister)
        self.lamps.place(camera)
        for built in (self.backlit.scene, *([self.lit_scene] if self.fidelity == "path" else [])):
            tank.place(built, self.scene, camera.rig_from_canister, radius_mm=self.world.canister.outer_radius_mm)
        self.backlit.aim(self.targets[ring])
        image, coverage, mixed = self._render_from_corners(eye)
        # all pixels of shoots are refined, because leaves seen on edge are thinner than a pixel
        self._refine(eye, image, coverage, mixed | (self.targets[ring] == optics.SHOOT))
        if self.fidelity == "path":
            lights.place(self.lit_scene, self.lights, camera)
            image = self._path_trace(eye, stream)
        if self.world.highlight is not None:
            image = image + self.world.highlight.astype(np.float32)
        return image, coverage

    def _path_trace(self, eye: Any, stream: int) -> Image:
        """Render a view (H, W) with the path tracer, in as many passes as the memory requires."""
        width, height = self.image_wh
        most = max(1, MAX_PATHS // (width * height))
        seeds = np.random.default_rng([self.world.seed, _TRACING, stream])
        total = np.zeros((height, width), dtype=np.float32)
        for start in range(0, self.samples, most):
            count = min(most, self.samples - start)
            seed = int(seeds.integers(2**31))
            light = mi.render(self.lit_scene, sensor=eye, integrator=self.path, spp=count, seed=seed)
            total += np.array(light, dtype=np.float32).reshape(height, width) * np.float32(count / self.samples)
        return total

    def _render_from_corners(self, eye: Any) -> tuple[Image, Image, NDArray[np.bool_]]:
        """Return the light and the coverage (H, W), computed from rays through the corners of the pixels.

        A mask (H, W) of the pixels that need more rays is also returned.
        """
        width, height = self.image_wh
        index = dr.arange(mi.UInt32, (width + 1) * (height + 1))
        u, v = mi.Float(index % (width + 1)) / width, mi.Float(index // (width + 1)) / height
        ray, _ = eye.sample_ray(0.0, 0.0, mi.Point2f(u, v), mi.Point2f(0.5))
        way = self.backlit.follow(ray)
        on_strip = way.end == self.strip
        is_fine = on_strip & (way.facing < self.coarse)
        dr.eval(*way, on_strip, is_fine)
        shape = (height + 1, width + 1)
        light, coverage = (np.array(value).reshape(shape) for value in (way.light, way.coverage))
        bent = _second_difference(light) > MOST_BEND
        edges = _corners_differ(np.array(way.course).reshape(shape))
        if self.fine is not None:
            found = self._count_fine_hits(self.fine, way)
            edges |= _combine_corners(np.array(way.spans).reshape(shape), np.maximum) > 1
            edges |= (found > 0) & (found < len(BETWEEN))
            edges |= _filter_square(found, 1, cv2.dilate) != _filter_square(found, 1, cv2.erode)
        blur = int(np.ceil(self.blur_px))
        printed = _combine_corners(bent & np.array(on_strip).reshape(shape), np.maximum)
        mixed = (
            _filter_square(edges.astype(np.uint8), 1 + blur, cv2.dilate) | _filter_square(printed.astype(np.uint8), blur, cv2.dilate) > 0
        )
        if self.near_dirt is not None:
            dirty = self.near_dirt.follow(ray).coverage
            mixed |= _combine_corners(np.array(dirty).reshape(shape), np.maximum) > 0
        if self.fidelity == "backlit":
            mixed |= _combine_corners(bent | np.array(is_fine).reshape(shape), np.maximum)
        return _mean_of_corners(light), _mean_of_corners(coverage), mixed

    def _count_fine_hits(self, fine: mi.Scene, way: Way) -> NDArray[np.uint8]:
        """Count, for each pixel (H, W), the rays between its corners that meet a fine structure.

        The paths of these rays are interpolated from those of the corner rays.
        """
        width, height = self.image_wh
        pixel = dr.arange(mi.UInt32, width * height)
        first = pixel // width * (width + 1) + pixel % width
        corners = [first, first + 1, first + width + 1, first + width + 2]
        active = mi.Bool(True)
        for corner in corners:
            active &= dr.gather(mi.UInt32, way.spans, corner) == 1
        starts = [dr.gather(mi.Point3f, way.start, corner, active) for corner in corners]
        headings = [dr.gather(mi.Vector3f, way.heading, corner, active) for corner in corners]
        count = mi.UInt32(0)
        for column, row in BETWEEN:
            u, v = (column + 0.5) / len(BETWEEN), (row + 0.5) / len(BETWEEN)
            shares = ((1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v)
            start, heading = (sum(share * at for share, at in zip(shares, ends, strict=True)) for ends in (starts, headings))
            count[fine.ray_test(mi.Ray3f(mi.Point3f(start), dr.normalize(mi.Vector3f(heading))), True, active)] += 1
        return np.array(count).astype(np.uint8).reshape(height, width)

    def _refine(self, eye: Any, image: Image, coverage: Image, mixed: NDArray[np.bool_]) -> None:
        """Trace a regular lattice of primary rays in each masked pixel, and average them.

        The images (H, W) are modified in place.
        """
        width, height = self.image_wh
        side = self.side if self.fidelity == "backlit" else 4
        chosen = np.flatnonzero(mixed).astype(np.uint32)
        for first in range(0, len(chosen), MAX_RAYS // side**2):
            pixels = chosen[first : first + MAX_RAYS // side**2]
            index = dr.arange(mi.UInt32, len(pixels) * side * side)
            pixel, ray = dr.gather(mi.UInt32, mi.UInt32(pixels), index // (side * side)), index % (side * side)
            u = (mi.Float(pixel % width) + (mi.Float(ray % side) + 0.5) / side) / width
            v = (mi.Float(pixel // width) + (mi.Float(ray // side) + 0.5) / side) / height
            primary, _ = eye.sample_ray(0.0, 0.0, mi.Point2f(u, v), self._lens_positions(ray, side))
            way = self.backlit.follow(primary)
            dr.eval(way.light, way.coverage)  # one evaluation for both
            image.ravel()[pixels] = np.array(dr.block_sum(way.light, side * side)) / side**2
            coverage.ravel()[pixels] = np.array(dr.block_sum(way.coverage, side * side)) / side**2

    def _lens_positions(self, ray: mi.UInt32, side: int) -> mi.Point2f:
        """Return the position on the lens of each ray of a pixel's lattice, as two coordinates from 0 to 1."""
        u, v = ((cell + 0.5) / side for cell in lens_cells(side))
        return mi.Point2f(*(dr.gather(mi.Float, mi.Float(place.astype(np.float32)), ray) for place in (u, v)))


def lens_cells(side: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the cell of the lens through which each ray of a pixel's lattice passes, row by row.

    The lens is divided into ``side`` columns and ``side`` rows.

    Every cell is used once, so that the rays are centred on the lens. The positions in the pixel and on the lens form
    an orthogonal array of strength 2 (Bush 1952). In any two of the four coordinates the rays are a full lattice, so
    that defocus neither displaces nor sharpens an edge. For sides 2, 6, 8, ... no such simple array exists, and a small
    correlation remains.

    Returns
    -------
    (side^2,), (side^2,) int arrays
        Column and row of the cell.
    """
    i, j = np.arange(side * side) % side, np.arange(side * side) // side
    if side == 4:  # i + a j and i + (a + 1) j in the field of four elements, where a j is:
        a_j = np.array([0, 2, 3, 1])[j]
        return i ^ a_j, i ^ a_j ^ j
    return (i + j) % side, (i + 2 * j) % side


def _reach_mm(solid: SpecimenSolid | None) -> float:
    """Return the largest distance of roots and leaves from the canister's axis, mm."""
    parts = [] if solid is None else [solid.vertices, *([] if solid.shoot is None else [solid.shoot.vertices])]
    return max((float(np.hypot(part[:, 0], part[:, 1]).max()) for part in parts), default=0.0)


def _blur_px(scene: Scene) -> float:
    """Return the radius of the largest circle of confusion, which is the blur to each side of an edge, pixels.

    The circles of confusion of the panel and of the near wall are compared.
    """
    wrong, half = scene.disturbances, 0.0
    for ring in scene.plan.rings:
        focus_mm = ring.distance_mm / np.cos(np.deg2rad(ring.tilt_deg)) + wrong.focus_error_mm
        near_mm, far_mm = ring.distance_mm - scene.canister.outer_radius_mm, ring.distance_mm + scene.lights.backlight_distance_mm
        for depth_mm in (near_mm, far_mm):
            focal_px = max(scene.camera.as_pinhole(depth_mm).focal_px)
            half = max(half, 0.5 * wrong.aperture_mm * focal_px * abs(1.0 / depth_mm - 1.0 / focus_mm))
    return half


def _combine_corners(corners: NDArray[Any], combine: Any) -> NDArray[Any]:
    """Combine the values at the four corners of every pixel.

    The corners have shape (H + 1, W + 1), and the result has shape (H, W). The function ``combine`` has two arrays as
    arguments.
    """
    return np.asarray(combine(combine(corners[:-1, :-1], corners[:-1, 1:]), combine(corners[1:, :-1], corners[1:, 1:])))


def _mean_of_corners(corners: NDArray[np.float32]) -> Image:
    return np.asarray(_combine_corners(corners, np.add) * np.float32(0.25), np.float32)


def _corners_differ(corners: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Return whether the values at the four corners of each pixel (H, W) differ.

    The corners have shape (H + 1, W + 1).
    """
    return np.asarray(_combine_corners(corners, np.maximum) != _combine_corners(corners, np.minimum))


def _second_difference(light: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the second differences of a picture (H, W).

    They are absolute values, and the larger of those along rows and columns is returned.
    """
    kernel = np.array([[1.0, -2.0, 1.0]], np.float32)
    across, down = (np.abs(cv2.filter2D(light, cv2.CV_32F, k, borderType=cv2.BORDER_REPLICATE)) for k in (kernel, kernel.T))
    return np.maximum(across, down)


def _filter_square(values: NDArray[np.uint8], reach: int, combine: Any) -> NDArray[np.uint8]:
    """Dilate or erode a picture (H, W) with a square that extends ``reach`` pixels to each side."""
    return np.asarray(combine(values, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8), borderType=cv2.BORDER_REPLICATE))
