"""Pictures of the twin, rendered with `sim`, with camera noise and ground truth.

This is the only module of the package rig that uses `sim`. It imports `sim` only for rendering or drawing random
values, so that `rig` works without Mitsuba. Callers that request rendered pictures must have selected the Mitsuba
variant before.
"""

from __future__ import annotations

import zlib
from collections import OrderedDict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rhizotwin.rig.twin.world import Sight
from rhizotwin.scenes import frames
from rhizotwin.scenes.atomic import write_image
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import Grey
from rhizotwin.scenes.truth import save_truth

if TYPE_CHECKING:
    from rhizotwin.sim.render import Renderer
    from rhizotwin.sim.specimen import SpecimenSolid
    from rhizotwin.sim.world import TrueCamera, World

Light = NDArray[np.float32]
_NOISE = 106  # second key of the random stream of the noise; the keys of the devices are in `rig.twin.world`
_KEPT = 8
"""Number of rendered pictures that are kept in memory. A picture is reused if the state of the rig is the same."""


@dataclass(frozen=True, kw_only=True)
class RigErrors:
    """Errors of the rig, drawn from a scene's disturbances with a given seed."""

    table_from_canister: frames.Array
    canister_from_strip: frames.Array
    distortion: tuple[float, float, float, float, float]
    ring_cameras: tuple[frames.Array, ...]
    """Transforms ``cam_from_rig``, one for each ring of the capture plan. They apply to a camera that is placed by
    hand."""


def draw(scene: Scene, *, seed: int) -> RigErrors:
    """Draw the errors of the rig with `sim.world.draw_world`.

    For the same scene and seed, the simulated pictures and the twin have the same errors.
    """
    from rhizotwin.sim.world import draw_world

    world = draw_world(scene, seed=seed)
    firsts = np.cumsum([0, *(ring.views for ring in scene.plan.rings)])[:-1]
    return RigErrors(
        table_from_canister=world.table_from_canister,
        canister_from_strip=world.canister_from_strip,
        distortion=world.distortion,
        ring_cameras=tuple(world.cameras[first].cam_from_rig for first in firsts),
    )


def calibrated_scene(scene: Scene) -> Scene:
    """Return the scene as it is known in a laboratory, with the nominal rig and the calibrated lens."""
    from rhizotwin.sim.world import scene_for_reconstruction

    return scene_for_reconstruction(scene)


