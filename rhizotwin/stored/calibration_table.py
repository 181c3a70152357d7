"""Table of the parameters that a result calibrated from the pictures."""

from dataclasses import dataclass

import numpy as np

from rhizotwin.recon.results.calibration_summary import SWAY_AT_MM
from rhizotwin.recon.results.parts import Json
from rhizotwin.scenes import frames


@dataclass(frozen=True, kw_only=True)
class Row:
    """Parameter that was calibrated from the pictures."""

    quantity: str
    """Name of the calibrated rig parameter."""
    given: float
    """Value of the parameter before calibration."""
    found: float
    """Calibrated value of the parameter."""
    sigma: float | None
    """Standard deviation of the calibrated value. It is None if it was not estimated."""
    unit: str
    """Unit of the parameter. It is empty for a dimensionless parameter."""
    taken: bool
    """Whether the reconstruction used the calibrated value."""

    def text(self) -> str:
        """Return a line of text with the given and the calibrated value."""
        sigma = "" if self.sigma is None else f" +- {self.sigma:.2g}"
        kept = "" if self.taken else " (too uncertain, the given value was used)"
        return f"{self.quantity}: given {self.given:.6g}, found {self.found:.6g}{sigma} {self.unit}".rstrip() + kept


def rows(rig: Json) -> list[Row]:
    """Return the calibrated parameters in the entry ``rig`` of a result.

    The list is empty if the camera poses were given instead of calibrated.
    """
    found: list[Row] = []
    if rig.get("n_water_found") is not None:
        taken = rig["n_water"] != rig["n_water_given"]
        found.append(
            _row("refractive index of the water", rig["n_water_given"], rig["n_water_found"], rig["n_water_sigma"], "", taken=taken)
        )
    if rig.get("focal_scale_sigma") is not None and rig.get("focal_scale_found") is not None:
        used = rig.get("focal_scale", 1.0)
        taken = rig.get("focal_scale_markers", used) != 1.0  # results of earlier versions have only the product
        scale = used if taken else rig["focal_scale_found"]
        found.append(_row("focal length relative to the given value", 1.0, scale, rig["focal_scale_sigma"], "", taken=taken))
    for name, key in (
        ("canister relative to the marker strip", "canister_from_strip"),
        ("canister relative to the turntable", "table_from_canister"),
    ):
        if rig.get(key) is not None:
            pose = np.array(rig[key])
            values = [*np.rad2deg(frames.to_rotvec(pose)[:2]), *pose[:2, 3]]
            sigma = rig.get(f"{key}_sigma") or [None] * 4
            for part, value, spread in zip(("tilt x", "tilt y", "offset x", "offset y"), values, sigma, strict=True):
                found.append(_row(f"{name}: {part}", 0.0, float(value), spread, "deg" if "tilt" in part else "mm"))
    if rig.get("sway_mm") is not None:
        found.append(_row(f"RMS sway of the roots {SWAY_AT_MM:g} mm below the net pot", 0.0, rig["sway_mm"], None, "mm"))
    if rig.get("table_correction_deg") is not None:
        found.append(_row("table angles: deviation from the commanded angles", 0.0, rig["table_correction_deg"], None, "deg"))
    return found


def reprojection(rig: Json) -> list[tuple[str, float, float, str]]:
    """Return the residuals of the calibration.

    Each has a name, a value before calibration, a value after calibration, and a unit.
    """
    edges, roots = rig.get("canister_edges"), rig.get("roots")
    found = []
    if rig.get("reprojection_before_px") is not None and rig.get("reprojection_after_px") is not None:
        found.append(("marker corners", rig["reprojection_before_px"], rig["reprojection_after_px"], "px"))
    if edges:
        found.append(("canister edges", edges["before_mm"], edges["after_mm"], "mm"))
    if roots:
        found.append(("roots, perpendicular to their axes", roots["before_px"], roots["after_px"], "px"))
    return found


def table(rig: Json) -> list[str]:
    """Return the calibrated parameters and the residuals as lines of text."""
    lines = [f"  {row.text()}" for row in rows(rig)]
    if rig.get("n_water_given") is not None and rig.get("n_water_found") is None:
        lines.append(f"  refractive index of the water: given {rig['n_water_given']:.6g}, not calibrated, because this needs thin roots")
    lines += [f"  {name}: residual {before:.3f} {unit} before, {after:.3f} {unit} after" for name, before, after, unit in reprojection(rig)]
    return ["parameters calibrated from the pictures:", *lines] if lines else []


def _row(quantity: str, given: float, found: float, sigma: float | None, unit: str, *, taken: bool = True) -> Row:
    return Row(quantity=quantity, given=given, found=found, sigma=sigma, unit=unit, taken=taken)
