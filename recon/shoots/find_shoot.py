"""Reconstruction of the shoot from its pictures.

The reconstruction of the shoot is independent of that of the roots. Only the marker strip is used for both.
"""

from __future__ import annotations

import numpy as np

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.calibration.curve import verify_curve
from rhizotwin.recon.calibration.find_cameras import find_cameras
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.read_pictures import Pictures, read_pictures
from rhizotwin.recon.settings import Settings
from rhizotwin.recon.shoots import blades, shoot_hull, shoot_silhouettes
from rhizotwin.recon.shoots.shoot import Shoot
from rhizotwin.recon.shoots.shoot_colour import measure_colour
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.monitor import Monitor

FINEST_MM = 0.27
"""Edge length of the finest octree nodes, mm. It is one pixel of the usual camera at the plant."""
MUCH_ENCLOSED = 0.05
"""Maximum fraction of the hull's volume in spaces enclosed by leaves for the leaf area to be computed. A ball with this
fraction of the volume has a twenty-fifth of the blades' surface area if the hulls of the blades are 0.7 mm thick."""
_ALONG = 0.0175
"""Cosine of the tilt below which a camera looks along the canister's axis, and its optical axis does not determine a
distance to it. It is that of 89 degrees, the maximum tilt of a ring."""
MUCH_HIDDEN = 0.05
"""Maximum fraction of the shoot's pixels that are not in front of the panel (`Shoot.hidden_share`) without a warning.
With a larger fraction, the missing leaf area exceeds the uncertainty of the leaf area (docs/shoots.md)."""


def find_shoot(dataset: Dataset, *, settings: Settings, monitor: Monitor) -> tuple[Shoot | None, tuple[str, ...]]:
    """Reconstruct the shoot of a dataset.

    Returns
    -------
    shoot : Shoot or None
        Reconstructed shoot. None if there are no pictures of the shoot, or if they cannot be used, in which case a
        warning states the reason.
    warnings : tuple of str
        Warnings for the user.
    """
    if dataset.masks or not any(frame.kind == "shoot" for frame in dataset.frames):
        return None, ()
    try:
        shoot = _reconstruct(dataset, settings, monitor)
    except UserError as error:
        return None, (f"the shoot could not be reconstructed: {error}",)
    return shoot, shoot.warnings


def _reconstruct(dataset: Dataset, settings: Settings, monitor: Monitor) -> Shoot:
    """Calibrate the cameras, and reconstruct and measure the shoot."""
    pictures = verify_curve(read_pictures(dataset, kind="shoot", settings=settings.pictures, monitor=monitor), monitor=monitor)
    cameras = find_cameras(pictures, settings=settings.calibration, monitor=monitor)
    with monitor.stage("shoot"):
        drawn = _silhouettes(pictures, cameras)
        views = cameras.by_frame
        hull, mesh = shoot_hull.carve_shoot(
            list(drawn.values()), [views[k] for k in drawn], dataset.scene, finest_mm=FINEST_MM, monitor=monitor
        )
        told = blades.find_blades(mesh)
        colour = measure_colour(pictures, drawn, views, told)
    covered = sum(float(one.coverage.sum()) for one in drawn.values())
    hidden = sum(float(one.coverage[~one.usable].sum()) for one in drawn.values()) / max(covered, 1e-9)
    enclosed = shoot_hull.enclosed_share(hull, told)
    said = (
        *(() if hidden <= MUCH_HIDDEN else (_hidden_warning(hidden),)),
        *(() if enclosed <= MUCH_ENCLOSED else (_enclosed_warning(enclosed),)),
    )
    return Shoot(
        mesh=mesh,
        hull_mm3=hull.leaves.volume_mm3(),
        blades_mm2=told.areas_mm2,
        leaf_area_mm2=told.area_mm2 if enclosed <= MUCH_ENCLOSED else None,
        stalks_mm3=shoot_hull.stalks_mm3(hull, told),
        leaf_thickness_mm=settings.shoot.leaf_thickness_mm or None,
        pot_top_mm=dataset.scene.net_pot.top_mm,
        covered_px={pictures.frames[k].file: float(one.coverage.sum()) for k, one in drawn.items()},
        mm2_per_px={pictures.frames[k].file: _mm2_per_px(views[k], dataset.scene.net_pot.top_mm) for k in drawn},
        hidden_share=hidden,
        enclosed_share=enclosed,
        colour=colour.values,
        leaf_colours=colour.leaves,
        warnings=(*pictures.warnings, *cameras.warnings, *said, *colour.warnings),
    )


def _hidden_warning(share: float) -> str:
    return (
        f"{100.0 * share:.0f} % of the visible shoot is in front of the net pot, where its shape cannot be determined. "
        "The surface area is too small, but height and projected areas are valid. Lower the camera or raise the panel."
    )


def _enclosed_warning(share: float) -> str:
    return (
        f"The leaf area could not be determined, because {100.0 * share:.0f} % of the shoot's hull is empty space that leaves hide in "
        "every picture. The surface area is too small, but height and projected areas are valid. Add a ring at a greater height."
    )


def _silhouettes(pictures: Pictures, cameras: Cameras) -> dict[int, Silhouette]:
    """Return the silhouettes of the used frames, keyed by frame number, ring by ring."""
    views, drawn = cameras.by_frame, dict[int, Silhouette]()
    for ring in sorted({pictures.frames[k].ring for k in views}):
        members = [k for k in views if pictures.frames[k].ring == ring]
        found = shoot_silhouettes.ring_silhouettes(
            [pictures.images[k] for k in members], [views[k] for k in members], pictures.dataset.scene
        )
        drawn |= dict(zip(members, found, strict=True))
    return drawn


def _mm2_per_px(view: View, top_mm: float) -> float:
    """Return the area of a pixel at the canister's axis, perpendicular to the optical axis, mm2.

    If the camera looks along the canister's axis, it is the area at the height of the net pot's top ``top_mm``.
    """
    fx, fy = view.camera.focal_px
    level = float(np.hypot(*view.cam_from_canister[2, :2]))  # cosine of the tilt
    depth_mm = view.rho_mm / level if level > _ALONG else float(view.cam_from_canister[2] @ [0.0, 0.0, top_mm, 1.0])
    return depth_mm**2 / (fx * fy)
