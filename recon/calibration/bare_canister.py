"""Cameras of a telecentric scan without markers: from the canister's own edges, and from what makes the views agree.

With parallel rays that nothing bends, a point (X, Y, Z) of the canister is seen from the azimuth alpha and the elevation eps at

    u = u_axis + (-X sin alpha + Y cos alpha) / s            column
    v = v_0 - (Z cos eps - (X cos alpha + Y sin alpha) sin eps) / s    row, s mm a pixel.

The canister's two outer edges give its axis u_axis and lean in every view, and with the diameter that a person knows the scale s. The
table's angles come from the roots without finding a single one of them: what a row of a picture shows, added up, is the same in every view
(its zeroth moment), and its centre of mass (its first moment) goes round with the table as one point does. These are the
Helgason-Ludwig conditions of parallel projections (Ludwig 1966, Communications on Pure and Applied Mathematics 19:49). The zeroth
moments also tell the elevation: points that are nearer stand lower in the picture.

Under parallel straight rays a shape and its mirror image, turned the other way, make the same pictures: the sense of the table has to be
given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.pictures import Grey

Array = NDArray[np.float64]

LEAST_VIEWS = 12
"""Fewer views round the turn leave the centre of mass of a row, three unknowns and an angle a view, with little to spare."""
BARE_QUANTILE = 0.85
"""Of a pixel's values over the turn: the panel, where roots pass in less than a seventh of the views."""
EDGE_REACH_PX = 12
"""About the place that the mean picture shows: a canister that stands a few pixels off the table's axis."""
LEAST_COVERAGE = 0.08
"""Less coverage than this is noise, compression and dirt of the panel."""
BAND = 0.06
"""Share of the water's height that is left out at its surface and floor, where reflections are no roots."""
ANGLE_SIGMA_RAD = np.deg2rad(1.5)
"""How far a cheap table's angle may be from equal steps (measured on a real one of 72 steps: 0.8 degrees)."""
SHIFT_SIGMA_PX = 1.0
"""How far the canister may be lifted from view to view."""
ROWS_TOGETHER = 8.0
"""Rows of a picture that share one root's error and count as one."""
MOST_AGREEMENT_PX = 3.0
"""Centres of mass that are farther than this from where one turning point would be: bent rays, another canister, or no turn at all."""
_ROUNDS = 200


@dataclass(frozen=True, kw_only=True)
class BareCanister:
    """What pictures without markers tell of their cameras."""

    cam_from_canister: tuple[Array, ...]
    """4x4 a view, mm, OpenCV axes; the distance along the optical axis is not seen and as the scene's plan has it."""
    mm_per_px: float
    azimuth_deg: Array
    """(V,) of the camera in the canister frame; 0 for the first view."""
    elevation_deg: float
    """Of the optical axis below the horizon."""
    agreement_px: float
    """Robust standard deviation of rows' centres of mass from where a turning point would be."""
    floor_z_mm: float | None
    """Height of the floor, where the pictures show it."""
    inner_radius_mm: float
    """Half the width through which the panel is seen."""


@dataclass(frozen=True)
class _Edges:
    """Where the canister stands in the pictures."""

    axis_px: Array
    """(V, 2) column of the axis at ``middle`` and its change by the row."""
    width_px: float
    inner_px: float
    middle: float
    """Row that ``axis_px`` is about."""
    rows: tuple[int, int]
    """First row of the water, and the row after its last."""
    columns: tuple[int, int]
    """The same of the columns through which the panel is seen."""
    floor_seen: bool


