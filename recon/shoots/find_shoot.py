"""The stage from the pictures of the shoot to its hull and numbers; only the marker strip is shared with the root's."""

from __future__ import annotations

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.calibration.find_cameras import find_cameras
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.pictures import Pictures, read_pictures
from rhizotwin.recon.settings import Settings
from rhizotwin.recon.shoots import blades, shoot_hull, shoot_silhouettes
from rhizotwin.recon.shoots.shoot import Shoot
from rhizotwin.recon.shoots.shoot_colour import measure_colour
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.monitor import Monitor

FINEST_MM = 0.27
"""Edge of the finest nodes: a pixel of the usual camera at the plant."""
MUCH_ENCLOSED = 0.05
"""Share of the hull beyond which leaf area is not told: with hulls of blades 0.7 mm thick, a ball of it has a
twenty-fifth of their area."""
MUCH_HIDDEN = 0.05
"""Share of hidden pixels beyond which the area is told to be too small by more than its own error (docs/shoots.md)."""


def find_shoot(dataset: Dataset, *, settings: Settings, monitor: Monitor) -> tuple[Shoot | None, tuple[str, ...]]:
    """Find the shoot of a dataset; None where it has no pictures of one, or they cannot be used, which is said.

    Returns
    -------
    shoot : Shoot or None
    warnings : tuple of str
    """
    if dataset.masks or not any(frame.kind == "shoot" for frame in dataset.frames):
        return None, ()
    try:
        shoot = _found(dataset, settings, monitor)
    except UserError as error:
        return None, (f"the shoot is left out: {error}",)
    return shoot, shoot.warnings


def _found(dataset: Dataset, settings: Settings, monitor: Monitor) -> Shoot:
    """Find cameras, silhouettes and hull."""
    pictures = read_pictures(dataset, kind="shoot", settings=settings.pictures, monitor=monitor)
    cameras = find_cameras(pictures, settings=settings.calibration, monitor=monitor)
    with monitor.stage("shoot"):
        drawn = _silhouettes(pictures, cameras)
        views = cameras.by_frame
        hull, mesh = shoot_hull.find(list(drawn.values()), [views[k] for k in drawn], dataset.scene, finest_mm=FINEST_MM, monitor=monitor)
        told = blades.find(mesh)
        colour = measure_colour(pictures, drawn, views)
    covered = sum(float(one.coverage.sum()) for one in drawn.values())
    hidden = sum(float(one.coverage[~one.usable].sum()) for one in drawn.values()) / max(covered, 1e-9)
    enclosed = shoot_hull.enclosed_share(hull, told)
    said = (
        *(() if hidden <= MUCH_HIDDEN else (_hidden(hidden),)),
        *(() if enclosed <= MUCH_ENCLOSED else (_enclosed(enclosed),)),
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
        mm2_per_px={pictures.frames[k].file: _mm2_per_px(views[k]) for k in drawn},
        hidden_share=hidden,
        enclosed_share=enclosed,
        colour=colour.fields(),
        warnings=(*pictures.warnings, *said, *colour.warnings),
    )


def _hidden(share: float) -> str:
    return (
        f"{100.0 * share:.0f} % of what is seen of the shoot lies before the net pot, where its shape is not told: "
        "height and projected areas hold, the surface is too small; bring the camera lower or the panel higher"
    )


def _enclosed(share: float) -> str:
    return (
        f"{100.0 * share:.0f} % of the shoot's hull is thicker than leaves are: they enclose room that no picture looks into, so that "
        "leaf area is not told and the surface is too small; height and projected areas hold; take a ring from higher above"
    )


def _silhouettes(pictures: Pictures, cameras: Cameras) -> dict[int, Silhouette]:
    """Return the silhouettes of the frames that are used, by number, ring by ring."""
    views, drawn = cameras.by_frame, dict[int, Silhouette]()
    for ring in sorted({pictures.frames[k].ring for k in views}):
        members = [k for k in views if pictures.frames[k].ring == ring]
        found = shoot_silhouettes.of_ring([pictures.images[k] for k in members], [views[k] for k in members], pictures.dataset.scene)
        drawn |= dict(zip(members, found, strict=True))
    return drawn


def _mm2_per_px(view: View) -> float:
    """Return the area of a pixel at the distance of the canister's axis, across the line of sight."""
    fx, fy = view.camera.focal_px
    return view.rho_mm**2 / (fx * fy)
