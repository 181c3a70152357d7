"""Estimation of table angles from the coverage of the rows of telecentric pictures (see `bare_canister`)."""

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
"""Coverage below which a pixel does not contribute to the moments of its row. Lower values are noise, compression
artefacts, and dirt on the panel."""
TENSOR_PX = 2.0
"""Standard deviation of the Gaussian window of the structure tensor, from which the direction of a root is determined,
px. The window includes both sides of a root, but not neighbouring roots."""
ANGLE_SIGMA_RAD = np.deg2rad(1.5)
"""Initial value of the standard deviation by which table angles deviate from equal steps, rad. A real table with 72
steps had a standard deviation of 0.8 degrees."""
LEAST_ANGLE_SIGMA_RAD = np.deg2rad(0.01)
"""Lower limit of the estimated standard deviation of the table angles, rad. The value is about a tenth of a microstep
of a stepper motor with 200 steps per turn and 16 microsteps per step."""
SHIFT_SIGMA_PX = 1.0
"""Initial standard deviation of the canister's vertical displacement between views, px."""
LEAST_SHIFT_PX = 0.02
"""Lower limit of the estimated standard deviation of the canister's vertical displacement between views, px. Edges in a
picture cannot be located more precisely."""
ROWS_TOGETHER = 8.0
"""Number of neighbouring rows whose errors are correlated because they cut the same root. Together, they have the
weight of one independent row."""
STEPS_AGREE = 0.15
"""Tolerance for the total rotation of the table, as a fraction of the commanded rotation. A real table deviated by 0.01
to 0.02. A deviation of one view in six or more indicates a plan with the wrong number of views."""
_ROUNDS = 200
"""Number of iterations in which the table angles are improved. During the first quarter of the iterations, only a
common scale factor for all table angles is estimated."""


