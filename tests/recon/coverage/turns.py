"""A turn of a canister, without pictures."""

from dataclasses import replace

import numpy as np

from rhizotwin.recon.coverage import background
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes import frames, plan
from rhizotwin.scenes.model import Camera, Scene

Turn = tuple[dict[int, cameras.View], Optics, dict[int, np.ndarray]]


def turned(views: int) -> Turn:
    """Return cameras round a canister, its optics, and what of the water each sees."""
    scene = Scene(camera=Camera().resized((400, 300)))
    scene = replace(scene, plan=replace(scene.plan, rings=(replace(scene.plan.rings[0], views=views),)))
    optics = Optics.of(scene)
    seen_from = {
        v.index: cameras.View(camera=scene.camera, cam_from_canister=v.cam_from_rig @ frames.rotation_z(np.deg2rad(v.table_deg)))
        for v in plan.views(scene)
    }
    return seen_from, optics, {k: background.water_mask(view, optics, scene) for k, view in seen_from.items()}
