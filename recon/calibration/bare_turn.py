"""Table angles from the rows of telecentric pictures, without detecting roots (`bare_canister`)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.bare_edges import BAND, Edges, Stack
from rhizotwin.recon.robust import MAD
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError

Array = NDArray[np.float64]

LEAST_COVERAGE = 0.08
"""Minimum coverage; lower values are noise, compression artefacts and dirt on the panel."""
TENSOR_PX = 2.0
"""Standard deviation over which gradients are averaged for a root's direction: both its sides, but not its
neighbours."""
ANGLE_SIGMA_RAD = np.deg2rad(1.5)
"""Initial standard deviation of a table's angles about equal steps (0.8 degrees for a real table with 72 steps)."""
LEAST_ANGLE_SIGMA_RAD = np.deg2rad(0.01)
"""Minimum standard deviation of a table: a tenth of a sixteenth step of a plain motor of 200 steps."""
SHIFT_SIGMA_PX = 1.0
"""Initial standard deviation of the vertical displacement of the canister between views."""
LEAST_SHIFT_PX = 0.02
"""Minimum standard deviation of an edge position in a picture."""
ROWS_TOGETHER = 8.0
"""Number of rows that share the error of one root and count as one."""
STEPS_AGREE = 0.15
"""Maximum relative deviation of the total turn from the commanded one (a real table: 0.01 to 0.02); one view in six
more or less is another plan."""
_ROUNDS = 200
"""Number of relaxation steps; the first quarter only estimates the scale of the whole turn."""


def row_moments(stack: Stack, bare: NDArray[np.float32], edges: Edges) -> tuple[Array, Array]:
    """Return each row's mass (V, R), px, and its moments about the axis (2, V, R).

    The moments are the centre of mass, px, and the mean square, px^2.
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
        covered *= _vertical_cosine(covered.astype(np.float32))
        mass[k] = covered.sum(axis=1, dtype=np.float64)
        across = columns - (edges.axis_px[k, 0] + edges.axis_px[k, 1] * (rows - edges.middle))[:, None]
        for n in range(2):
            moments[n, k] = (covered * across ** (n + 1)).sum(axis=1) / np.maximum(mass[k], 1e-6)
    return mass, moments


def _vertical_cosine(covered: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the cosine (R, C) of the angle of roots from the vertical in a picture, from the structure tensor.

    A row cuts an opaque root of diameter d over d / cos(angle), and the angle changes from view to view; times the
    cosine, the length is d in every view.
    """
    across, down = (cv2.Sobel(covered, cv2.CV_32F, dx, 1 - dx) for dx in (1, 0))
    horizontal, vertical = (cv2.GaussianBlur(part * part, (0, 0), TENSOR_PX) for part in (across, down))
    return np.asarray(np.sqrt(horizontal / np.maximum(horizontal + vertical, 1e-9)), np.float32)


@dataclass
class _Moment:
    """Moments of one order of all rows, and their variation with the turn."""

    order: int
    value: Array
    """(V, R)"""
    known: NDArray[np.bool_]
    weight: Array
    scatter: float = 1.0

    def basis(self, azimuth: Array) -> tuple[Array, Array]:
        """Return the basis functions (V, order + 1) of a moment in the azimuth, and their derivatives.

        They are the terms of (-X sin + Y cos)^order.
        """
        s, c = np.sin(azimuth)[:, None], np.cos(azimuth)[:, None]
        power = np.arange(self.order + 1)[None, :]
        shape = (-s) ** (self.order - power) * c**power
        by_s = -(self.order - power) * (-s) ** np.maximum(self.order - power - 1, 0) * c**power
        by_c = power * (-s) ** (self.order - power) * c ** np.maximum(power - 1, 0)
        return shape, by_s * c - by_c * s

    def improve(self, azimuth: Array) -> tuple[Array, Array, Array]:
        """Fit the coefficients (order + 1, R) of every row, and return them with the residuals; update the weights.

        The residuals (V, R) come with their derivatives by the angle.
        """
        shape, by_angle = self.basis(azimuth)
        normal = np.einsum("vr,vi,vj->rij", self.weight, shape, shape) + 1e-9 * np.eye(self.order + 1)
        own = np.linalg.solve(normal, np.einsum("vr,vi,vr->ri", self.weight, shape, self.value)[..., None])[..., 0].T
        off = self.value - shape @ own
        self.scatter = max(MAD * float(np.median(np.abs(off[self.known]))), 1e-3)
        self.weight = self.known / (1.0 + (off / (2.0 * self.scatter)) ** 2)
        return own, off, by_angle @ own


def find_turn(moments: Array, mass: Array, start: Array) -> tuple[Array, Array, Array, float]:
    """Estimate azimuths (V,), their standard deviations, each row's centre of mass (2, R), px, and the scatter, px.

    The estimate uses the rows' first and second moments. Azimuths and moments are improved alternately, first with
    equal steps of any size, then with a free angle per view. The second moments contribute where a view looks along the
    line from the axis to the centres of mass.
    """
    shown = np.median(mass, axis=0) > 1.0
    if shown.sum() < ROWS_TOGETHER * 4:
        raise UserError("the canister is almost empty in the pictures, so that the table angles cannot be determined")
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
                    f"the roots rotate by {100.0 * steps:.0f} % of the commanded steps: the table slips or does not move, "
                    "or the plan has another number of views per turn"
                )
            off = azimuth - ideal
            azimuth = azimuth + (gradient - off / table_sigma**2) / (curvature + table_sigma**-2)
            # Estimate how uneven the table is by expectation maximisation: from each angle's deviation and its
            # variance.
            sigma = 1.0 / np.sqrt(curvature + table_sigma**-2)
            table_sigma = max(float(np.sqrt(np.mean(off**2 + sigma**2))), LEAST_ANGLE_SIGMA_RAD)
    everywhere = np.zeros((2, mass.shape[1]))
    everywhere[:, shown] = points
    turned = frames.rotation_z(-float(azimuth[0]))[:2, :2]
    return azimuth - azimuth[0], sigma, turned @ everywhere, orders[0].scatter


def find_lift(mass: Array, nearer: Array) -> tuple[Array, Array, float]:
    """Estimate the vertical shift of each view (V,), in rows, with standard deviations, and the elevation (rad).

    The estimate uses the rows' masses.

    ``nearer`` (V, R) is the distance in pixels of a row's centre of mass in front of the axis. A point nearer by n
    appears lower by elevation * n, so that the mass of a row changes by the outflow d(mass * nearer) / d row per unit
    of elevation.
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
