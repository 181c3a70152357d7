"""The visual hull of a shoot in air, by the carving that finds roots in water."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.hull import carve, surface
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Hull
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.shoots.blades import NEAR_MM, Blades
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Monitor

_DEEP_MM = NEAR_MM / 2.0
"""No blade and hardly a stalk reaches so deep: the hull of a blade 40 mm wide, seen from 9 degrees apart, is 1.6 mm
thick. Of the twin's default shoot nothing lies deeper than 1.5 mm, of a cup of nine leaves that touch, 45 %."""
SLACK_PX = 0.3
"""As for roots: how far an outline may be off."""
_ROOM = 0.8
"""Share of the nearest camera's distance within which a shoot is looked for."""


def find(
    drawn: Sequence[Silhouette], views: Sequence[View], scene: Scene, *, finest_mm: float, monitor: Monitor
) -> tuple[Hull, trimesh.Trimesh]:
    """Carve the hull of silhouettes (V) out of the air above the net pot.

    Parameters
    ----------
    drawn, views : (V,)
        Silhouettes and cameras.
    scene : Scene
        Net pot and canister.
    finest_mm : float
        Edge of the finest nodes.
    monitor : Monitor
        Hears how far it is.

    Returns
    -------
    hull : Hull
    mesh : trimesh.Trimesh
        Its surface, canister frame, mm.

    Raises
    ------
    UserError
        Where the silhouettes have no volume in common.
    """
    order = carve.spread(len(views))
    drawn, views = [drawn[k] for k in order], [views[k] for k in order]
    room = _room(drawn, views, scene)
    maps = DistanceMaps.compute(drawn, "shoot", monitor)
    optics = replace(
        Optics.from_scene(scene),
        outer_radius_mm=room.radius_mm,
        inner_radius_mm=room.radius_mm,
        n_wall=1.0,
        n_water=1.0,
        floor_z_mm=room.bottom_mm,
        water_z_mm=room.top_mm,
        bottom_z_mm=room.bottom_mm,
        tank=None,
    )
    grid = room.grid(finest_mm)
    hull = carve.carve(ViewBank.pack(views, optics), maps, grid, room, slack_px=SLACK_PX)
    if hull.leaves.volume_mm3() == 0.0:
        raise UserError("the shoot's silhouettes have no volume in common: the cameras do not fit the pictures, or there is no shoot")
    index, size, occupancy = surface.to_voxels(hull.leaves, 1)
    return hull, surface.surface(index, size, occupancy, origin_mm=np.asarray(grid.origin_mm), voxel_mm=grid.size_mm)


def stalks_mm3(hull: Hull, blades: Blades) -> float:
    """Return the volume of the part of a hull that is nearest to stem or petioles."""
    return hull.leaves.select(~blades.near(hull.leaves.middles_mm)).volume_mm3()


def enclosed_share(hull: Hull, blades: Blades) -> float:
    """Return the share of a hull's volume that lies deeper in it than leaves and stalks do."""
    depth_mm = cKDTree(blades.points_mm).query(hull.leaves.middles_mm, workers=-1)[0]
    return hull.leaves.select(depth_mm > _DEEP_MM).volume_mm3() / hull.leaves.volume_mm3()


def _room(drawn: Sequence[Silhouette], views: Sequence[View], scene: Scene) -> Water:
    """Return the air that holds what the pictures show, at the farthest that a shoot may stand."""
    top_mm = scene.net_pot.top_mm
    reach_mm, high_mm = scene.net_pot.outer_radius_mm, top_mm
    for silhouette, view in zip(drawn, views, strict=True):
        rows, columns = np.nonzero(silhouette.coverage > 0.5)
        if not len(rows):
            continue
        (fx, fy), (cx, cy) = view.camera.focal_px, view.camera.principal_px
        # what stands off the axis by r looks as wide as r / (distance - r) at most
        aside = float(np.abs(columns - cx).max()) / fx
        reach_mm = max(reach_mm, min(_ROOM, aside / (1.0 - min(aside, 0.5))) * view.rho_mm)
        up, axis = float((cy - rows.min()) / fy), view.cam_from_canister[:3, 2]
        forward = np.sqrt(1.0 - axis[2] ** 2)  # horizontal part of the optical axis
        climb = (axis[2] - up * axis[1]) / (forward - up * axis[2])  # of the highest ray, a horizontal mm
        high_mm = max(high_mm, float(view.centre_mm[2]) + max(climb * (view.rho_mm + side * reach_mm) for side in (-1.0, 1.0)))
    return Water(reach_mm, high_mm + 2.0, top_mm)
