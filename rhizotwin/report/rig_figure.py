"""Draw the rig from the side, and the cameras of a result from above, as SVG."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import frames, plan
from rhizotwin.scenes.dataset import Dataset
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


def cameras(summary: dict[str, Any], dataset: Dataset) -> str:
    """Draw the camera positions around the canister from above, as SVG. Crosses mark the cameras of unused views.

    Views without an estimated pose are drawn where the capture plan has them, or omitted.
    """
    can, pot = dataset.scene.canister, dataset.scene.net_pot
    nominal = nominal_centres(dataset)
    poses, places = {}, {}
    for view in summary["views"]:
        if view.get("cam_from_canister") is not None:
            poses[view["file"]] = frames.invert(np.array(view["cam_from_canister"], np.float64))
            places[view["file"]] = poses[view["file"]][:3, 3]
        elif view["file"] in nominal:
            places[view["file"]] = nominal[view["file"]]
    reach = 1.1 * max(can.outer_radius_mm, *(float(np.hypot(x, y)) for x, y, _ in places.values()), 0.0)
    size, parts = reach / 60.0, []
    for view in summary["views"]:
        if view["file"] not in places:
            continue
        x, y, _ = places[view["file"]]
        if view["used"] and view["file"] in poses:
            ahead = places[view["file"]] + 6.0 * size * poses[view["file"]][:3, 2]
            parts.append(_line(x, y, ahead[0], ahead[1], "#9db7cc") + f'<circle cx="{x:g}" cy="{-y:g}" r="{size:g}" fill="#1f5f8b"/>')
        else:
            parts += [_line(x - size, y - side * size, x + size, y + side * size, _RED) for side in (-1.0, 1.0)]
    radii = ((can.outer_radius_mm, "#f0f0f0"), (can.inner_radius_mm, "#cfe6f5"), (pot.outer_radius_mm, "#d9dcde"))
    canister = "".join(f'<circle r="{radius:g}" fill="{fill}" stroke="#77828a" stroke-width="0.8"/>' for radius, fill in radii)
    frame = _arrow(0.0, 0.0, 28.0, 0.0, "x") + _arrow(0.0, 0.0, 0.0, 28.0, "y")
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{-reach:g} {-reach:g} {2.0 * reach:g} {2.0 * reach:g}" role="img" '
        f'aria-label="cameras from above" font-family="sans-serif" font-size="{2.0 * size:.1f}">{canister}{frame}{"".join(parts)}</svg>'
    )


def nominal_centres(dataset: Dataset) -> dict[str, NDArray[np.float64]]:
    """Return the planned camera position of each picture in the capture plan.

    Positions (3,), mm, are in the canister frame and keyed by file name. Pictures that are not part of the plan are
    omitted.
    """
    centres = dict[str, NDArray[np.float64]]()
    for frame in dataset.frames:
        if frame.table_deg is None or frame.ring >= len(dataset.scene.plan.rings):
            continue
        ring = dataset.scene.plan.rings[frame.ring]
        cam_from_rig = frames.level_camera(distance_mm=ring.distance_mm, height_mm=ring.height_mm, tilt_deg=ring.tilt_deg)
        cam_from_table = cam_from_rig @ plan.rig_from_table(dataset.scene, frame.table_deg)
        centres[frame.file] = frames.invert(cam_from_table)[:3, 3]
    return centres


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
