"""HTML tables of a report: verdicts, calibration and views."""

import html
from collections.abc import Sequence

import numpy as np

from rhizotwin.recon.results.parts import Json
from rhizotwin.report import words
from rhizotwin.scenes import frames
from rhizotwin.stored import calibration_table


def table(rows: Sequence[Sequence[str]], *, head: Sequence[str] = (), numbers: Sequence[int] = ()) -> str:
    """Return rows of text as an HTML table with escaped cells.

    Columns with an index in ``numbers`` are right-aligned.
    """
    top = f"<tr>{''.join(f'<th>{html.escape(name)}</th>' for name in head)}</tr>" if head else ""
    return f"<table>{top}{''.join(f'<tr>{cells(row, numbers=numbers)}</tr>' for row in rows)}</table>"


def cells(row: Sequence[str], *, numbers: Sequence[int] = ()) -> str:
    """Return the escaped HTML cells of a row of `table`."""
    return "".join(f"<td{' class=number' if k in numbers else ''}>{html.escape(cell)}</td>" for k, cell in enumerate(row))


def verdict_cells(summary: Json) -> str:
    """Return HTML table cells with the verdict on a result, and with its volume and 90 % interval."""
    state = words.traffic_light(summary)[0]
    verdict = "not reliable" if state == "bad" else "usable"
    found, interval = words.volume_text(summary)
    return f'<td class="verdict {state}"><b></b>{verdict}</td><td class=number>{found}<br><small class=soft>{interval}</small></td>'


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

    head = "<tr><th>file</th><th>ring</th><th>table (deg)</th><th>markers</th><th>reprojection (px)</th><th>fill (%)</th><th></th></tr>"
    rows = []
    for view in summary["views"]:
        cells = [
            number(view.get("ring"), 0),
            number(view.get("table_deg"), 2),
            number(view.get("markers"), 0),
            number(view.get("reprojection_px"), 3),
            number(view.get("fill"), 2, 100.0),
        ]
        reason = "" if view["used"] else f"not used: {view.get('reason') or 'no reason recorded'}"
        rows.append(
            f"<tr{'' if view['used'] else ' class=out'}><td>{html.escape(str(view['file']))}</td>"
            + "".join(f'<td class="number">{cell}</td>' for cell in cells)
            + f"<td>{html.escape(reason)}</td></tr>"
        )
    return f"<table>{head}{''.join(rows)}</table>"
