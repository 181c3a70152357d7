"""Draw the rig from the side, and the cameras of a result from above, as SVG."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np

from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Scene

_MARGIN_MM = 45.0
"""Margin around the drawing, mm."""
_RED = "#c0392b"


def svg(scene: Scene) -> str:
    """Draw panel, canister, water, net pot with marker strip, and one camera per ring to scale, as SVG."""
    can, pot, water, strip, lights = scene.canister, scene.net_pot, scene.water, scene.strip, scene.lights
    rings = scene.plan.rings
    left = -lights.backlight_distance_mm - _MARGIN_MM
    right = max(ring.distance_mm for ring in rings) + _MARGIN_MM + 55.0
    panel = lights.backlight_z_mm - lights.backlight_wh_mm[1] / 2.0, lights.backlight_z_mm + lights.backlight_wh_mm[1] / 2.0
    shown = max(panel[0], -can.height_mm - 60.0), min(panel[1], max(pot.top_mm, *(ring.height_mm for ring in rings), 0.0) + 60.0)
    top, bottom = shown[1] + _MARGIN_MM, shown[0] - _MARGIN_MM
    parts = [
        _box(-lights.backlight_distance_mm - 6.0, shown[0], 6.0, shown[1] - shown[0], "#fff3b0", "#b8a040"),
        _text(-lights.backlight_distance_mm, shown[1] + 6.0, "backlight", "start"),
        _box(-can.outer_radius_mm, -can.height_mm, 2.0 * can.outer_radius_mm, can.height_mm, "#eef2f4", "#77828a"),
        _box(-can.inner_radius_mm, can.floor_z_mm, 2.0 * can.inner_radius_mm, water.level_mm - can.floor_z_mm, "#cfe6f5", "#8fb8d4"),
        _box(-pot.outer_radius_mm, pot.skirt_bottom_mm, 2.0 * pot.outer_radius_mm, pot.top_mm - pot.skirt_bottom_mm, "#d9dcde", "#77828a"),
    ]
    for row in range(strip.rows):
        low = strip.bottom_mm + row * strip.row_pitch_mm
        parts.append(_box(-pot.outer_radius_mm, low, 2.0 * pot.outer_radius_mm, strip.marker_mm, "#4a4f53", "#4a4f53"))
    for number, ring in enumerate(rings):
        x, z = ring.distance_mm, ring.height_mm
        parts += [
            _line(x, z, can.outer_radius_mm, z, "#1f5f8b", dash=True),
            _box(x, z - 9.0, 22.0, 18.0, "#1f5f8b", "#123a55"),
            _text(x + 26.0, z - 3.0, f"camera, ring {number}" if len(rings) > 1 else "camera", "start"),
            _horizontal_dimension(0.0, x, -can.height_mm - 22.0 - 12.0 * number, f"{ring.distance_mm:g} mm"),
            _vertical_dimension(x - 14.0 - 12.0 * number, 0.0, z, f"{ring.height_mm:g} mm"),
        ]
    wide = _horizontal_dimension(
        -can.outer_radius_mm, can.outer_radius_mm, -can.height_mm - 10.0, f"diameter {2.0 * can.outer_radius_mm:g} mm"
    )
    parts += [
        wide,
        _vertical_dimension(-can.outer_radius_mm - 12.0, -can.height_mm, 0.0, f"{can.height_mm:g} mm"),
        _horizontal_dimension(-lights.backlight_distance_mm, 0.0, shown[0] - 14.0, f"{lights.backlight_distance_mm:g} mm"),
        _text(0.0, can.floor_z_mm + 18.0, f"water, n = {water.n_water:g}", "middle"),
        _text(0.0, can.floor_z_mm + 6.0, f"wall {can.wall_mm:g} mm, n = {can.n_wall:g}", "middle"),
        _text(0.0, pot.top_mm + 4.0, "net pot with marker strip", "middle"),
        _arrow(0.0, 0.0, 28.0, 0.0, "x"),
        _arrow(0.0, 0.0, 0.0, 28.0, "z"),
        f'<circle cx="0" cy="0" r="2" fill="#c0392b"/>{_text(0.0, pot.skirt_bottom_mm - 12.0, "canister frame", "middle", _RED)}',
    ]
    name = escape(scene.name)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{left:g} {-top:g} {right - left:g} {top - bottom:g}" role="img" '
        f'aria-label="the rig of {name} from the side" font-family="sans-serif" font-size="9">{"".join(parts)}</svg>'
    )


def cameras(summary: dict[str, Any], scene: Scene) -> str:
    """Draw the estimated camera positions around the canister from above, as SVG. Cameras of unused views are red."""
    can, pot = scene.canister, scene.net_pot
    known = [view for view in summary["views"] if view.get("cam_from_canister") is not None]
    poses = [frames.invert(np.array(view["cam_from_canister"], np.float64)) for view in known]
    reach = 1.1 * max(can.outer_radius_mm, *(float(np.hypot(*pose[:2, 3])) for pose in poses), 0.0)
    size = reach / 60.0
    radii = ((can.outer_radius_mm, "#f0f0f0"), (can.inner_radius_mm, "#cfe6f5"), (pot.outer_radius_mm, "#d9dcde"))
    parts = [f'<circle r="{radius:g}" fill="{fill}" stroke="#77828a" stroke-width="0.8"/>' for radius, fill in radii]
    parts += [_arrow(0.0, 0.0, 28.0, 0.0, "x"), _arrow(0.0, 0.0, 0.0, 28.0, "y")]
    for view, pose in zip(known, poses, strict=True):
        (x, y), (ahead_x, ahead_y) = pose[:2, 3], (pose[:3, 3] + 6.0 * size * pose[:3, 2])[:2]
        colour = "#1f5f8b" if view["used"] else _RED
        parts.append(_line(x, y, ahead_x, ahead_y, colour) + f'<circle cx="{x:g}" cy="{-y:g}" r="{size:g}" fill="{colour}"/>')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{-reach:g} {-reach:g} {2.0 * reach:g} {2.0 * reach:g}" role="img" '
        f'aria-label="cameras from above" font-family="sans-serif" font-size="{2.0 * size:.1f}">{"".join(parts)}</svg>'
    )


def _box(x: float, z: float, wide: float, high: float, fill: str, edge: str) -> str:
    return f'<rect x="{x:g}" y="{-z - high:g}" width="{wide:g}" height="{high:g}" fill="{fill}" stroke="{edge}" stroke-width="0.8"/>'


def _line(x1: float, z1: float, x2: float, z2: float, colour: str = "#333", *, dash: bool = False) -> str:
    dashes = ' stroke-dasharray="4 3"' if dash else ""
    return f'<line x1="{x1:g}" y1="{-z1:g}" x2="{x2:g}" y2="{-z2:g}" stroke="{colour}" stroke-width="0.8"{dashes}/>'


def _text(x: float, z: float, text: str, anchor: str, colour: str = "#222") -> str:
    return f'<text x="{x:g}" y="{-z:g}" text-anchor="{anchor}" fill="{colour}">{escape(text)}</text>'


def _horizontal_dimension(x1: float, x2: float, z: float, text: str) -> str:
    ends = _line(x1, z - 3.0, x1, z + 3.0) + _line(x2, z - 3.0, x2, z + 3.0)
    return _line(x1, z, x2, z) + ends + _text((x1 + x2) / 2.0, z + 2.0, text, "middle")


def _vertical_dimension(x: float, z1: float, z2: float, text: str) -> str:
    ends = _line(x - 3.0, z1, x + 3.0, z1) + _line(x - 3.0, z2, x + 3.0, z2)
    return _line(x, z1, x, z2) + ends + _text(x - 4.0, (z1 + z2) / 2.0 - 3.0, text, "end")


def _arrow(x1: float, z1: float, x2: float, z2: float, name: str) -> str:
    return _line(x1, z1, x2, z2, _RED) + _text(x2 + 3.0, z2 - 2.0, name, "start", _RED)
