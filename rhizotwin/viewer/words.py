"""Numbers and sentences for people, as HTML; everything that comes from files is escaped."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections.lines import Line, Lines
from rhizotwin.corrections.session import Measured
from rhizotwin.recon.results import assessments
from rhizotwin.report import words as said
from rhizotwin.scenes.formatting import ml
from rhizotwin.scenes.trait_table import DEFINITIONS
from rhizotwin.scenes.traits import Traits
from rhizotwin.viewer.colours import half_width

Array = NDArray[np.float64]

NOT_AT_ONCE = ("volume_mm3", "surface_mm2")
"""Traits that the panel has elsewhere, or that need the surface drawn anew."""


def volume(summary: dict[str, Any], measured: Measured, *, edits: int) -> str:
    """Return the volume with its interval in ml and the roots' length, and what corrections made of it."""
    found, (low, high) = float(summary["volume_mm3"]), summary["volume_interval_mm3"]
    half = max(high - found, found - low)
    headline, beside = said.headline(summary)
    text = f"<b>{headline.removeprefix('volume ')}</b>, {beside}"
    if not summary["volume_trusted"]:
        text += f"<details style='font-size:0.85em'><summary>Why</summary>{html.escape(str(summary['volume_verdict']))}</details>"
    roots = f"{measured.length_mm:.0f} mm in {measured.roots} root{'' if measured.roots == 1 else 's'}"
    if edits:
        moved = 100.0 * (measured.volume_mm3 / found - 1.0) if found > 0.0 else 0.0
        by = f"{moved:+.2f} %" if abs(moved) >= 0.005 else "unchanged to 0.01 %"
        text += f"<br>as corrected: <b>{ml(measured.volume_mm3, half_mm3=half)} ml</b> ({by}), {roots}"
    elif measured.roots:
        text += f"<br>{roots}"
    return f"<div style='padding:0.3em 0.8em'>{text}</div>"


def root(number: int, lines: Lines, order: int, pictures: Sequence[str] = ()) -> str:
    """Return what a root is: length, order, angles, diameters, and the pictures that show it best."""
    line = lines[number]
    parent = lines.get(line.parent)
    angles = f"{_to_gravity_deg(line):.0f}° to straight down (mean)"
    laterals = sum(other.parent == number for other in lines.values())
    rows = [
        ("length", f"{line.length_mm:.1f} mm, end {'seen' if line.tip_seen else 'hidden by others'}"),
        ("order", f"{order} ({'main root' if order == 0 else 'lateral' if order == 1 else 'lateral of a lateral'}), {laterals} laterals"),
        ("angle", angles if parent is None else f"{angles}, {_to_parent_deg(line, parent):.0f}° to its parent"),
        ("diameter", _mean_diameter(line)),
    ]
    if pictures:
        rows.append(("seen best in", ", ".join(html.escape(name) for name in pictures)))
    cell = "padding-right:0.8em;white-space:nowrap;vertical-align:top"
    table = "".join(f"<tr><td style='{cell}'>{name}</td><td>{value}</td></tr>" for name, value in rows)
    return f"<div style='padding:0 0.8em;font-size:0.85em'><b>Root {number}</b><table>{table}</table></div>"


def chosen(roots: int, length_mm: float, voxels: int, volume_mm3: float) -> str:
    """Return what is chosen."""
    if not roots and not voxels:
        return "<div style='padding:0.3em 0.8em'>Nothing is chosen: click a root, or hold Shift and drag a rectangle.</div>"
    parts = []
    if roots:
        parts.append(f"{roots} root{'' if roots == 1 else 's'}, {length_mm:.1f} mm")
    if voxels:
        parts.append(f"{voxels} voxel{'' if voxels == 1 else 's'}, {volume_mm3:.2f} mm³")
    return f"<div style='padding:0.3em 0.8em'>Chosen: <b>{' and '.join(parts)}</b></div>"


def traits(found: Traits, *, corrected: bool, summary: dict[str, Any]) -> str:
    """Return the traits as they are now with their 90 % intervals; corrected ones are not assessed."""
    rows = []
    assessed = assessments.assess(summary, found)
    for definition in DEFINITIONS:
        value = getattr(found, definition.field)
        name, shown, meaning = said.trait(definition, value)
        if value is None or definition.field in NOT_AT_ONCE:
            continue
        interval = "not assessed" if corrected else said.interval(definition, assessed[definition.field])
        between = f"<br><small>{html.escape(interval)}</small>"
        rows.append(
            f"<tr title='{html.escape(meaning)}'><td style='padding-right:0.8em'>{html.escape(name)}</td>"
            f"<td>{html.escape(shown)}{between}</td></tr>"
        )
    head = "<b>As corrected</b>" if corrected else "Point at a line for what it means."
    return f"<div style='padding:0.3em 0.8em'>{head}<table>{''.join(rows)}</table></div>"


def note(text: str) -> str:
    """Return a sentence, escaped."""
    return f"<div style='padding:0.3em 0.8em'>{html.escape(text)}</div>"


def profile(line: Line, *, width: int = 300, height: int = 76) -> str:
    """Return a root's diameter along its length as SVG."""
    way, most = line.way_mm, max(float(line.diameters_mm.max()), 1e-6)
    x = 30 + (width - 40) * way / max(float(way[-1]), 1e-6)
    y = 8 + (height - 28) * (1.0 - line.diameters_mm / most)
    dots = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    return (
        f"<svg width='{width}' height='{height}' style='font:10px sans-serif'><polyline points='{dots}' fill='none' stroke='#1f77b4' "
        f"stroke-width='1.5'/><text x='0' y='14' fill='currentColor'>{most:.2f}</text>"
        f"<text x='0' y='{height - 20}' fill='currentColor'>0</text>"
        f"<text x='30' y='{height - 5}' fill='currentColor'>diameter (mm) along {way[-1]:.1f} mm</text></svg>"
    )


def _steps(line: Line) -> tuple[Array, Array]:
    step = np.diff(line.points_mm, axis=0)
    return step, np.linalg.norm(step, axis=1)


def _to_gravity_deg(line: Line) -> float:
    step, size = _steps(line)
    return float(np.rad2deg(np.arccos(np.clip(-step[:, 2] / np.maximum(size, 1e-12), -1.0, 1.0)) @ size / max(size.sum(), 1e-12)))


def _mean_diameter(line: Line) -> str:
    """Return the mean diameter with its 90 % half-width: errors along one root go together."""
    half_mm = half_width(line)
    text = f"{_mean(line, line.diameters_mm):.2f}"
    return f"{text} mm on average" if half_mm is None else f"{text} ± {_mean(line, half_mm):.2f} mm on average (90 %)"


def _mean(line: Line, values: Array) -> float:
    """Return the mean along a root of values (N,) at its points."""
    _, size = _steps(line)
    return float((values[1:] + values[:-1]) / 2.0 @ size / max(size.sum(), 1e-12))


def _to_parent_deg(line: Line, parent: Line) -> float:
    """Return the angle between a root's first 5 mm and its parent there."""
    at = parent.nearest_mm(line.points_mm[0])
    before, after = max(at - 2.5, 0.0), min(at + 2.5, parent.length_mm)
    there = parent.between(before, max(after, before + 1e-3)).points_mm
    begin = line.between(0.0, min(5.0, line.length_mm)).points_mm
    a, b = there[-1] - there[0], begin[-1] - begin[0]
    return float(np.rad2deg(np.arccos(np.clip(a @ b / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-12), -1.0, 1.0))))
