"""Cameras of a telecentric scan without markers: from the canister's own edges, and from what makes the views agree.

With parallel rays that nothing bends, a point (X, Y, Z) of the canister is seen from the azimuth alpha and the
elevation eps at

    u = u_axis + (-X sin alpha + Y cos alpha) / s            column
    v = v_0 - (Z cos eps - (X cos alpha + Y sin alpha) sin eps) / s    row, s mm a pixel.

The canister's two outer edges give its axis u_axis and lean in every view, and with the diameter that a person knows
the scale s. The table's angles come from the roots without finding a single one of them: what a row of a picture cuts,
added up, is the same in every view (its zeroth moment), its centre of mass (its first moment) goes round with the table
as one point does, and its mean square (its second) as an ellipse. These are the Helgason-Ludwig conditions of parallel
projections (Ludwig 1966, Communications on Pure and Applied Mathematics 19:49). The zeroth moments also tell the
elevation: points that are nearer stand lower in the picture.

Under parallel straight rays a shape and its mirror image, turned the other way, make the same pictures: the sense of
the table has to be given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.cameras import BareUncertainty
from rhizotwin.recon.robust import MAD
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.pictures import Grey

Array = NDArray[np.float64]
Stack = NDArray[np.uint8 | np.uint16]

LEAST_VIEWS = 12
"""Fewer views round the turn leave the centre of mass of a row, three unknowns and an angle a view, with little to
spare."""
BARE_QUANTILE = 0.85
"""Of a pixel's values over the turn: the panel, where roots pass in less than a seventh of the views."""
EDGE_REACH_PX = 12
"""About the place that the mean picture shows: a canister that stands a few pixels off the table's axis."""
EDGE_WIDTH_PX = 4
"""Pixels over which an edge that is in focus falls from bright to dark."""
PANEL_SHARE = 0.85
"""Less than this share of the panel's brightness is no longer the bare panel."""
WATER_QUANTILE = 0.25
"""Of a row's brightness across the canister: bright if three quarters of it see the panel."""
LEAST_COVERAGE = 0.08
"""Less coverage than this is noise, compression and dirt of the panel."""
TENSOR_PX = 2.0
"""Over which gradients are gathered for a thread's direction: both its sides, and not its neighbours."""
BAND = 0.06
"""Share of the water's height that is left out at its surface and floor, where reflections are no roots."""
ANGLE_SIGMA_RAD = np.deg2rad(1.5)
"""How far a cheap table's angle may be from equal steps, to begin with (measured on a real one of 72 steps: 0.8
degrees)."""
LEAST_ANGLE_SIGMA_RAD = np.deg2rad(0.01)
"""No table is better than this: a tenth of a sixteenth step of a bare motor of 200 steps."""
SHIFT_SIGMA_PX = 1.0
"""How far the canister may be lifted from view to view, to begin with."""
LEAST_SHIFT_PX = 0.02
"""No edge is placed better in a picture."""
ROWS_TOGETHER = 8.0
"""Rows of a picture that share one root's error and count as one."""
MOST_AGREEMENT_PX = 3.0
"""Centres of mass that are farther than this from where one turning point would be: bent rays, another canister, or no
turn at all."""
STEPS_AGREE = 0.15
"""Share by which all steps together may be longer or shorter than told (a real table: 0.01 to 0.02); a turn with one
view in six more or less is another plan."""
HEIGHTS_AGREE_MM = 1.0
"""Less is the thickness of a meniscus."""
CALLIPER_MM = 0.1
"""Standard deviation of a diameter that a person measures: callipers give way to a tube's wall by a tenth of a
millimetre (their scale reads a fifth of that)."""
_ROUNDS = 200
"""Of relaxation; in the first quarter only the scale of the whole turn is sought."""


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
    floor_z_mm: float | None
    """Height of the floor, where the pictures show it."""
    inner_radius_mm: float
    """Half the width through which the panel is seen."""
    uncertainty: BareUncertainty

    def notes(self, scene: Scene) -> tuple[str, ...]:
        """Return what a person should know of cameras that were found so.

        That is also where the pictures contradict the scene.
        """
        can, step = scene.canister, np.abs(np.diff(np.unwrap(self.azimuth_deg, period=360.0)))
        said = [
            f"cameras from the canister's edges and the roots: {self.mm_per_px:.5g} mm a pixel by its diameter of "
            f"{2.0 * can.outer_radius_mm:g} mm, steps of {step.mean():.2f} +- {step.std():.2f} degrees, elevation "
            f"{self.elevation_deg:.2f} degrees; under parallel rays a table that turns the other way shows the mirror image, so check "
            "turntable.direction"
        ]
        if self.floor_z_mm is not None and abs(self.floor_z_mm - can.floor_z_mm) > HEIGHTS_AGREE_MM:
            said.append(f"the pictures show the floor at z = {self.floor_z_mm:.1f} mm, the scene says {can.floor_z_mm:.1f}; correct it")
        return tuple(said)


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
    pictures : sequence of (H, W) uint8 or uint16 array
        Each, of one telecentric camera at rest before a turning canister.
    scene : Scene
        Canister with its outer radius, water level, table's sense, plan's distance.
    table_deg : sequence of float
        Angles that the table was told.

    Raises
    ------
    UserError
        Where the camera is not telecentric, the views are too few, the canister's edges or the water's surface are not
        seen, or the views do not agree.
    """
    if scene.camera.kind != "telecentric":
        raise UserError('cameras without markers are found for a telecentric camera only; give camera.kind = "telecentric" in the scene')
    if len(pictures) < LEAST_VIEWS:
        raise UserError(f"{len(pictures)} pictures are too few to find cameras without markers; at least {LEAST_VIEWS} are needed")
    stack = np.stack(pictures)
    bare = _bare(stack)
    edges, width_sigma_px = _find_edges(stack, bare)
    mm_per_px = 2.0 * scene.canister.outer_radius_mm / edges.width_px
    mass, moments = _moments(stack, bare, edges)
    start = -scene.turntable.direction * np.deg2rad(np.asarray(table_deg, np.float64) - table_deg[0])
    azimuth, azimuth_sigma, place, agreement = _turn(moments, mass, start)
    if agreement > MOST_AGREEMENT_PX:
        raise UserError(
            f"the pictures' rows do not turn as one body does under parallel straight rays (off by {agreement:.1f} px, at most "
            f"{MOST_AGREEMENT_PX:g}): the liquid about the canister may not match, the steps may be uneven or the plan wrong"
        )
    lean = np.cos(azimuth)[:, None] * [0.0, 1.0] - np.sin(azimuth)[:, None] * [1.0, 0.0]  # right hand of each view in (X, Y)
    slope = np.column_stack([np.ones(len(azimuth)), -lean])
    _, tilt_x, tilt_y = np.linalg.lstsq(slope, edges.axis_px[:, 1], rcond=None)[0]
    nearer = np.cos(azimuth)[:, None] * place[0] + np.sin(azimuth)[:, None] * place[1]
    shift, shift_sigma_px, elevation = _lift(mass, nearer)
    towards = tilt_x * np.cos(azimuth) + tilt_y * np.sin(azimuth)
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
        floor_z_mm=-(edges.rows[1] - 0.5 - zero_row) * mm_per_px if edges.floor_seen else None,
        inner_radius_mm=0.5 * edges.inner_px * mm_per_px,
        uncertainty=BareUncertainty(
            scale=float(np.hypot(width_sigma_px / edges.width_px, CALLIPER_MM / (2.0 * scene.canister.outer_radius_mm))),
            azimuth_rad=float(np.sqrt(np.mean(azimuth_sigma**2))),
            lift_mm=float(np.sqrt(np.mean(shift_sigma_px**2))) * mm_per_px,
            mm_per_px=mm_per_px,
        ),
    )


def _bare(stack: Stack) -> NDArray[np.float32]:
    """Return the empty panel (H, W), block by block of rows."""
    bare = np.empty(stack.shape[1:], np.float32)
    for first in range(0, len(bare), 64):
        bare[first : first + 64] = np.quantile(stack[:, first : first + 64], BARE_QUANTILE, axis=0)
    return np.maximum(bare, 1.0)


def _runs(bright: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and past-the-last index of every run of true values."""
    change = np.flatnonzero(np.diff(np.concatenate([[0], bright.astype(np.int8), [0]])))
    return list(zip(change[::2].tolist(), change[1::2].tolist(), strict=True))