def row_moments(stack: Stack, bare: NDArray[np.float32], edges: Edges) -> tuple[Array, Array]:
    """Return the mass (V, R), px, and the first two moments (2, V, R) of the coverage of each row.

    The mass is the sum of the coverage over a row. The first moment is the centre of mass, px, and the second moment is
    the mean square, px^2, both measured from the canister's axis.
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
    """Return the cosine (R, C) of the angle between roots and the vertical in a picture, from the structure tensor.

    A row cuts an opaque root of diameter d over the length d / cos(angle), and the angle changes from view to view.
    Multiplied by the cosine, the length is d in every view.
    """
    across, down = (cv2.Sobel(covered, cv2.CV_32F, dx, 1 - dx) for dx in (1, 0))
    horizontal, vertical = (cv2.GaussianBlur(part * part, (0, 0), TENSOR_PX) for part in (across, down))
    return np.asarray(np.sqrt(horizontal / np.maximum(horizontal + vertical, 1e-9)), np.float32)


@dataclass
class _Moment:
    """Moments of one order of all rows, and the model of their variation over the turn."""

    order: int
    """Order of the moment, 1 or 2."""
    value: Array
    """(V, R) measured moments."""
    known: NDArray[np.bool_]
    """(V, R) whether a row has enough coverage for its moment to be used."""
    weight: Array
    """(V, R) robust weights of the moments."""
    scatter: float = 1.0
    """Robust standard deviation of the residuals."""

    def basis(self, azimuth: Array) -> tuple[Array, Array]:
        """Return the basis functions (V, order + 1) of the moment at each azimuth, and their derivatives.

        The moment is (-X sin + Y cos)^order of the azimuth, which is a sum of the sine, the cosine and, for the second
        order, the constant. The derivatives are with respect to the azimuth.
        """
        angle = self.order * azimuth[:, None]
        shape = np.hstack([-np.sin(angle), np.cos(angle), np.ones_like(angle)])
        by_angle = self.order * np.hstack([-np.cos(angle), -np.sin(angle), np.zeros_like(angle)])
        return shape[:, : self.order + 1], by_angle[:, : self.order + 1]

    def improve(self, azimuth: Array) -> tuple[Array, Array, Array]:
        """Fit the coefficients of each row, and update the weights.

        Return the coefficients (order + 1, R), the residuals (V, R), and the derivatives (V, R) of the model with
        respect to the azimuth.
        """
        shape, by_angle = self.basis(azimuth)
        normal = np.einsum("vr,vi,vj->rij", self.weight, shape, shape) + 1e-9 * np.eye(self.order + 1)
        own = np.linalg.solve(normal, np.einsum("vr,vi,vr->ri", self.weight, shape, self.value)[..., None])[..., 0].T
        off = self.value - shape @ own
        self.scatter = max(MAD * float(np.median(np.abs(off[self.known]))), 1e-3)
        self.weight = self.known / (1.0 + (off / (2.0 * self.scatter)) ** 2)
        return own, off, by_angle @ own


def find_turn(moments: Array, mass: Array, start: Array) -> tuple[Array, Array, Array, float]:
    """Estimate the table angles from the first and second moments of the rows.

    Angles and moments are improved alternately, first with equal steps of unknown size, then with an independent angle
    per view. The second moments contribute where the camera views the centres of mass along a line through the axis.

    Return the azimuths (V,), rad, their standard deviations (V,), rad, the centre of mass of each row (2, R), px, and
    the scatter of the centres, px.
    """
    shown = np.median(mass, axis=0) > 1.0
    if shown.sum() < ROWS_TOGETHER * 4:
        raise UserError("the canister is almost empty in the pictures, so the table angles cannot be determined")
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
                    f"the roots rotate by {100.0 * steps:.0f} % of the commanded table angles. The table slips or does not move, "
                    "or the plan in the scene has the wrong number of views per turn."
                )
            off = azimuth - ideal
            azimuth = azimuth + (gradient - off / table_sigma**2) / (curvature + table_sigma**-2)
            # Expectation maximisation: estimate the table's unevenness from the deviation and variance of each angle.
            sigma = 1.0 / np.sqrt(curvature + table_sigma**-2)
            table_sigma = max(float(np.sqrt(np.mean(off**2 + sigma**2))), LEAST_ANGLE_SIGMA_RAD)
    everywhere = np.zeros((2, mass.shape[1]))
    everywhere[:, shown] = points
    turned = frames.rotation_z(-float(azimuth[0]))[:2, :2]
    return azimuth - azimuth[0], sigma, turned @ everywhere, orders[0].scatter


def find_lift(mass: Array, nearer: Array) -> tuple[Array, Array, float]:
    """Estimate the vertical shift of each view and the elevation of the camera from the masses of the rows.

    Return the shifts (V,), px, their standard deviations (V,), px, and the elevation, rad.

    ``nearer`` (V, R) is the distance of a row's centre of mass in front of the axis, px. A point that is nearer by n
    appears lower by elevation * n. The mass of a row therefore changes by the outflow d(mass * nearer) / d row per unit
    of elevation.
    """
    views, rows = mass.shape
    typical = np.median(mass, axis=0)
    slope, row = np.gradient(typical), np.arange(rows, dtype=np.float64)
    lower = np.gradient(typical * nearer, axis=1)
    unknown, left = np.zeros(views + 1), np.zeros(views)
    sigma_px = SHIFT_SIGMA_PX
    for _ in range(10):
        prior = np.append(np.full(views, sigma_px**-2.0), 1e-6)
        off = np.array([np.interp(row + shift, row, own) for shift, own in zip(unknown[:-1], mass, strict=True)]) - typical
        off += unknown[-1] * lower
        scatter = MAD * np.median(np.abs(off), axis=1, keepdims=True) + 1e-9
        weight = 1.0 / (1.0 + (off / (2.0 * scatter)) ** 2) / (ROWS_TOGETHER * scatter**2)
        normal = np.diag(np.append((weight * slope**2).sum(axis=1), (weight * lower**2).sum()) + prior)
        normal[:-1, -1] = normal[-1, :-1] = (weight * slope * lower).sum(axis=1)
        unknown -= np.linalg.solve(normal, np.append((weight * slope * off).sum(axis=1), (weight * lower * off).sum()) + prior * unknown)
        left = np.diag(np.linalg.inv(normal))[:-1]
        sigma_px = max(float(np.sqrt(np.mean(unknown[:-1] ** 2 + left))), LEAST_SHIFT_PX)
    return unknown[:-1], np.sqrt(left), float(unknown[-1])