def find_cameras(pictures: Sequence[Grey], scene: Scene, table_deg: Sequence[float]) -> BareCanister:
    """Find the camera of every picture of one turn.

    Parameters
    ----------
    pictures
        (H, W) each, of one telecentric camera at rest before a turning canister.
    scene
        Canister with its outer radius, water level, table's sense, plan's distance.
    table_deg
        Angles that the table was told.

    Raises
    ------
    UserError
        Where the camera is not telecentric, the views are too few, the canister's edges or the water's surface are not seen, or the views
        do not agree.
    """
    if scene.camera.kind != "telecentric":
        raise UserError('cameras without markers are found for a telecentric camera only; give camera.kind = "telecentric" in the scene')
    if len(pictures) < LEAST_VIEWS:
        raise UserError(f"{len(pictures)} pictures are too few to find cameras without markers; at least {LEAST_VIEWS} are needed")
    stack = np.stack(pictures)
    bare = _bare(stack)
    edges = _find_edges(stack, bare)
    mm_per_px = 2.0 * scene.canister.outer_radius_mm / edges.width_px
    mass, centre = _moments(stack, bare, edges)
    start = -scene.turntable.direction * np.deg2rad(np.asarray(table_deg, np.float64) - table_deg[0])
    azimuth, place, agreement = _turn(centre, mass, start)
    if agreement > MOST_AGREEMENT_PX:
        raise UserError(
            f"the pictures' rows do not turn as one body does under parallel straight rays (off by {agreement:.1f} px, at most "
            f"{MOST_AGREEMENT_PX:g}): the liquid about the canister may not match, the steps may be uneven or the plan wrong"
        )
    lean = np.cos(azimuth)[:, None] * [0.0, 1.0] - np.sin(azimuth)[:, None] * [1.0, 0.0]  # right hand of each view in (X, Y)
    slope = np.column_stack([np.ones(len(azimuth)), -lean])
    roll, tilt_x, tilt_y = np.linalg.lstsq(slope, edges.axis_px[:, 1], rcond=None)[0]
    nearer = np.cos(azimuth)[:, None] * place[0] + np.sin(azimuth)[:, None] * place[1]
    shift, elevation = _lift(mass, nearer)
    towards = tilt_x * np.cos(azimuth) + tilt_y * np.sin(azimuth)
    del roll
    level_row = edges.rows[0] - 0.5
    zero_row = level_row + scene.water.level_mm / mm_per_px
    poses = tuple(
        _pose(scene, mm_per_px, float(alpha), elevation + float(lean_to), edges.axis_px[k], edges.middle, zero_row + float(shift[k]))
        for k, (alpha, lean_to) in enumerate(zip(azimuth, towards, strict=True))
    )
    return BareCanister(
        cam_from_canister=poses,
        mm_per_px=mm_per_px,
        azimuth_deg=np.rad2deg(azimuth),
        elevation_deg=float(np.rad2deg(elevation)),
        agreement_px=agreement,
        floor_z_mm=-(edges.rows[1] - 0.5 - zero_row) * mm_per_px if edges.floor_seen else None,
        inner_radius_mm=0.5 * edges.inner_px * mm_per_px,
    )


def _bare(stack: NDArray[np.generic]) -> NDArray[np.float32]:
    """Return the empty panel (H, W), block by block of rows."""
    bare = np.empty(stack.shape[1:], np.float32)
    for first in range(0, len(bare), 64):
        bare[first : first + 64] = np.quantile(stack[:, first : first + 64], BARE_QUANTILE, axis=0)
    return np.maximum(bare, 1.0)


