"""What a result's pictures told of its rig, for ``result.json`` and as a table for people."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rhizotwin.recon.results.result_files import Json
from rhizotwin.scenes import frames

if TYPE_CHECKING:  # the command line reads results without starting the engine
    from rhizotwin.recon.calibration.cameras import Cameras, MarkerCalibration

_SWAY_AT_MM = 100.0
"""Depth at which a sway is told: about that of a grown plant's tips."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """A quantity that was calibrated from the pictures."""

    quantity: str
    given: float
    """Before looking at the pictures."""
    found: float
    sigma: float | None
    """Standard deviation."""
    unit: str
    taken: bool
    """Whether the reconstruction went on with what was found."""

    def text(self) -> str:
        """Return one line for the terminal."""
        sigma = "" if self.sigma is None else f" +- {self.sigma:.2g}"
        kept = "" if self.taken else " (not sure enough: as given)"
        return f"{self.quantity}: given {self.given:.6g}, found {self.found:.6g}{sigma} {self.unit}".rstrip() + kept


def of_cameras(cameras: Cameras) -> Json:
    """Return what all views together told as JSON values, for the ``rig`` of a result.

    Empty where the cameras were given and no more.
    """
    found = {} if cameras.markers is None else _of_markers(cameras.markers)
    if found or cameras.roots is not None:
        found |= _of_roots(cameras, found.get("focal_scale", 1.0))
    sways = np.array([view.sway[:2] for view in cameras.views])
    return found | {"sway_mm": _SWAY_AT_MM * float(np.sqrt(np.square(sways).sum(axis=1).mean()))} if sways.any() else found


def _of_markers(found: MarkerCalibration) -> Json:
    """Return what the markers and the canister's edges told."""
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
        "focal_scale": found.focal_scale,
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


def _of_roots(cameras: Cameras, focal_scale: float) -> Json:
    """Return what the roots told; the index's sigma is None where no roots could be asked.

    ``focal_scale`` is that of the markers; cameras that were corrected by the roots go with theirs.
    """
    told, given = cameras.roots, cameras.optics.n_water
    if told is None:
        return {"n_water": given, "n_water_given": given, "n_water_found": None, "n_water_sigma": None, "roots": None}
    taken = {"focal_scale": focal_scale * told.focal_scale} if told.believed else {}
    return taken | {
        "n_water": told.n_water if told.believed else told.n_water_given,
        "n_water_given": told.n_water_given,
        "n_water_found": told.n_water,
        "n_water_sigma": told.n_water_sigma,
        "roots": {"nodes": told.nodes, "before_px": told.before_px, "after_px": told.after_px},
    }


def rows(rig: Json) -> list[Row]:
    """Return the table "calibrated from the pictures" of a result's ``rig``.

    Empty where the cameras were given and nothing was found.
    """
    found: list[Row] = []
    if rig.get("n_water_found") is not None:
        taken = rig["n_water"] != rig["n_water_given"]
        found.append(_row("index of the water", rig["n_water_given"], rig["n_water_found"], rig["n_water_sigma"], "", taken=taken))
    if rig.get("focal_scale_sigma") is not None and rig.get("focal_scale_found") is not None:
        taken = rig["focal_scale"] != 1.0
        scale = rig["focal_scale"] if taken else rig["focal_scale_found"]
        found.append(_row("focal length over the given", 1.0, scale, rig["focal_scale_sigma"], "", taken=taken))
    for name, key in (
        ("canister relative to the marker strip", "canister_from_strip"),
        ("canister relative to the turntable", "table_from_canister"),
    ):
        if rig.get(key) is not None:
            pose = np.array(rig[key])
            values = [*np.rad2deg(frames.to_rotvec(pose)[:2]), *pose[:2, 3]]
            sigma = rig.get(f"{key}_sigma") or [None] * 4
            for what, value, spread in zip(("tilt x", "tilt y", "offset x", "offset y"), values, sigma, strict=True):
                found.append(_row(f"{name}: {what}", 0.0, float(value), spread, "deg" if "tilt" in what else "mm"))
    if rig.get("sway_mm") is not None:
        found.append(_row(f"sway of the roots {_SWAY_AT_MM:g} mm below the net pot, root mean square", 0.0, rig["sway_mm"], None, "mm"))
    if rig.get("table_correction_deg") is not None:
        found.append(_row("table angles: spread about the commanded", 0.0, rig["table_correction_deg"], None, "deg"))
    return found


def reprojection(rig: Json) -> list[tuple[str, float, float, str]]:
    """Return what was off before and after calibration: (what, before, after, unit)."""
    edges, roots = rig.get("canister_edges"), rig.get("roots")
    found = []
    if rig.get("reprojection_before_px") is not None and rig.get("reprojection_after_px") is not None:
        found.append(("marker corners", rig["reprojection_before_px"], rig["reprojection_after_px"], "px"))
    if edges:
        found.append(("canister edges", edges["before_mm"], edges["after_mm"], "mm"))
    if roots:
        found.append(("roots, sideways", roots["before_px"], roots["after_px"], "px"))
    return found


def table(rig: Json) -> list[str]:
    """Return both tables as lines for the terminal."""
    lines = [f"  {row.text()}" for row in rows(rig)]
    if rig.get("n_water_given") is not None and rig.get("n_water_found") is None:
        lines.append(f"  index of the water: {rig['n_water_given']:.6g} as given: no thin roots tell it")
    lines += [f"  {what}: {before:.3f} {unit} off before, {after:.3f} {unit} after" for what, before, after, unit in reprojection(rig)]
    return ["calibrated from the pictures:", *lines] if lines else []


def _row(quantity: str, given: float, found: float, sigma: float | None, unit: str, *, taken: bool = True) -> Row:
    return Row(quantity=quantity, given=given, found=found, sigma=sigma, unit=unit, taken=taken)
