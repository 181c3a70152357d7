"""What a result's pictures told of its rig, for ``result.json`` and as a table for people."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rhizotwin.scenes import frames

if TYPE_CHECKING:  # the command line reads results without starting the engine
    from rhizotwin.recon.optics.refraction import Optics
    from rhizotwin.recon.tubes.root_calibration import RootCalibration


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


def of_roots(asked: RootCalibration | None, optics: Optics, focal_scale: float = 1.0) -> dict[str, Any]:
    """Return what the roots told as JSON values for the rig of a result; the index's sigma is None where no roots could be asked.

    ``focal_scale`` is that of the markers; cameras that were corrected by the roots go with theirs.
    """
    given = {"n_water": optics.n_water, "n_water_given": optics.n_water, "n_water_found": None, "n_water_sigma": None, "roots": None}
    if asked is None:
        return given
    taken = {"n_water": asked.n_water, "focal_scale": focal_scale * asked.focal_scale} if asked.believed else {}
    return given | {
        **taken,
        "n_water_found": asked.n_water,
        "n_water_sigma": asked.n_water_sigma,
        "roots": {"nodes": asked.nodes, "before_px": asked.before_px, "after_px": asked.after_px},
    }


def rows(rig: dict[str, Any]) -> list[Row]:
    """Return the table "calibrated from the pictures" of a result's ``rig``; empty where the cameras were given and nothing was found."""
    found: list[Row] = []
    if rig.get("n_water_found") is not None:
        taken = rig["n_water"] != rig["n_water_given"]
        found.append(_row("index of the water", rig["n_water_given"], rig["n_water_found"], rig["n_water_sigma"], "", taken=taken))
    if rig.get("focal_scale_sigma") is not None and rig.get("focal_scale_found") is not None:
        taken = rig["focal_scale"] != 1.0
        scale = rig["focal_scale"] if taken else rig["focal_scale_found"]
        found.append(_row("focal length over the given", 1.0, scale, rig["focal_scale_sigma"], "", taken=taken))
    for name, key in (("canister in the strip", "canister_from_strip"), ("canister on the table", "table_from_canister")):
        if rig.get(key) is not None:
            pose = np.array(rig[key])
            values = [*np.rad2deg(frames.to_rotvec(pose)[:2]), *pose[:2, 3]]
            sigma = rig.get(f"{key}_sigma") or [None] * 4
            for what, value, spread in zip(("tilt x", "tilt y", "offset x", "offset y"), values, sigma, strict=True):
                found.append(_row(f"{name}: {what}", 0.0, float(value), spread, "deg" if "tilt" in what else "mm"))
    if rig.get("table_correction_deg") is not None:
        found.append(_row("table angles: spread about the commanded", 0.0, rig["table_correction_deg"], None, "deg"))
    return found


def reprojection(rig: dict[str, Any]) -> list[tuple[str, float, float, str]]:
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


def table(rig: dict[str, Any]) -> list[str]:
    """Return both tables as lines for the terminal."""
    lines = [f"  {row.text()}" for row in rows(rig)]
    if rig.get("n_water_given") is not None and rig.get("n_water_found") is None:
        lines.append(f"  index of the water: {rig['n_water_given']:.6g} as given: no thin roots tell it")
    lines += [f"  {what}: {before:.3f} {unit} off before, {after:.3f} {unit} after" for what, before, after, unit in reprojection(rig)]
    return ["calibrated from the pictures:", *lines] if lines else []


def _row(quantity: str, given: float, found: float, sigma: float | None, unit: str, *, taken: bool = True) -> Row:
    return Row(quantity=quantity, given=given, found=found, sigma=sigma, unit=unit, taken=taken)