class RenderedPictures:
    """Renderer of a scene for any pose of the camera and any table angle.

    It uses the same method as `sim.simulate` with the ``backlit`` fidelity.

    Parameters
    ----------
    scene
        Scene with its specimen (None for an empty canister) and disturbances. Disturbances of arm and table are
        simulated by the devices of the twin instead.
    seed
        Random seed of the disturbances and of the noise.
    samples
        Number of rays per pixel, which must be a square number; None for the default.
    """

    def __init__(self, scene: Scene, *, seed: int, samples: int | None = None) -> None:
        self._scene = scene
        self._grey = replace(scene.disturbances, white_balance_wander=0.0)  # the rig's camera delivers grey pictures
        self._seed = seed
        self._samples = samples
        self._world: World | None = None
        self._solid: SpecimenSolid | None = None
        self._renderers: dict[tuple[bool, bool, str], Renderer] = {}
        self._pictures: OrderedDict[bytes, Grey] = OrderedDict()
        self._masks: dict[bytes, bytes] = {}  # compressed

    def picture(self, sight: Sight) -> Grey:
        """Return the picture (H, W) that the camera stores for a given state of the rig.

        The picture depends only on the state, the scene and the seed.
        """
        from rhizotwin.sim.exposure import expose

        key = sight.key
        if key not in self._pictures:
            rng = np.random.default_rng([self._seed, _NOISE, int.from_bytes(key, "little")])
            light = self.light(sight) * np.float32(sight.exposure)
            self._pictures[key] = np.asarray(expose(light, self._scene.camera, self._grey, rng=rng))
            if len(self._pictures) > _KEPT:
                self._pictures.popitem(last=False)
        self._pictures.move_to_end(key)
        return self._pictures[key].copy()

    def light(self, sight: Sight) -> Light:
        """Return the linear light (H, W), to which all lamps contribute.

        A value of 1 is full scale at the nominal exposure.
        """
        width, height = self._scene.camera.image_wh
        both = min(sight.panel, sight.front)
        light = np.zeros((height, width), np.float32)
        for level, panel, front in ((both, True, True), (sight.panel - both, True, False), (sight.front - both, False, True)):
            if level > 0.0:
                light += np.float32(level) * self._look(sight, panel=panel, front=front)
        return light

    def write_truth(self, folder: Path, taken: list[tuple[str, Sight]]) -> None:
        """Write the ``truth`` folder of a dataset from the file name and the true state of each picture.

        The scene must have a specimen.
        """
        from rhizotwin.sim.truth import build_truth, write_specimen

        world = self._draw_world()
        if self._solid is None:
            raise ValueError(f"scene {self._scene.name!r} has no specimen")
        write_specimen(folder, self._solid)
        for file, sight in taken:
            if sight.place_key not in self._masks:
                self._look(sight, panel=True, front=True)
            mask = np.frombuffer(zlib.decompress(self._masks[sight.place_key]), np.uint16)
            write_image(folder / "truth" / "masks" / Path(file).name, mask.reshape(self._scene.camera.image_wh[::-1]))
        save_truth(folder, build_truth(world, self._solid, [(file, _camera(sight)) for file, sight in taken]))

    def _look(self, sight: Sight, *, panel: bool, front: bool) -> Light:
        """Render the light (H, W) of one or both lamps at full brightness.

        The mask of the specimen, which does not depend on the lamps, is cached.
        """
        from rhizotwin.sim.exposure import mask_picture

        renderer = self._renderer(panel=panel, front=front, band=sight.band)
        image, coverage = renderer.look(_camera(sight), ring=self._nearest_ring(sight), twist_deg=sight.twist_deg)
        if sight.place_key not in self._masks:
            self._masks[sight.place_key] = zlib.compress(mask_picture(coverage).tobytes(), 1)
        return image

    def _renderer(self, *, panel: bool, front: bool, band: str) -> Renderer:
        from rhizotwin.sim.bands import scene_in_band
        from rhizotwin.sim.render import Renderer

        if (panel, front, band) not in self._renderers:
            world = self._draw_world()
            scene = scene_in_band(self._scene, band)
            lights = scene.lights
            lit = replace(lights, backlight_level=lights.backlight_level * panel, front_level=lights.front_level * front)
            scene = replace(scene, lights=lit)
            self._renderers[panel, front, band] = Renderer(scene, replace(world, scene=scene), self._solid, samples=self._samples)
        return self._renderers[panel, front, band]

    def _draw_world(self) -> World:
        from rhizotwin.sim.specimen import build_specimen
        from rhizotwin.sim.world import draw_world

        if self._world is None:
            self._world = draw_world(self._scene, seed=self._seed)
            self._solid = build_specimen(self._scene) if self._scene.is_planted else None
        return self._world

    def _nearest_ring(self, sight: Sight) -> int:
        """Return the index of the ring whose camera position is nearest to that of the camera.

        The lens is focused as in this ring.
        """
        x, y, z = frames.invert(sight.cam_from_rig)[:3, 3]
        rings = self._scene.plan.rings
        return min(range(len(rings)), key=lambda i: np.hypot(np.hypot(x, y) - rings[i].distance_mm, z - rings[i].height_mm))


def _camera(sight: Sight) -> TrueCamera:
    from rhizotwin.sim.world import TrueCamera

    return TrueCamera(cam_from_rig=sight.cam_from_rig, rig_from_canister=sight.rig_from_canister, table_deg=sight.table_deg)