def _runs(bright: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and past-the-last index of every run of true values."""
    change = np.flatnonzero(np.diff(np.concatenate([[0], bright.astype(np.int8), [0]])))
    return list(zip(change[::2].tolist(), change[1::2].tolist(), strict=True))


def _find_edges(stack: NDArray[np.generic], bare: NDArray[np.float32]) -> _Edges:
    """Find the canister's outer edges in every view, and where the water is."""
    height, width = bare.shape
    level = 0.5 * float(np.quantile(bare, 0.95))
    profile = np.median(bare[height // 4 : 3 * height // 4], axis=0)
    runs = [run for run in _runs(profile > level) if run[1] - run[0] > 2 * EDGE_REACH_PX]
    inside = max(runs, key=lambda run: (run[0] <= width // 2 < run[1], run[1] - run[0]), default=(0, 0))
    left, right = [run for run in runs if run[1] <= inside[0]], [run for run in runs if run[0] >= inside[1]]
    if not left or not right:
        raise UserError("the canister's two outer edges are not seen; the bright panel must show on both sides of it and through it")
    middle_columns = slice(inside[0] + (inside[1] - inside[0]) // 4, inside[1] - (inside[1] - inside[0]) // 4)
    down = np.median(bare[:, middle_columns], axis=1)
    water = max(_runs(down > level), key=lambda run: run[1] - run[0], default=(0, 0))
    if water[0] == 0 or water[1] - water[0] < height // 8:
        raise UserError("the water's surface is not seen, so nobody can tell heights; it must lie within the pictures")
    margin = round(BAND * (water[1] - water[0]))
    rows = np.arange(water[0] + margin, water[1] - margin)
    middle = float(rows.mean())
    lines = [
        np.array([_edge_line(picture, rows, middle, at, level, rising=rising) for picture in stack])
        for at, rising in ((left[-1][1], False), (right[0][0], True))
    ]
    return _Edges(
        axis_px=0.5 * (lines[0] + lines[1]),
        width_px=float(np.median(lines[1][:, 0] - lines[0][:, 0])),
        inner_px=float(inside[1] - inside[0]),
        middle=middle,
        rows=water,
        columns=inside,
        floor_seen=water[1] < height,
    )


def _edge_line(picture: NDArray[np.generic], rows: NDArray[np.int64], middle: float, at: int, level: float, *, rising: bool) -> Array:
    """Return the column at the middle row and the slope of an edge near the column ``at``, robustly."""
    first = max(at - EDGE_REACH_PX, 0)
    part = picture[rows, first : at + EDGE_REACH_PX].astype(np.float64)
    bright = part >= level if rising else part < level
    step = np.argmax(bright[:, 1:] & ~bright[:, :-1], axis=1)
    crossed = (bright[:, 1:] & ~bright[:, :-1]).any(axis=1)
    a, b = np.take_along_axis(part, step[:, None], 1)[:, 0], np.take_along_axis(part, step[:, None] + 1, 1)[:, 0]
    place = first + step + (level - a) / np.where(b == a, 1.0, b - a)
    y, x = rows[crossed] - middle, place[crossed]
    if len(x) < len(rows) // 2:
        raise UserError("the canister's outer edge is lost in a picture; keep the panel beside the canister free")
    weight, line = np.ones(len(x)), np.zeros(2)
    for _ in range(8):
        line = np.polyfit(y, x, 1, w=weight)[::-1]
        off = np.abs(x - line[0] - line[1] * y)
        weight = 1.0 / (1.0 + (off / (2.0 * 1.4826 * np.median(off) + 1e-6)) ** 2)
    return line


def _moments(stack: NDArray[np.generic], bare: NDArray[np.float32], edges: _Edges) -> tuple[Array, Array]:
    """Return each row's mass (V, R), px, and its centre of mass (V, R), px from the axis, of what the views cover."""
    margin = round(BAND * (edges.rows[1] - edges.rows[0]))
    rows = np.arange(edges.rows[0] + margin, edges.rows[1] - margin)
    side = round(BAND * (edges.columns[1] - edges.columns[0]))
    columns = np.arange(edges.columns[0] + side, edges.columns[1] - side)
    mass, centre = np.empty((len(stack), len(rows))), np.empty((len(stack), len(rows)))
    empty = bare[np.ix_(rows, columns)]
    for k, picture in enumerate(stack):
        covered = 1.0 - picture[np.ix_(rows, columns)] / empty
        covered[covered < LEAST_COVERAGE] = 0.0
        mass[k] = covered.sum(axis=1, dtype=np.float64)
        axis = edges.axis_px[k, 0] + edges.axis_px[k, 1] * (rows - edges.middle)
        centre[k] = (covered @ columns.astype(np.float64)) / np.maximum(mass[k], 1e-6) - axis
    return mass, centre


def _turn(centre: Array, mass: Array, start: Array) -> tuple[Array, Array, float]:
    """Find the azimuths (V,), and each row's turning point (2, R), px, from the rows' centres of mass.

    Azimuths and points are improved in turn, first with equal steps of any size, then with each view's angle free.
    """
    shown = np.median(mass, axis=0) > 1.0
    if shown.sum() < ROWS_TOGETHER * 4:
        raise UserError("the pictures show hardly anything in the canister, so that the table's angles cannot be found from it")
    value = np.where(mass > 0.5 * np.median(mass, axis=0), centre, np.nan)[:, shown]
    known = np.isfinite(value)
    value = np.nan_to_num(value)
    azimuth, weight = start.copy(), known.astype(np.float64)
    ideal, scatter, points = start.copy(), 1.0, np.zeros((2, value.shape[1]))
    for turn in range(_ROUNDS):
        right = np.stack([-np.sin(azimuth), np.cos(azimuth)], axis=1)
        normal = np.einsum("vr,vi,vj->rij", weight, right, right) + 1e-9 * np.eye(2)
        points = np.linalg.solve(normal, np.einsum("vr,vi,vr->ri", weight, right, value)[..., None])[..., 0].T
        off = value - right @ points
        scatter = max(1.4826 * float(np.median(np.abs(off[known]))), 1e-3)
        weight = known / (1.0 + (off / (2.0 * scatter)) ** 2)
        by_angle = -np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1) @ points
        if turn < _ROUNDS // 4:
            by_step = by_angle * start[:, None]
            change = float((weight * by_step * off).sum() / max((weight * by_step**2).sum(), 1e-9))
            azimuth = azimuth + change * start
            ideal = azimuth
        else:
            unit = ROWS_TOGETHER * scatter**2
            gain = (weight * by_angle * off).sum(axis=1) / unit - (azimuth - ideal) / ANGLE_SIGMA_RAD**2
            azimuth = azimuth + gain / ((weight * by_angle**2).sum(axis=1) / unit + ANGLE_SIGMA_RAD**-2)
            azimuth = azimuth - azimuth[0]
    everywhere = np.zeros((2, mass.shape[1]))
    everywhere[:, shown] = points
    return azimuth, everywhere, scatter


def _lift(mass: Array, nearer: Array) -> tuple[Array, float]:
    """Find by how many rows each view is lifted (V,), and the camera's elevation (rad), from the rows' masses.

    ``nearer`` (V, R) is how many pixels nearer than the axis a row's mass lies; a row moves by shift + elevation * nearer.
    """
    views, rows = mass.shape
    typical = np.median(mass, axis=0)
    slope, row = np.gradient(typical), np.arange(rows, dtype=np.float64)
    unknown = np.zeros(views + 1)
    prior = np.diag(np.concatenate([np.full(views, SHIFT_SIGMA_PX**-2.0), [1e-6]]))
    for _ in range(10):
        normal, right = prior.copy(), -prior @ unknown
        for k in range(views):
            moved = np.interp(row + unknown[k] + unknown[-1] * nearer[k], row, mass[k])
            off = moved - typical
            scatter = 1.4826 * float(np.median(np.abs(off))) + 1e-9
            weight = 1.0 / (1.0 + (off / (2.0 * scatter)) ** 2) / (ROWS_TOGETHER * scatter**2)
            by = np.stack([slope, slope * nearer[k]])
            block = (by * weight) @ by.T
            at = np.ix_([k, views], [k, views])
            normal[at] += block
            right[[k, views]] -= (by * weight) @ off
        unknown += np.linalg.solve(normal, right)
    return unknown[:-1], float(unknown[-1])


def _pose(scene: Scene, mm_per_px: float, azimuth: float, elevation: float, axis_px: Array, middle: float, zero_row: float) -> Array:
    """Return a view's camera: looking at the axis from an azimuth and elevation, rolled and shifted as the canister's edges show."""
    away, up = np.array([np.cos(azimuth), np.sin(azimuth), 0.0]), np.array([0.0, 0.0, 1.0])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    forward = -np.cos(elevation) * away - np.sin(elevation) * up
    turned = np.eye(4)
    turned[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    lean = np.arctan(axis_px[1])
    pose = frames.rotation_z(-float(lean)) @ turned
    cx, cy = scene.camera.principal_px
    column = axis_px[0] + axis_px[1] * (zero_row - middle)
    pose[:3, 3] = mm_per_px * (column - cx), mm_per_px * (zero_row - cy), scene.plan.rings[0].distance_mm
    return np.asarray(pose)
