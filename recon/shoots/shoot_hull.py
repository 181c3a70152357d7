"""Visual hull of a shoot in air, by the same carving as for roots in water."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.hull import carve, surface
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Hull
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.shoots.blades import NEAR_MM, Blades
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Monitor

_DEEP_MM = NEAR_MM / 2.0
"""Depth inside the hull above which space is treated as enclosed, mm. Blades and nearly all stalks are thinner: the
hull of a blade 40 mm wide, in views 9 degrees apart, is 1.6 mm thick. No part of the twin's default shoot is deeper
than 1.5 mm, whereas 45 % of a cup of nine touching leaves is deeper."""
SLACK_PX = 0.3
"""Assumed error of the outlines' positions, px. It is the same as for roots."""
_ROOM = 0.8
"""Maximum radius of a shoot, as a fraction of the distance between the nearest camera and the net pot's top."""


def carve_shoot(
    drawn: Sequence[Silhouette], views: Sequence[View], scene: Scene, *, finest_mm: float, monitor: Monitor
) -> tuple[Hull, trimesh.Trimesh]:
    """Carve the visual hull of V silhouettes of a shoot in the air above the net pot.

    Parameters
    ----------
    drawn, views : (V,)
        Silhouettes and their cameras.
    scene : Scene
        Scene with the net pot and the canister.
    finest_mm : float
        Edge length of the finest octree nodes, mm.
    monitor : Monitor
        Receives progress messages.

    Returns
    -------
    hull : Hull
        Visual hull.
    mesh : trimesh.Trimesh
        Surface of the hull, canister frame, mm.

    Raises
    ------
    UserError
        If the silhouettes have no volume in common, or one without a surface.
    """
    order = carve.spread(len(views))
    drawn, views = [drawn[k] for k in order], [views[k] for k in order]
    room = _room(drawn, views, scene)
    maps = DistanceMaps.compute(drawn, "shoot", monitor)
    optics = replace(Optics.from_scene(scene), n_wall=1.0, n_water=1.0, water_z_mm=room.top_mm, tank=None, unobstructed=True)
    grid = room.grid(finest_mm)
    hull = carve.carve(ViewBank.pack(views, optics), maps, grid, room, slack_px=SLACK_PX)
    mesh = surface.surface(hull.leaves)
    if not len(mesh.faces):
        raise UserError("the shoot's silhouettes have no volume in common. The cameras do not match the pictures, or there is no shoot.")
    return hull, mesh


def stalks_mm3(hull: Hull, blades: Blades) -> float:
    """Return the volume of the stem and the petioles, mm3.

    These are the parts of the hull whose nearest surface point is not on a blade.
    """
    return hull.leaves.select(~blades.near(hull.leaves.middles_mm)).volume_mm3()


def enclosed_share(hull: Hull, blades: Blades) -> float:
    """Return the fraction of a hull's volume that lies deeper inside the hull than leaves and stalks do."""
    depth_mm = cKDTree(blades.points_mm).query(hull.leaves.middles_mm, workers=-1)[0]
    return hull.leaves.select(depth_mm > _DEEP_MM).volume_mm3() / hull.leaves.volume_mm3()


def _room(drawn: Sequence[Silhouette], views: Sequence[View], scene: Scene) -> Water:
    """Return the space in air in which the shoot may lie.

    The space contains everything that the silhouettes show, up to the maximum radius of a shoot.
    """
    top_mm = scene.net_pot.top_mm
    found = [(view, _outer_rays(silhouette, view)) for silhouette, view in zip(drawn, views, strict=True)]
    near_mm = min(_distance_mm(view, top_mm) for view in views)
    wide_mm = max(_radius_mm(rays, view, top_mm) for view, rays in found)
    reach_mm = max(scene.net_pot.outer_radius_mm, min(wide_mm, _ROOM * near_mm))
    high_mm = top_mm
    for view, rays in found:
        inward = rays[rays[:, 0] < 0.0]
        climb = float((inward[:, 2] / -inward[:, 0]).max(initial=-np.inf))
        # horizontal distances from the camera between which its rays are in the space; not 0, as there may be no ray
        ends_mm = max(1e-9, view.rho_mm - reach_mm), view.rho_mm + reach_mm
        high_mm = max(high_mm, float(view.centre_mm[2]) + max(climb * end_mm for end_mm in ends_mm))
    return Water(reach_mm, high_mm + 2.0, top_mm)


def _distance_mm(view: View, top_mm: float) -> float:
    """Return the distance between a camera and the centre of the net pot's top, mm."""
    return float(np.hypot(view.rho_mm, view.centre_mm[2] - top_mm))


def _radius_mm(rays: NDArray[np.float64], view: View, top_mm: float) -> float:
    """Return the maximum radius of a shoot, given the outer rays (N, 3) to it in a view, mm.

    The radius is infinite if a ray leads away from the centre of the net pot's top, and 0 without rays. Let D be the
    distance between the camera and this centre, and e the angle at which the camera looks down on it. The depth of a
    point above the top, at distance r from the axis, is at most D + r cos(e) in the direction of the centre. Its
    lateral distance is thus at most s (D + r cos(e)), where s is the lateral slope of its ray. For the outermost point
    of the shoot, in the view that shows it at the side, the lateral distance is r, so that r = s D / (1 - s cos(e)).
    The limit of s cos(e) only avoids a division by zero, because r exceeds D from there on.
    """
    far_mm = _distance_mm(view, top_mm)
    depth = rays @ np.array([-view.rho_mm, 0.0, top_mm - view.centre_mm[2]]) / far_mm
    if (depth <= 0.0).any():
        return float("inf")
    aside = float(np.abs(rays[:, 1] / depth).max(initial=0.0))
    return aside * far_mm / (1.0 - min(aside * view.rho_mm / far_mm, 0.5))


def _outer_rays(silhouette: Silhouette, view: View) -> NDArray[np.float64]:
    """Return the directions (N, 3) of the rays through the convex hull of the covered pixels, in the azimuth frame.

    The axis lies in the direction of -x. The extreme directions are at the hull.
    """
    covered = np.argwhere(silhouette.coverage > 0.5)[:, ::-1]
    if not len(covered):
        return np.empty((0, 3))
    hull = cv2.convexHull(covered.astype(np.int32))[:, 0]
    return np.asarray(cameras.to_azimuth(view, cameras.camera_directions(view.camera, hull)))
