"""Parameters of the rig that were calibrated from the pictures, in the form stored in ``result.json``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rhizotwin.recon.results.parts import Json

if TYPE_CHECKING:  # results are read without loading the reconstruction
    from rhizotwin.recon.calibration.cameras import Cameras, MarkerCalibration

SWAY_AT_MM = 100.0
"""Depth at which the horizontal displacement of swaying roots is reported, mm. It is approximately the depth of the
root tips of a grown plant."""


def summarize_cameras(cameras: Cameras) -> Json:
    """Return the calibration from all views as JSON values, for the key ``rig`` of a result.

    The dictionary is empty if the cameras were specified in the dataset and not calibrated. ``mm_per_px`` is the scale
    of pictures without markers.
    """
    found = {} if cameras.markers is None else _summarize_markers(cameras.markers)
    if found or cameras.roots is not None:
        found |= _summarize_roots(cameras, found.get("focal_scale", 1.0))
    if cameras.bare is not None:
        found |= {"mm_per_px": cameras.bare.mm_per_px}
    sways = np.array([view.sway[:2] for view in cameras.views])
    return found | {"sway_mm": SWAY_AT_MM * float(np.sqrt(np.square(sways).sum(axis=1).mean()))} if sways.any() else found


def _summarize_markers(found: MarkerCalibration) -> Json:
    """Return the calibration from markers and canister edges as JSON values."""
    canister = found.canister
    return {
        "canister_from_strip": None if canister is None else canister.canister_from_strip.tolist(),
        "canister_from_strip_sigma": None if canister is None else canister.sigma.tolist(),
        "tank_turn_deg": None if canister is None else canister.tank_turn_deg,
        "tank_turn_sigma_deg": None if canister is None else canister.tank_sigma_deg,
        "canister_edges": None
        if canister is None
        else {
            "count": canister.edges,
            "before_mm": canister.before_mm,
            "after_mm": canister.after_mm,
            "radius_excess_mm": canister.radius_excess_mm,
            "oval_mm": canister.oval_mm,
            "oval_deg": canister.oval_deg,
        },
        "reprojection_before_px": found.before_px,
        "reprojection_after_px": found.after_px,
        "table_from_canister": None if found.table_from_canister is None else found.table_from_canister.tolist(),
        "table_from_canister_sigma": None if found.table_sigma is None else found.table_sigma.tolist(),
        "marker_inset_px": found.inset_px,
        "focal_scale": found.focal_scale,  # multiplied by the roots' factor in `_summarize_roots`
        "focal_scale_markers": found.focal_scale,
        "focal_scale_found": found.focal_found,
        "focal_scale_sigma": found.focal_sigma,
        "rings": [
            {
                "ring": ring.ring,
                "placement": ring.placement,
                "cam_from_rig": ring.cam_from_rig.tolist(),
                "covariance": ring.covariance.tolist(),
                "own_movement_mm": ring.own_mm,
                "own_movement_deg": ring.own_deg,
            }
            for ring in found.rings
        ],
        "table_correction_deg": found.table_correction_deg,
    }


def _summarize_roots(cameras: Cameras, focal_scale: float) -> Json:
    """Return the calibration from the roots as JSON values.

    ``focal_scale`` is the correction factor of the focal length that was determined from the markers. It is multiplied
    by the correction from the roots if the cameras were corrected from the roots. The standard deviation of the
    refractive index is None without roots.
    """
    found_by_roots, given = cameras.roots, cameras.optics.n_water
    if found_by_roots is None:
        return {"n_water": given, "n_water_given": given, "n_water_found": None, "n_water_sigma": None, "roots": None}
    corrected = {"focal_scale": focal_scale * found_by_roots.focal_scale} if found_by_roots.believed else {}
    return corrected | {
        "n_water": found_by_roots.n_water if found_by_roots.believed else found_by_roots.n_water_given,
        "n_water_given": found_by_roots.n_water_given,
        "n_water_found": found_by_roots.n_water,
        "n_water_sigma": found_by_roots.n_water_sigma,
        "roots": {"nodes": found_by_roots.nodes, "before_px": found_by_roots.before_px, "after_px": found_by_roots.after_px},
    }
