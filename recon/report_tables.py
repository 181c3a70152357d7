"""The tables of a result's page: the volume and how far it can be trusted, the traits, and what the scan calibrated by itself."""

import html
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from scenes import frames
from scenes.dataset import Dataset
from scenes.trait_table import DEFINITIONS, shown
from scenes.traits import Traits

NAMES = {
    "focal_scale": ("Lens: focal length over the calibrated one", ""),
    "n_water": ("Water: index of refraction", ""),
}
"""What a number of the rig is called, and its unit; one that is not here is called by its key."""


def table(rows: Sequence[Sequence[str]], *, head: Sequence[str] = (), numbers: Sequence[int] = ()) -> str:
    """Return rows of text as HTML, escaped; ``numbers`` are the columns that are aligned to the right."""
    top = f"<tr>{''.join(f'<th>{html.escape(name)}</th>' for name in head)}</tr>" if head else ""
    body = ("".join(f"<td{' class=number' if k in numbers else ''}>{html.escape(cell)}</td>" for k, cell in enumerate(row)) for row in rows)
    return f"<table>{top}{''.join(f'<tr>{row}</tr>' for row in body)}</table>"


def volume(summary: dict[str, Any]) -> str:
    """Return the volume with its interval, and the verdict and budget where the result has them."""
    low, high = summary["volume_interval_mm3"]
    found = summary["volume_mm3"]
    text = f"<p class=volume>{found:.1f} mm³ <small>({found / 1000.0:.3f} ml), between {low:.1f} and {high:.1f} mm³</small></p>"
    if summary.get("volume_verdict"):
        kind = "" if summary.get("volume_trusted", True) else " class=warning"
        text += f"<p{kind}>{html.escape(str(summary['volume_verdict']))}</p>"
    budget = summary.get("volume_budget") or []
    if budget:
        rows = [[str(term["name"]), f"-{term['less_mm3']:.1f}", f"+{term['more_mm3']:.1f}"] for term in budget]
        text += table(rows, head=("what the interval allows for", "less (mm³)", "more (mm³)"), numbers=(1, 2))
    return text


def traits(found: Traits) -> str:
    """Return every trait that is one number, with unit and definition."""
    rows = [[d.name.replace("_", " "), shown(getattr(found, d.field)), d.unit, d.meaning] for d in DEFINITIONS]
    note = "" if found.total_length_mm is not None else "<p>No thin roots were found as centre lines: what needs them is a dash.</p>"
    return note + table(rows, head=("trait", "value", "unit", "definition"), numbers=(1,))


def calibration(summary: dict[str, Any], dataset: Dataset) -> str:
    """Return what all views together gave, with uncertainties and the reprojection before and after; empty where the poses were given."""
    rig = summary.get("rig") or {}
    if not rig:
        return ""
    rows: list[list[str]] = []
    for key, name in (("canister_from_strip", "Canister in the strip"), ("table_from_canister", "Table's axis against the canister")):
        rows += _seat(name, rig.get(key), rig.get(f"{key}_sigma"))
    for key, value in rig.items():
        sigma = rig.get(f"{key}_sigma")
        if _is_number(value) and _is_number(sigma):
            name, unit = NAMES.get(key, (key.replace("_", " "), ""))
            rows.append([name, f"{value:.5f}", f"{sigma:.5f}", unit])
    for ring in rig.get("rings") or []:
        rows += _ring(ring)
    rows += _angles(summary, dataset)
    parts = [table(rows, head=("quantity", "value", "uncertainty (1 sigma)", "unit"), numbers=(1, 2))] if rows else []
    parts.append(_before_and_after(rig))
    return "".join(parts)


def _before_and_after(rig: dict[str, Any]) -> str:
    rows = []
    if _is_number(rig.get("reprojection_before_px")) and _is_number(rig.get("reprojection_after_px")):
        before, after = rig["reprojection_before_px"], rig["reprojection_after_px"]
        rows.append(["Markers' reprojection (before: table angles as commanded, seat as planned)", f"{before:.4f}", f"{after:.4f}", "px"])
    edges = rig.get("canister_edges")
    if edges:
        rows.append([f"Canister's edges ({edges['count']} points)", f"{edges['before_mm']:.4f}", f"{edges['after_mm']:.4f}", "mm"])
    return table(rows, head=("error", "before", "after", "unit"), numbers=(1, 2)) if rows else ""


def _seat(name: str, matrix: Any, sigma: Any) -> list[list[str]]:
    """Return tilt and offset of a pose; ``sigma`` has tilts about x and y in degrees, then offsets along x and y in mm."""
    if matrix is None:
        return []
    pose = np.array(matrix, np.float64)
    tilt = Rotation.from_matrix(pose[:3, :3]).as_rotvec(degrees=True)
    known = ["" if sigma is None else f"{value:.4f}" for value in (sigma or [None] * 4)]
    values = (*tilt[:2], *pose[:2, 3])
    what = (("tilt about x", "deg"), ("tilt about y", "deg"), ("offset along x", "mm"), ("offset along y", "mm"))
    return [[f"{name}: {part}", f"{value:+.4f}", about, unit] for (part, unit), value, about in zip(what, values, known, strict=True)]


def _ring(ring: dict[str, Any]) -> list[list[str]]:
    """Return where a ring's camera stands; its covariance is of rotation (rad) and translation (mm) along the camera's axes."""
    name = f"Camera of ring {ring['ring']}" + (f", placement {ring['placement'] + 1}" if ring.get("placement") else "")
    pose = frames.invert(np.array(ring["cam_from_rig"], np.float64))
    spread = np.sqrt(np.maximum(np.diag(np.array(ring["covariance"], np.float64)), 0.0))
    tilt = float(np.rad2deg(np.arcsin(np.clip(pose[2, 2], -1.0, 1.0))))
    return [
        [f"{name}: distance from the table's axis", f"{np.hypot(*pose[:2, 3]):.3f}", f"{spread[5]:.3f}", "mm"],
        [f"{name}: height over the rim", f"{pose[2, 3]:.3f}", f"{spread[4]:.3f}", "mm"],
        [f"{name}: looks up", f"{tilt:.4f}", f"{np.rad2deg(spread[0]):.4f}", "deg"],
        [f"{name}: movement of its own from view to view", f"{ring['own_movement_mm']:.4f}", "", "mm"],
        [f"{name}: turn of its own from view to view", f"{ring['own_movement_deg']:.4f}", "", "deg"],
    ]


def _angles(summary: dict[str, Any], dataset: Dataset) -> list[list[str]]:
    """Return how the found table angles differ from the commanded ones."""
    commanded = {frame.file: frame.table_deg for frame in dataset.frames}
    pairs = [
        (view["table_deg"], commanded[view["file"]])
        for view in summary["views"]
        if view["used"] and view.get("table_deg") is not None and commanded.get(view["file"]) is not None
    ]
    if not pairs:
        return []
    off = np.array([(found - given + 180.0) % 360.0 - 180.0 for found, given in pairs])
    return [
        ["Table angles: found less commanded, root mean square", f"{np.sqrt(np.mean(off**2)):.4f}", "", "deg"],
        ["Table angles: largest difference", f"{off[np.argmax(np.abs(off))]:+.4f}", "", "deg"],
    ]


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
