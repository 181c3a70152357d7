"""Position of root tips in a short scan, fitted to its pictures from the roots of a full scan.

Within hours, roots move only near their tips, so that the tree of the preceding scan is known. Its nodes are fitted to
the coverage of the new scan with fixed radii (`recon.tubes.tube_fit`). The last nodes of a root, beyond whose end the
pictures show nothing, are not determined by profiles across the root. They continue the root straight, and the tip is
fitted to the pixels around it with three parameters: the extension of the root, and two displacements to the side that
bend its last segments. The fit is a Gauss-Newton iteration with derivatives from finite differences, and with Huber
weights (Huber 1964, Annals of Mathematical Statistics 35:73). All roots are rendered, so that they may hide each other.
The rendering is blurred: with sharp edges, the error of a tip depends on the fraction of a pixel by which it has moved.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections.lines import Line
from rhizotwin.corrections.refit import as_tubes
from rhizotwin.recon.calibration.curve import verify_curve
from rhizotwin.recon.calibration.find_cameras import find_cameras
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.measure import measure_coverage
from rhizotwin.recon.device import tuned_process
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.read_pictures import read_pictures
from rhizotwin.recon.results import result_traits
from rhizotwin.recon.tubes import tube_fit, tube_picture, tubes
from rhizotwin.recon.tubes.tubes import TANGENT_NODES, Tubes
from rhizotwin.scenes import polyline
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.rsml import Root
from rhizotwin.stored import result_files

Array = NDArray[np.float64]

WINDOW_MM = 2.0
"""Half the edge length of the window of pixels around a tip to which it is fitted, mm. It contains the segments that
bend."""
STRAIGHT_NODES = 2
"""Number of nodes at the end of a root whose position is extrapolated after the fit of all nodes."""
FIRST_ROUNDS, ROUNDS, STEPS, TIP_STEPS = 3, 1, 4, 10
"""Number of fits of all nodes and tips to the first scan after a full scan and to later scans, and numbers of
Gauss-Newton steps of both. The radii of the full scan are smoothed, which displaces tips by up to 0.2 mm at first."""
DELTA_MM, MOST_STEP_MM, STILL_MM = 0.03, 0.2, 0.003
"""Displacement for finite differences (a ninth of a pixel), maximum displacement of a tip per step, and displacement
below which all tips have converged, mm."""
BLUR_PX = 0.5
"""Standard deviation of the blur of the rendering, px. In scans of a twin over eight hours, the error of tips had a
standard deviation of 18, 14, 11 and 10 um with 0, 0.3, 0.5 and 0.7 px, and a mean of -27, 3, 33 and 52 um."""
HUBER, LEAST_SCALE = 2.0, 0.02
"""Residual beyond which the weight of a pixel falls, as a multiple of the typical residual, and minimum typical
residual, as coverage. It is the noise of a picture of the bench."""
LEAST_EXPLAINED, MOST_SIGMA_MM, SETTLED_MM = 0.7, 0.1, 0.03
"""Limits beyond which a tip is not seen: minimum share of the squared coverage around it that the roots explain,
maximum standard deviation of its position from the noise, and maximum last step. Tips of the twin explain above 0.9,
with 0.01 mm."""
BENT_MM = 5.0
"""Length behind the tip in which its direction and curvature are measured, mm. It is about that of the growth zone, and
has nine nodes."""
_ENDS = 8, 3
"""Numbers of nodes at the end of a root. The radius of the last ones, which pictures hardly determine, is the median of
that of the preceding ones."""


@dataclass(frozen=True, kw_only=True)
class Tip:
    """Tip of a root in one scan."""

    tip_mm: Array
    """Position (3,), canister frame, mm."""
    direction: Array
    """Unit vector (3,) of the growth direction."""
    curvature_per_mm: float
    """Curvature of the end of the root, 1/mm."""
    length_mm: float
    """Length of the root, mm."""

    @property
    def angle_deg(self) -> float:
        """Angle between the growth direction and straight down, deg."""
        return float(np.rad2deg(np.arccos(np.clip(-self.direction[2], -1.0, 1.0))))


def tip_of(points_mm: Array) -> Tip:
    """Return the tip of a root with the given centre line (N, 3).

    Direction and curvature are those of a parabola through the last `BENT_MM`.
    """
    way = polyline.arc_length_mm(points_mm)
    at = np.linspace(max(way[-1] - BENT_MM, 0.0), way[-1], 11)
    behind = at - way[-1]
    fitted = np.polynomial.polynomial.polyfit(behind, polyline.interpolate(points_mm, way, at), 2)
    speed = float(np.linalg.norm(fitted[1]))
    direction = fitted[1] / max(speed, 1e-12)
    turn = 2.0 * (fitted[2] - (fitted[2] @ direction) * direction)
    return Tip(
        tip_mm=points_mm[-1],
        direction=direction,
        curvature_per_mm=float(np.linalg.norm(turn)) / max(speed**2, 1e-12),
        length_mm=float(way[-1]),
    )


class TipFitter:
    """Fit of the root tips of a plant to successive short scans.

    Parameters
    ----------
    result_folder : Path
        Result of the full scan.
    roots : sequence of Root
        Its roots.

    Raises
    ------
    UserError
        If the roots are translucent.
    """

    def __init__(self, result_folder: Path, roots: tuple[Root, ...]) -> None:
        summary = result_files.read_summary(result_folder)
        if summary.get("root_mu_per_mm") is not None:
            raise UserError(f"{result_folder}: the roots are translucent; the motion of tips is measured for opaque roots only")
        self._n_water = (summary.get("rig") or {}).get("n_water")
        self._thick_mm = result_traits.THICK_CELLS * result_files.finest_mm(summary)
        lines = {number: Line(root.points_mm, root.diameters_mm, root.parent, ()) for number, root in enumerate(roots)}
        tree, _, self._numbers = as_tubes(lines, self._thick_mm)
        self._tree = tubes.with_geometry(tree, tree.centre_mm, _even_ends(tree))
        self._rounds = FIRST_ROUNDS
        self.px_mm = 0.0
        """Size of a pixel at the roots in the last scan, mm. It is 0 before the first."""

    @tuned_process()
    def fit(self, dataset: Dataset) -> dict[int, Tip]:
        """Fit the tips to the pictures of a scan, which follows those of earlier calls.

        Returns
        -------
        dict of Tip
            Tips that the pictures show, keyed by the number of the root.

        Raises
        ------
        UserError
            If the pictures cannot be used.
        """
        evidence = self._read(dataset)
        self.px_mm = 1.0 / projection.px_a_mm(evidence.bank, self._tree.centre_mm.mean(axis=0))
        seen = np.zeros(len(self._numbers), bool)
        for _ in range(self._rounds):
            tree = tubes.fill_gaps(self._tree)
            fitted = tube_fit.fit(evidence, tree, tree.radius_mm > self._thick_mm, steps=STEPS).tubes
            centre = np.where((tree.radius_mm > self._thick_mm)[:, None], tree.centre_mm, fitted.centre_mm)
            self._tree, seen = fit_tips(evidence, _straighten(tubes.with_geometry(tree, centre, tree.radius_mm)))
        self._rounds = ROUNDS
        lines = [self._tree.centre_mm[nodes] for nodes in self._tree.branches]
        return {number: tip_of(line) for number, line, is_seen in zip(self._numbers, lines, seen, strict=True) if is_seen}

    def _read(self, dataset: Dataset) -> Evidence:
        """Measure the coverage of the pictures, with the refractive index of water of the full scan."""
        monitor = Monitor.of(None)
        pictures = verify_curve(read_pictures(dataset, monitor=monitor), monitor=monitor)
        cameras, coverage = measure_coverage(pictures, find_cameras(pictures, monitor=monitor), monitor=monitor)
        optics = replace(cameras.optics, n_water=self._n_water or cameras.optics.n_water)
        return Evidence.from_silhouettes(ViewBank.pack(cameras.views, optics), [coverage.silhouettes[k] for k in cameras.order])


def fit_tips(evidence: Evidence, tree: Tubes) -> tuple[Tubes, NDArray[np.bool_]]:
    """Fit the positions of all tips to the pixels around them.

    Returns
    -------
    Tubes
        Tree with fitted tips.
    (T,) bool array
        Whether the pictures show the tip of each branch.
    """
    width, height = evidence.image_wh
    shape = evidence.bank.count, height, width
    measured, usable = (np.array(picture, np.float32).reshape(shape) for picture in (evidence.opacity, evidence.usable))
    evidence = replace(evidence, light=replace(evidence.light, blur_px=float(np.hypot(evidence.light.blur_px, BLUR_PX))))
    for _ in range(TIP_STEPS):
        windows = _Windows.around(evidence, tree, usable)
        drawn = _render(evidence, tree)
        residual = windows.cut(measured - drawn)
        changes = [windows.cut(_render(evidence, _move(tree, DELTA_MM * np.eye(3)[axis])) - drawn) / DELTA_MM for axis in range(3)]
        slope = np.stack(changes, axis=-1)
        shows = np.abs(slope).sum(axis=-1) > LEAST_SCALE
        scale = np.array([1.4826 * np.median(np.abs(own[here])) if here.any() else 1.0 for own, here in zip(residual, shows, strict=True)])
        scale = np.maximum(scale, LEAST_SCALE)
        weight = 1.0 / np.maximum(1.0, np.abs(residual) / (HUBER * scale[:, None]))
        normal = np.einsum("tpi,tpj,tp->tij", slope, slope, weight) + 1e-6 * np.eye(3)
        step = np.linalg.solve(normal, np.einsum("tpi,tp,tp->ti", slope, residual, weight)[..., None])[..., 0]
        way = np.linalg.norm(step, axis=1)
        tree = _move(tree, step * np.minimum(1.0, MOST_STEP_MM / np.maximum(way, 1e-12))[:, None])
        if way.max() < STILL_MM:
            break
    sigma = scale * np.sqrt(np.linalg.inv(normal).trace(axis1=1, axis2=2))
    there = windows.cut(measured)
    explained = 1.0 - (weight * residual**2).sum(axis=1) / np.maximum((weight * there**2).sum(axis=1), 1e-9)
    return tree, (way < SETTLED_MM) & (sigma < MOST_SIGMA_MM) & (explained > LEAST_EXPLAINED)


@dataclass(frozen=True)
class _Windows:
    """Square windows of pixels around the tips in all views."""

    view: NDArray[np.int64]
    row: NDArray[np.int64]
    column: NDArray[np.int64]
    """View, row and column (T, P) of each pixel."""
    usable: NDArray[np.bool_]
    """Whether each pixel is usable and shows the surroundings of the tip, (T, P)."""

    @staticmethod
    def around(evidence: Evidence, tree: Tubes, usable: NDArray[np.float32]) -> _Windows:
        """Return the windows around the tips of a tree. ``usable`` (V, H, W) is 1 for usable pixels."""
        reach = int(np.ceil(WINDOW_MM * projection.px_a_mm(evidence.bank, tree.centre_mm.mean(axis=0))))
        at = evidence.project(tree.centre_mm[[nodes[-1] for nodes in tree.branches]])
        middle = np.rint(np.nan_to_num(at.px)).astype(np.int64)  # (V, T, 2)
        rows, columns = (side.ravel() for side in np.mgrid[-reach : reach + 1, -reach : reach + 1])
        row, column = middle[..., 1, None] + rows, middle[..., 0, None] + columns
        inside = (row >= 0) & (row < usable.shape[1]) & (column >= 0) & (column < usable.shape[2]) & at.visible[..., None]
        row, column = np.where(inside, row, 0), np.where(inside, column, 0)
        view = np.broadcast_to(np.arange(len(middle))[:, None, None], row.shape)
        inside &= usable[view, row, column] > 0.5
        view, row, column = (np.moveaxis(part, 0, 1).reshape(middle.shape[1], -1) for part in (view, row, column))
        return _Windows(view, row, column, np.moveaxis(inside, 0, 1).reshape(middle.shape[1], -1))

    def cut(self, pictures: NDArray[np.float32]) -> Array:
        """Return the pixels (T, P) of pictures (V, H, W) in the windows. Pixels that are not usable are 0."""
        return np.where(self.usable, pictures[self.view, self.row, self.column], 0.0).astype(np.float64)


def _render(evidence: Evidence, tree: Tubes) -> NDArray[np.float32]:
    """Return the coverage (V, H, W) by a tree."""
    width, height = evidence.image_wh
    passing = tube_picture.transmittance(evidence, tree, evidence.project(tree.centre_mm))
    return 1.0 - np.array(passing, np.float32).reshape(-1, height, width)


def _move(tree: Tubes, by_mm: Array) -> Tubes:
    """Displace each tip by a vector (3,) or (T, 3), mm.

    Along its axis, a root is lengthened or shortened from its last lateral on. To the side, the last `TANGENT_NODES`
    segments bend with uniform curvature.
    """
    centre = tree.centre_mm.copy()
    for nodes, end, by in zip(tree.branches, tree.ends, np.broadcast_to(by_mm, (len(tree.branches), 3)), strict=True):
        axis = polyline.unit_vectors(tree.centre_mm[nodes[-1]] - tree.centre_mm[nodes[max(len(nodes) - 1 - TANGENT_NODES, 0)]])
        line = tree.centre_mm[end]
        more_mm = float(by @ axis)
        along = polyline.arc_length_mm(line)
        if along[-1] > 0.0:
            longer = np.concatenate([line, line[-1:] + max(more_mm, 0.0) * axis])
            share = max(1.0 + more_mm / along[-1], 0.5)
            centre[end] = polyline.interpolate(longer, polyline.arc_length_mm(longer), along * share)
        bent = nodes[-TANGENT_NODES - 1 :]
        way = polyline.arc_length_mm(centre[bent])
        centre[bent] += (way / max(way[-1], 1e-12))[:, None] ** 2 * (by - more_mm * axis)
    return tubes.with_geometry(tree, centre, tree.radius_mm)


def _straighten(tree: Tubes) -> Tubes:
    """Return a tree in which the last `STRAIGHT_NODES` nodes of each branch continue the preceding ones."""
    centre = tree.centre_mm.copy()
    for nodes in tree.branches:
        last = len(nodes) - 1 - STRAIGHT_NODES
        if last > 0:
            axis = polyline.unit_vectors(centre[nodes[last]] - centre[nodes[max(last - TANGENT_NODES + 1, 0)]])
            way = polyline.arc_length_mm(centre[nodes[last:]])
            centre[nodes[last:]] = centre[nodes[last]] + way[:, None] * axis
    return tubes.with_geometry(tree, centre, tree.radius_mm)


def _even_ends(tree: Tubes) -> Array:
    """Return the radii (N,) of a tree, in which those of the ends of branches continue the preceding ones, mm."""
    radius, (many, few) = tree.radius_mm.copy(), _ENDS
    for k in range(len(tree.branches)):
        own = tree.own(k)
        before = own[-many - few : -few] if len(own) > few + 1 else own
        radius[own[-few:]] = np.median(tree.radius_mm[before])
    return radius
