"""HTML texts of the viewer's panel. Text from files is escaped."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections.lines import Line, Lines
from rhizotwin.corrections.log import Edit
from rhizotwin.corrections.session import Measured
from rhizotwin.drawing.root_colours import Key, half_widths, order_name
from rhizotwin.recon.results import assessments
from rhizotwin.report import words
from rhizotwin.report.charts import ticks
from rhizotwin.scenes import polyline
from rhizotwin.scenes.formatting import count, ml, round_digits
from rhizotwin.scenes.html_page import data_uri, items
from rhizotwin.scenes.trait_table import DEFINITIONS
from rhizotwin.scenes.traits import Traits, emergence_deg

Array = NDArray[np.float64]

_PADDED = "<div class=note>"


def volume(summary: dict[str, Any], measured: Measured, *, edits: int) -> str:
    """Return a text with the volume, its interval and the total root length.

    If there are corrections, the text also states the corrected volume.
    """
    found, (low, high) = float(summary["volume_mm3"]), summary["volume_interval_mm3"]
    headline, beside = words.verdict(summary)
    state, meaning, advice = words.traffic_light(summary)
    text = f"<h1><b class={state} role=img aria-label={state}></b>{html.escape(headline)}</h1>{html.escape(beside)}"
    if advice:
        text += f"<details><summary>{html.escape(meaning)}</summary>{items(advice)}</details>"
    roots = f"{measured.length_mm:.0f} mm in {measured.roots} root{'' if measured.roots == 1 else 's'}"
    if edits:
        moved = 100.0 * (measured.volume_mm3 / found - 1.0) if found > 0.0 else 0.0
        by = f"{moved:+.2f} %" if abs(moved) >= 0.005 else "changed by less than 0.01 %"
        shown = f"{ml(measured.volume_mm3, half_mm3=0.5 * (high - low))} ml"
        shown = f"<b>{shown}</b> ({by})" if summary["volume_trusted"] else f"{shown} ({by}), which is not reliable"
        text += f"<div>after corrections: {shown}, {roots}</div>"
    elif measured.roots:
        text += f"<div>{roots}</div>"
    return f"<div class=head>{text}</div>"


def root_name(number: int, line: Line, order: int) -> str:
    """Return the name of a root in the list of roots, which is as short as the list is narrow."""
    return f"root {number}: {order_name(order).removeprefix('lateral, ')}, {line.length_mm:.1f} mm"


def root(number: int, lines: Lines, order: int) -> str:
    """Return order, length, angles and diameter of a root as HTML."""
    line = lines[number]
    parent = lines.get(line.parent)
    angles = f"{_to_vertical_deg(line):.0f}° to the vertical"
    to_parent = None if parent is None else emergence_deg(line.points_mm, parent.points_mm)
    laterals = sum(other.parent == number for other in lines.values())
    facts = [
        f"<b>Root {number}</b> {order_name(order)}; {count(laterals, 'lateral')}",
        f"{line.length_mm:.1f} mm, tip {'visible' if line.tip_seen else 'hidden by other roots'}",
        angles if to_parent is None else f"{angles}, {to_parent:.0f}° to its parent",
        f"mean diameter {_mean_diameter_text(line)}",
    ]
    return f"{_PADDED}{'<br>'.join(facts)}{profile(line)}</div>"


def selection(roots: int, length_mm: float, voxels: int, volume_mm3: float) -> str:
    """Return a text with the number and size of the selected roots and voxels."""
    if not roots and not voxels:
        return f"{_PADDED}Nothing is selected. Click a root, or hold Shift and drag a rectangle.</div>"
    parts = []
    if roots:
        parts.append(f"{roots} root{'' if roots == 1 else 's'}, {length_mm:.1f} mm")
    if voxels:
        parts.append(f"{voxels} voxel{'' if voxels == 1 else 's'}, {round_digits(volume_mm3 / 1000.0)} ml")
    return f"{_PADDED}Selected: <b>{' and '.join(parts)}</b></div>"


def edit(one: Edit) -> str:
    """Return a short description of a correction."""
    if one.roots:
        return f"{one.do} ({', '.join(str(number) for number in one.roots[:4])}{', ...' if len(one.roots) > 4 else ''})"
    return f"{one.do} ({sum(count for _, count in one.runs)})" if one.runs else one.do


def history(edits: Sequence[Edit]) -> str:
    """Return the list of corrections, latest first."""
    if not edits:
        return note("No corrections yet.")
    last_first = list(enumerate(edits, start=1))[::-1]
    rows = "".join(f"<li value='{k}'>{html.escape(edit(one))} <small>{html.escape(one.who)}</small></li>" for k, one in last_first)
    style = "margin:0.2em 0;padding-left:1.8em;max-height:14em;overflow-y:auto"
    return f"{_PADDED}<b>{len(edits)} correction{'' if len(edits) == 1 else 's'}</b><ol reversed style='{style}'>{rows}</ol></div>"


def colour_key(key: Key) -> str:
    """Return the colour key: swatches with labels, or a scale with labels at its ends."""
    box = "display:inline-block;height:0.8em;border-radius:3px;margin:0 0.4em 0 0;vertical-align:-0.05em"
    swatches = "".join(
        f"<div><span style='{box};width:0.9em;background:rgb{rgb}'></span>{html.escape(label)}</div>" for rgb, label in key.swatches
    )
    scale = ""
    if key.ends is not None:
        low, high = (html.escape(end) for end in key.ends)
        colours = "#440154,#3b528b,#21918c,#5ec962,#fde725"
        scale = f"{low} <span style='{box};width:5em;margin:0 0.3em;background:linear-gradient(90deg,{colours})'></span>{high}"
    return f"{_PADDED}{swatches}{scale}</div>"


def traits(found: Traits, *, edited: bool, summary: dict[str, Any]) -> str:
    """Return the table of traits with their 90 % intervals.

    After corrections, the intervals are not known. A trait that was not reliable remains so.

    Parameters
    ----------
    found : Traits
        Traits after corrections.
    edited : bool
        Whether there are corrections.
    summary : dict
        Content of the ``result.json`` without these corrections.
    """
    rows = []
    assessed = assessments.assess(summary, found)
    for definition in DEFINITIONS:
        value = getattr(found, definition.field)
        if value is None:
            continue
        assessment = assessed[definition.field]
        name, shown, reliability, meaning = words.trait_text(definition, value, assessment)
        if edited:
            reliability = "not reliable" if assessment.verdict == "not reliable" else "no interval after corrections"
        below = f"<br><small>{html.escape(reliability)}</small>"
        rows.append(f"<tr title='{html.escape(meaning)}'><td>{html.escape(name)}</td><td>{html.escape(shown)}{below}</td></tr>")
    head = "<b>After corrections</b>" if edited else "Move the mouse over a trait to see its definition."
    return f"{_PADDED}{head}<table>{''.join(rows)}</table></div>"


def note(text: str) -> str:
    """Return an escaped sentence as an HTML element."""
    return f"{_PADDED}{html.escape(text)}</div>"


def profile(line: Line) -> str:
    """Return a plot of the diameter along a root as SVG, with the 90 % interval as a band."""
    half_mm = half_widths(line)
    low, high = (line.diameters_mm, line.diameters_mm) if half_mm is None else (line.diameters_mm - half_mm, line.diameters_mm + half_mm)
    left, right, top, base = 34.0, 292.0, 6.0, 72.0
    across, up = (right - left) / max(float(line.way_mm[-1]), 1e-6), (base - top) / max(float(high.max()), 1e-6)

    def at(way_mm: Array, diameter_mm: Array) -> str:
        x, y = left + across * way_mm, base - up * np.maximum(diameter_mm, 0.0)
        return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))

    marks = "".join(
        f"<path d='M{left:g} {base - up * value:.1f}H{right:g}' stroke='var(--line)'/>"
        f"<text x='{left - 4:g}' y='{base - up * value + 3.5:.1f}' text-anchor='end'>{value:g}</text>"
        for value in ticks(0.0, float(high.max()), most=4)
    )
    marks += "".join(
        f"<path d='M{left + across * value:.1f} {base:g}v4' stroke='var(--soft)'/>"
        f"<text x='{left + across * value:.1f}' y='{base + 14:g}' text-anchor='middle'>{value:g}</text>"
        for value in ticks(0.0, float(line.way_mm[-1]), most=6)
    )
    band = f"{at(line.way_mm, high)} {at(line.way_mm[::-1], low[::-1])}"
    return (
        f"<svg viewBox='0 0 300 102' role='img' aria-label='Diameter along the root'>{marks}"
        f"<polygon points='{band}' fill='var(--accent)' fill-opacity='0.25'/>"
        f"<polyline points='{at(line.way_mm, line.diameters_mm)}' fill='none' stroke='var(--accent)' stroke-width='1.5'/>"
        f"<text x='{(left + right) / 2:g}' y='{base + 27:g}' text-anchor='middle'>distance from the base (mm)</text>"
        f"<text transform='translate(8 {(top + base) / 2:g}) rotate(-90)' text-anchor='middle'>diameter (mm)</text></svg>"
    )


def picture(name: str, jpeg: bytes, angle_deg: float | None) -> str:
    """Return a picture with the outline of the reconstruction as an HTML element, with its name and the table angle."""
    angle = "" if angle_deg is None else f", table at {round(angle_deg, 1) % 360.0:.1f}°"
    text = html.escape(name)
    meaning = "Outline of the reconstruction, projected through the water. Selected roots are yellow."
    image = f"<img alt='Outline of the reconstruction on {text}' title='{meaning}' src='{data_uri('image/jpeg', jpeg)}'>"
    return f"<div class=beside>{image}{text}{angle}</div>"


def _to_vertical_deg(line: Line) -> float:
    size = polyline.steps_mm(line.points_mm)
    cosine = np.clip(-np.diff(line.points_mm[:, 2]) / np.maximum(size, 1e-12), -1.0, 1.0)
    return float(np.rad2deg(np.arccos(cosine)) @ size / max(size.sum(), 1e-12))


def _mean_diameter_text(line: Line) -> str:
    """Return a text with the mean diameter of a root, and the half-width of its 90 % interval.

    The errors of the diameter are assumed to be fully correlated along the root.
    """
    half_mm = half_widths(line)
    text = f"{_weighted_mean(line, line.diameters_mm):.2f}"
    return f"{text} mm" if half_mm is None else f"{text} ± {_weighted_mean(line, half_mm):.2f} mm (90 %)"


def _weighted_mean(line: Line, values: Array) -> float:
    """Return the mean of values (N,) at the points of a root, weighted by the length between the points."""
    size = polyline.steps_mm(line.points_mm)
    return float((values[1:] + values[:-1]) / 2.0 @ size / max(size.sum(), 1e-12))
