"""HTML tables of a report: verdicts, causes of uncertainty, calibration, views and settings."""

import numpy as np

from rhizotwin.recon.results.parts import Json
from rhizotwin.report import charts, words
from rhizotwin.scenes import frames, html_page
from rhizotwin.scenes.formatting import round_digits
from rhizotwin.scenes.html_page import Markup, table
from rhizotwin.stored import calibration_table


def verdict(summary: Json) -> tuple[Markup, Markup]:
    """Return two cells of a table: the verdict on a result, and its volume with the 90 % interval."""
    state = words.traffic_light(summary)[0]
    found, interval = words.volume_text(summary)
    light = f'<span class="verdict {state}"><b></b>{"not reliable" if state == "bad" else "reliable"}</span>'
    return Markup(light), Markup(f"{found}<br><small class=soft>{interval}</small>")


def causes(summary: Json) -> str:
    """Return the causes of the volume's uncertainty as an HTML bar chart, or an empty text if they are unknown."""
    found = words.uncertainty_causes(summary)
    ends = [(-cause.less_mm3 / 1000.0, cause.more_mm3 / 1000.0) for cause in found]
    if not any(stop > start for start, stop in ends):
        return ""
    bars, scale = charts.intervals(ends)
    rows = [f"<tr>{html_page.cells((cause.name, bar, cause.amount), numbers=(2,))}</tr>" for cause, bar in zip(found, bars, strict=True)]
    rows.append(f"<tr class=scale><td></td><td><div>{scale}</div></td><td>ml</td></tr>")
    why = html_page.items([f"{cause.name}: {cause.why}" for cause in found if cause.why])
    return f"<table class=causes><tbody>{''.join(rows)}</tbody></table><details><summary>Explanations</summary>{why}</details>"


def calibration(summary: Json) -> str:
    """Return HTML tables of calibrated parameters, residuals and camera poses.

    The text is empty if the camera poses were given instead of calibrated.
    """
    rig = summary.get("rig") or {}
    rows = [
        (
            *(row.quantity, f"{row.given:.6g}", f"{row.found:.6g}", "" if row.sigma is None else f"{row.sigma:.2g}", row.unit),
            "" if row.taken else "too uncertain: given value used",
        )
        for row in calibration_table.rows(rig)
    ]
    parts = [table(rows, head=("quantity", "given", "found", "sigma", "unit", ""), numbers=(1, 2, 3))] if rows else []
    residuals = [[name, f"{before:.4f}", f"{after:.4f}", unit] for name, before, after, unit in calibration_table.reprojection(rig)]
    parts += [table(residuals, head=("residual", "before", "after", "unit"), numbers=(1, 2))] if residuals else []
    poses = [row for ring in rig.get("rings") or [] for row in _pose_rows(ring)]
    parts += [table(poses, head=("camera", "found", "sigma", "unit"), numbers=(1, 2))] if poses else []
    return "".join(parts)


def _pose_rows(ring: Json) -> list[list[str]]:
    """Return table rows with the pose of the camera of a ring.

    These are the distance from the table's axis, the height and the tilt, with standard deviations, and the movement
    between views.
    """
    name = f"Camera of ring {ring['ring']}" + (f", placement {ring['placement'] + 1}" if ring.get("placement") else "")
    pose = frames.invert(np.array(ring["cam_from_rig"], np.float64))
    spread = np.sqrt(np.maximum(np.diag(np.array(ring["covariance"], np.float64)), 0.0))
    tilt = float(np.rad2deg(np.arcsin(np.clip(pose[2, 2], -1.0, 1.0))))
    return [
        [f"{name}: distance from the table's axis", f"{np.hypot(*pose[:2, 3]):.3f}", f"{spread[5]:.3f}", "mm"],
        [f"{name}: height above the rim", f"{pose[2, 3]:.3f}", f"{spread[4]:.3f}", "mm"],
        [f"{name}: upward tilt", f"{tilt:.4f}", f"{np.rad2deg(spread[0]):.4f}", "deg"],
        [f"{name}: movement between views", f"{ring['own_movement_mm']:.4f}", "", "mm"],
        [f"{name}: rotation between views", f"{ring['own_movement_deg']:.4f}", "", "deg"],
    ]


def views(summary: Json) -> str:
    """Return an HTML table of all views, with the reasons why views were not used."""

    def number(value: float | None, digits: int, factor: float = 1.0) -> str:
        return "" if value is None else f"{factor * value:.{digits}f}"

    rows = [
        [
            str(view["file"]),
            number(view.get("ring"), 0),
            number(view.get("table_deg"), 2),
            number(view.get("markers"), 0),
            number(view.get("reprojection_px"), 3),
            number(view.get("fill"), 2, 100.0),
            "" if view["used"] else f"not used: {view.get('reason') or 'no reason recorded'}",
        ]
        for view in summary["views"]
    ]
    head = ("file", "ring", "table (deg)", "markers", "reprojection (px)", "fill (%)", "")
    marked = [k for k, view in enumerate(summary["views"]) if not view["used"]]
    return table(rows, head=head, numbers=range(1, 6), marked=marked)


def details(summary: Json, *, rig: str) -> str:
    """Return tables of sizes, calibration, views and settings, and the drawing of the rig, as HTML."""
    parts = {
        "Sizes": table(_sizes(summary), numbers=(1,)),
        "Rig and cameras": rig,
        "Self-calibration": calibration(summary),
        "Views": views(summary),
        "Settings and versions": table(_provenance(summary)),
    }
    return "".join(f"<details><summary>{name}</summary>{text}</details>" for name, text in parts.items() if text)


def _sizes(summary: Json) -> list[tuple[str, str]]:
    extents = [b - a for a, b in zip(summary["extents_min_mm"], summary["extents_max_mm"], strict=True)]
    mu, sigma = summary.get("root_mu_per_mm"), summary.get("root_mu_sigma_per_mm")
    attenuation = "opaque" if mu is None else f"{mu:.2f} per mm" + ("" if sigma is None else f" ± {sigma:.2f}")
    return [
        ("Root extent (x, y, z)", " x ".join(f"{extent:.1f}" for extent in extents) + " mm"),
        ("Hull before trimming", f"{round_digits(summary['hull_mm3'] / 1000.0)} ml"),
        ("Volume of hull that could not be trimmed", f"{round_digits(summary['untrimmed_mm3'] / 1000.0)} ml"),
        ("Water visible in too few views", f"{round_digits(summary['blind_mm3'] / 1000.0)} ml"),
        ("Attenuation of light in roots", attenuation),
        ("Views used", f"{sum(view['used'] for view in summary['views'])} of {len(summary['views'])}"),
        ("Computing time", f"{sum(summary['timings_s'].values()):.0f} s"),
    ]


def _provenance(summary: Json) -> list[tuple[str, str]]:
    rows = [("dataset", str(summary.get("dataset", "")))]
    for key, value in summary.get("settings", {}).items():
        rows += [(f"{key}.{name}", str(part)) for name, part in value.items()] if isinstance(value, dict) else [(str(key), str(value))]
    return rows + [(f"version of {key}", str(value)) for key, value in summary.get("versions", {}).items()]