def _find_edges(stack: Stack, bare: NDArray[np.float32]) -> tuple[_Edges, float]:
    """Find the canister's outer edges in every view, and where the water is; with how well the width is known, px."""
    height, width = bare.shape
    panel = float(np.quantile(bare, 0.95))  # lights and their reflections cover less than the rest
    profile = np.median(bare[height // 4 : 3 * height // 4], axis=0)
    runs = [run for run in _runs(profile > 0.5 * panel) if run[1] - run[0] > 2 * EDGE_REACH_PX]
    inside = max(runs, key=lambda run: (run[0] <= width // 2 < run[1], run[1] - run[0]), default=(0, 0))
    bright = [run for run in _runs(profile > PANEL_SHARE * panel) if run[1] - run[0] > 2 * EDGE_REACH_PX]
    left, right = [run for run in bright if run[1] <= inside[0]], [run for run in bright if run[0] >= inside[1]]
    if not left or not right:
        raise UserError("the canister's two outer edges are not seen; the bright panel must show on both sides of it and through it")
    # beside the middle, where through the air above the water no panel is seen
    down = np.quantile(bare[:, inside[0] : inside[1]], WATER_QUANTILE, axis=1)
    water = max(_runs(down > 0.5 * panel), key=lambda run: run[1] - run[0], default=(0, 0))
    if water[0] == 0 or water[1] - water[0] < height // 8:
        raise UserError("the water's surface is not seen, so nobody can tell heights; it must lie within the pictures")
    margin = round(BAND * (water[1] - water[0]))
    rows = np.arange(water[0] + margin, water[1] - margin)
    middle = float(rows.mean())
    from_left = np.array([_edge_line(picture, rows, middle, left[-1][1], panel) for picture in stack])
    from_right = np.array([_edge_line(picture[:, ::-1], rows, middle, width - right[0][0], panel) for picture in stack])
    from_right = np.array([width - 1.0, 0.0]) - from_right
    widths = from_right[:, 0] - from_left[:, 0]
    found = _Edges(
        axis_px=0.5 * (from_left + from_right),
        width_px=float(np.median(widths)),
        inner_px=float(inside[1] - inside[0]),
        middle=middle,
        rows=water,
        columns=inside,
        floor_seen=water[1] < height,
    )
    return found, float(np.std(widths) / np.sqrt(len(widths)))


def _edge_line(picture: Stack, rows: NDArray[np.int64], middle: float, at: int, panel: float) -> Array:
    """Return the column at the middle row, and its change by the row, where the panel ends.

    Robustly, about the column ``at``.

    The edge is where the light has fallen half way from the panel to the darkest of the few pixels behind it, which may
    be less than black.
    """
    first = max(at - EDGE_REACH_PX, 0)
    part = picture[rows, first : at + 2 * EDGE_REACH_PX].astype(np.float64)
    begin = np.argmax(part < PANEL_SHARE * panel, axis=1)
    behind = np.take_along_axis(part, np.minimum(begin[:, None] + np.arange(EDGE_WIDTH_PX), part.shape[1] - 1), 1)
    level = 0.5 * (panel + behind.min(axis=1))
    below = part < level[:, None]
    step = np.maximum(np.argmax(below, axis=1), 1)
    a, b = (np.take_along_axis(part, step[:, None] + k, 1)[:, 0] for k in (-1, 0))
    crossed = below.any(axis=1) & (a >= level) & (b < level)
    place = first + step - 1 + (a - level) / np.where(a > b, a - b, 1.0)
    y, x = rows[crossed] - middle, place[crossed]
    if len(x) < len(rows) // 2:
        raise UserError("the canister's outer edge is lost in a picture; keep the panel beside the canister free")
    weight, line = np.ones(len(x)), np.zeros(2)
    for _ in range(8):
        line = np.polyfit(y, x, 1, w=weight)[::-1]
        off = np.abs(x - line[0] - line[1] * y)
        weight = 1.0 / (1.0 + (off / (2.0 * MAD * np.median(off) + 1e-6)) ** 2)
    return line


def _moments(stack: Stack, bare: NDArray[np.float32], edges: _Edges) -> tuple[Array, Array]:
    """Return each row's mass (V, R), px, and its moments about the axis (2, V, R).

    The moments are the centre of mass, px, and the mean square, px.
    """
    margin = round(BAND * (edges.rows[1] - edges.rows[0]))
    rows = np.arange(edges.rows[0] + margin, edges.rows[1] - margin)
    side = round(BAND * (edges.columns[1] - edges.columns[0]))
    columns = np.arange(edges.columns[0] + side, edges.columns[1] - side)
    mass, moments = np.empty((len(stack), len(rows))), np.empty((2, len(stack), len(rows)))
    empty = bare[np.ix_(rows, columns)]
    for k, picture in enumerate(stack):
        covered = 1.0 - picture[np.ix_(rows, columns)] / empty
        covered[covered < LEAST_COVERAGE] = 0.0
        covered *= _upright(covered.astype(np.float32))
        mass[k] = covered.sum(axis=1, dtype=np.float64)
        across = columns - (edges.axis_px[k, 0] + edges.axis_px[k, 1] * (rows - edges.middle))[:, None]
        for n in range(2):
            moments[n, k] = (covered * across ** (n + 1)).sum(axis=1) / np.maximum(mass[k], 1e-6)
    return mass, moments


def _upright(covered: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the cosine (R, C) of what a picture's threads lean from the vertical, by the structure tensor.

    A row cuts an opaque thread of diameter d over d / cos(lean), and the lean changes from view to view; times the
    cosine it is d in all.
    """
    across, down = (cv2.Sobel(covered, cv2.CV_32F, dx, 1 - dx) for dx in (1, 0))
    horizontal, vertical = (cv2.GaussianBlur(part * part, (0, 0), TENSOR_PX) for part in (across, down))
    return np.asarray(np.sqrt(horizontal / np.maximum(horizontal + vertical, 1e-9)), np.float32)


@dataclass
class _Moment:
    """Rows' moments of one order, and how they turn."""

    order: int
    value: Array
    """(V, R)"""
    known: NDArray[np.bool_]
    weight: Array
    scatter: float = 1.0

    def basis(self, azimuth: Array) -> tuple[Array, Array]:
        """Return the shapes (V, order + 1) that a moment goes through with the azimuth, and their derivatives.

        The shapes are those of (-X sin + Y cos)^order.
        """
        s, c = np.sin(azimuth)[:, None], np.cos(azimuth)[:, None]
        power = np.arange(self.order + 1)[None, :]
        shape = (-s) ** (self.order - power) * c**power
        by_s = -(self.order - power) * (-s) ** np.maximum(self.order - power - 1, 0) * c**power
        by_c = power * (-s) ** (self.order - power) * c ** np.maximum(power - 1, 0)
        return shape, by_s * c - by_c * s

    def improve(self, azimuth: Array) -> tuple[Array, Array, Array]:
        """Fit every row's own numbers (order + 1, R), renew the weights, and return them with what is left.

        What is left (V, R) comes with its change by angle.
        """
        shape, by_angle = self.basis(azimuth)
        normal = np.einsum("vr,vi,vj->rij", self.weight, shape, shape) + 1e-9 * np.eye(self.order + 1)
        own = np.linalg.solve(normal, np.einsum("vr,vi,vr->ri", self.weight, shape, self.value)[..., None])[..., 0].T
        off = self.value - shape @ own
        self.scatter = max(MAD * float(np.median(np.abs(off[self.known]))), 1e-3)
        self.weight = self.known / (1.0 + (off / (2.0 * self.scatter)) ** 2)
        return own, off, by_angle @ own


def _turn(moments: Array, mass: Array, start: Array) -> tuple[Array, Array, Array, float]:
    """Find the azimuths (V,), their standard deviations, each row's turning point (2, R), px, and the scatter, px.

    It uses the rows' first and second moments. Azimuths and what turns are improved by turns, first with equal steps
    of any size, then with each view's angle free. The second moments help where a view looks along the line from the
    axis to the centres of mass.
    """
    shown = np.median(mass, axis=0) > 1.0
    if shown.sum() < ROWS_TOGETHER * 4:
        raise UserError("the pictures show hardly anything in the canister, so that the table's angles cannot be found from it")
    known = (mass > 0.5 * np.median(mass, axis=0))[:, shown]
    orders = [_Moment(n + 1, np.where(known, moments[n][:, shown], 0.0), known, known.astype(np.float64)) for n in range(len(moments))]
    azimuth, ideal, table_sigma = start.copy(), start.copy(), ANGLE_SIGMA_RAD
    points, sigma = np.zeros((2, int(shown.sum()))), np.full(len(start), table_sigma)
    for turn in range(_ROUNDS):
        gradient, curvature = np.zeros(len(start)), np.zeros(len(start))
        for moment in orders:
            own, off, by_angle = moment.improve(azimuth)
            points = own if moment.order == 1 else points
            unit = ROWS_TOGETHER * moment.scatter**2
            gradient += (moment.weight * by_angle * off).sum(axis=1) / unit
            curvature += (moment.weight * by_angle**2).sum(axis=1) / unit
        if turn < _ROUNDS // 4:
            azimuth = azimuth + start * float(gradient @ start / max(float(curvature @ start**2), 1e-9))
            ideal = azimuth
        else:
            steps = float(ideal @ start / max(float(start @ start), 1e-9))
            if abs(steps - 1.0) > STEPS_AGREE:
                raise UserError(
                    f"the pictures turn by {100.0 * steps:.0f} % of the steps that the table was told; a table that slips or stands still, "
                    "or a plan with another number of views a turn"
                )
            off = azimuth - ideal
            azimuth = azimuth + (gradient - off / table_sigma**2) / (curvature + table_sigma**-2)
            # how uneven this table is, by expectation and maximisation:
            # what a view's angle is off by, and how far it is not known
            sigma = 1.0 / np.sqrt(curvature + table_sigma**-2)
            table_sigma = max(float(np.sqrt(np.mean(off**2 + sigma**2))), LEAST_ANGLE_SIGMA_RAD)
    everywhere = np.zeros((2, mass.shape[1]))
    everywhere[:, shown] = points
    turned = frames.rotation_z(-float(azimuth[0]))[:2, :2]
    return azimuth - azimuth[0], sigma, turned @ everywhere, orders[0].scatter


def _lift(mass: Array, nearer: Array) -> tuple[Array, Array, float]:
    """Find by how many rows each view is lifted (V,), with standard deviations, and the camera's elevation (rad).

    They come from the rows' masses.

    ``nearer`` (V, R) is how many pixels nearer than the axis a row's centre of mass lies. What is nearer by n is seen
    lower by elevation * n, so that the mass of a row changes by what flows out of it: d(mass * nearer) / d row for a
    unit of elevation.
    """
    views, rows = mass.shape
    typical = np.median(mass, axis=0)
    slope, row = np.gradient(typical), np.arange(rows, dtype=np.float64)
    unknown, left = np.zeros(views + 1), np.zeros(views)
    sigma_px = SHIFT_SIGMA_PX
    for _ in range(10):
        prior = np.diag(np.concatenate([np.full(views, sigma_px**-2.0), [1e-6]]))
        normal, right = prior.copy(), -prior @ unknown
        for k in range(views):
            by = np.stack([slope, np.gradient(typical * nearer[k])])
            off = np.interp(row + unknown[k], row, mass[k]) - typical + unknown[-1] * by[1]
            scatter = MAD * float(np.median(np.abs(off))) + 1e-9
            weight = 1.0 / (1.0 + (off / (2.0 * scatter)) ** 2) / (ROWS_TOGETHER * scatter**2)
            block = (by * weight) @ by.T
            at = np.ix_([k, views], [k, views])
            normal[at] += block
            right[[k, views]] -= (by * weight) @ off
        unknown += np.linalg.solve(normal, right)
        left = np.diag(np.linalg.inv(normal))[:-1]
        sigma_px = max(float(np.sqrt(np.mean(unknown[:-1] ** 2 + left))), LEAST_SHIFT_PX)
    return unknown[:-1], np.sqrt(left), float(unknown[-1])


def _pose(scene: Scene, mm_per_px: float, azimuth: float, elevation: float, axis_px: Array, middle: float, zero_row: float) -> Array:
    """Return a view's camera, which looks at the axis from an azimuth and elevation.

    It is rolled and shifted as the canister's edges show.
    """
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
