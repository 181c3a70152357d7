"""Gauss-Newton fit of tubes to the coverage of all views, with a smoothness prior for branches.

The gradient of each node is computed separately, also where tubes hide each other. The normal equations of the nodes
are then independent, except for the smoothness along a branch. The tubes are rendered again in every iteration, so that
the iterations converge to a common solution.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from rhizotwin.recon import passes
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.light import Light
from rhizotwin.recon.device import release
from rhizotwin.recon.tubes import root_light, tube_profiles
from rhizotwin.recon.tubes.root_light import LEAST_LONE, LightSystem, Prior
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.recon.tubes.tube_profiles import ResidualGradient
from rhizotwin.recon.tubes.tubes import Tubes, with_geometry

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STEPS = 8
"""Number of iterations of a complete fit. Each iteration applies the fraction `_RELAXED` of a radius's step, so that
the error of a radius decreases to 0.4^8, less than a thousandth."""
_BEND = 2.0
"""Weight of the squared second differences of node positions in the smoothness prior, 1/mm2. For comparison, the
profile of a fully visible node in one view has a weight of about 10/mm2."""
_SUPPLE_MM = 0.34
"""Radius of a root for which the weight of the bending is twice `_BEND`, mm.

With a constant weight, nodes of a wide tube would follow irregularities of its flanks over distances shorter than its
radius. The weight therefore increases with the fourth power of the radius, like the stiffness of a beam. Nodes with
data of 1600/mm2 (80 views of 4 px/mm) are smoothed over a third of their radius."""
_TAPER = 12.0
"""Weight of the squared relative differences between the radii of adjacent nodes in the smoothness prior. It makes the
radius nearly constant over more than a centimetre.

With a smaller weight, roots in dense clusters became alternately thick and thin from node to node, and too thick on
average, since the radius of a hidden root has no lower bound."""
_DAMPING, _ALONG = 0.05, 0.5
"""Terms added to each node's 3x3 normal matrix for its position, as fractions of the mean diagonal. The first is added
in all directions, the second along the branch."""
_RELAXED = 0.6
"""Fraction of the Gauss-Newton step of a radius that is applied. Tubes that cover the same pixels respond
simultaneously, so that with full steps they would oscillate between too wide and too thin."""
LEAST = 0.5
"""Minimum curvature of the sum of squares with respect to a node's position, 1/mm2. Nodes that no view shows are
therefore not moved."""
_LARGEST_STEP_MM = 0.15
"""Maximum displacement of a node per iteration, mm. It is about the radius of a thin root. At larger distances, the
profiles contain no information about the root."""
_MOST_SHARE, _MOST_MM = 0.3, 0.01
"""Limits of the change of a radius per iteration: a fraction of the radius, plus a constant in mm. Within these limits,
the profile is nearly linear in the radius."""
_THINNEST_MM = 0.02
"""Minimum radius of a tube, mm. Its width is a fifth of a pixel at 0.2 mm per pixel."""
_STRETCH_NODES = 21
"""Number of nodes over which a root has approximately the same thickness: 12.6 mm at a spacing of 0.6 mm."""
_BULGE = 1.12
"""Maximum ratio of a radius to the median radius of the surrounding nodes, and of the median to the radius. A larger
radius would be due to another root beside the root."""


@dataclass(frozen=True)
class Fit:
    """Fitted tubes, with the residuals of the last iteration."""

    evidence: Evidence
    """Measured coverage of all views, with the fitted light parameters."""
    tubes: Tubes
    residual: ResidualGradient
    light: LightSystem | None
    """Normal equations of the light parameters. None if these were not fitted."""
    prior: Prior | None
    """Prior of the light parameters. None if these were not fitted."""
    few: bool
    """Whether too few profiles show a root that no other root hides or overlaps. In that case only the blur was fitted,
    to all profiles."""

    @cached_property
    def rendering(self) -> Rendering:
        """Rendering of the fitted tubes."""
        return Rendering.draw(self.evidence, self.tubes)


def fit(evidence: Evidence, tubes: Tubes, thick: Mask, *, steps: int = STEPS, light: Prior | None = None) -> Fit:
    """Fit the positions and radii of the nodes, and the light parameters, to the pictures.

    Parameters
    ----------
    thick : (N,) bool array
        Mask of the nodes of thick roots, both of whose flanks are visible. Their radii are not smoothed and do not
        constrain the light parameters.
    light : Prior, optional
        Prior of attenuation, blur and hairs, which are then fitted with the tubes. By default, these parameters are
        fixed.
    """
    system, few = None, False
    for _ in range(steps):
        passes.add("gauss_newton_steps")
        drawn, smooth, change = Rendering.draw(evidence, tubes), prior(tubes), None
        profiles = tube_profiles.profiles(drawn, None if light is None else root_light.changes(drawn, light.evaluated), every=few)
        residual = profiles.residual_gradient()
        if light is not None:
            equations = profiles.light_equations()
            system = LightSystem.build(equations, profiles, tubes, smooth, thick)
            if not few and system.lone < LEAST_LONE:
                few, light = True, light.blur_only()
            else:
                now = evidence.light.vector
                step = system.step(now, light)
                evidence, change = replace(evidence, light=Light.from_vector(now + step)), equations.by_light @ step
        tubes = _step(tubes, residual, smooth, change)
        tubes = with_geometry(tubes, tubes.centre_mm, _limit_radii(tubes, thick))
    release()  # kernels of other trees have other sizes
    return Fit(evidence, tubes, residual, system, light, few)


def _step(tubes: Tubes, residual: ResidualGradient, prior: sparse.csr_matrix, change: Array | None) -> Tubes:
    """Apply one damped Gauss-Newton step to the nodes.

    If the light parameters change at the same time, ``change`` (N, 4) is the resulting change of the nodes' gradient,
    and the nodes follow it. It is None if the light parameters are fixed.
    """
    count, tangent = len(tubes.radius_mm), tubes.tangents
    hessian = residual.hessian.copy()
    mean = np.trace(hessian[:, :3, :3], axis1=1, axis2=2)[:, None, None] / 3.0
    hessian[:, :3, :3] += (_DAMPING * mean + LEAST) * np.eye(3) + _ALONG * mean * tangent[:, :, None] * tangent[:, None, :]
    hessian[:, 3, 3] += LEAST
    flanks = flank_motion(tubes)
    state = np.concatenate([tubes.centre_mm, tubes.radius_mm[:, None]], axis=1).ravel()
    wanted = flanks.T @ residual.gradient.ravel() - prior @ state
    right = np.stack([wanted, np.zeros_like(wanted) if change is None else flanks.T @ change.ravel()], axis=1)
    step, follow = _solve(hessian, flanks, prior, right).T.reshape(2, count, 4)
    step[:, 3] *= _RELAXED
    step = step - follow
    way = np.linalg.norm(step[:, :3], axis=1, keepdims=True)
    centre = tubes.centre_mm + step[:, :3] * np.minimum(1.0, _LARGEST_STEP_MM / np.maximum(way, 1e-12))
    most = _MOST_SHARE * tubes.radius_mm + _MOST_MM
    radius = np.maximum(tubes.radius_mm + np.clip(step[:, 3], -most, most), _THINNEST_MM)
    return with_geometry(tubes, centre, radius)


def node_response(tubes: Tubes, hessian: Array, by_light: Array) -> Array:
    """Return the derivatives (N, 4, L) of the nodes with respect to the light parameters.

    The nodes are displaced so that the rendered tubes change as little as possible.

    Parameters
    ----------
    hessian, by_light : (N, 4, 4), (N, 4, L) array
        Field ``hessian`` of `ResidualGradient`, and field ``by_light`` of `LightEquations`.
    """
    flanks = flank_motion(tubes)
    solved = _solve(hessian + LEAST * np.eye(4), flanks, prior(tubes), flanks.T @ by_light.reshape(-1, by_light.shape[2]))
    return -solved.reshape(by_light.shape)


def _solve(hessian: Array, flanks: sparse.csr_matrix, prior: sparse.csr_matrix, right: Array) -> Array:
    """Solve the normal equations of all nodes for several right-hand sides (4 N, K).

    ``hessian`` (N, 4, 4) contains the normal matrices with respect to the flanks beside each node.
    """
    count = len(hessian)
    blocks = sparse.bsr_matrix((hessian, np.arange(count), np.arange(count + 1)), shape=(4 * count, 4 * count))
    return np.asarray(splu((flanks.T @ blocks @ flanks + prior).tocsc(), permc_spec="MMD_AT_PLUS_A").solve(right))


def flank_motion(tubes: Tubes) -> sparse.csr_matrix:
    """Return the matrix (4 N, 4 N) that converts displacements of nodes to those of the flanks beside them.

    If a branch turns, the flanks beside a node also move along the branch. Where the radius r changes along the branch,
    this displaces them sideways by r dr/ds times the angle, s being the distance along the branch. The centre line of a
    ball can therefore turn about its middle without any change in the pictures.

    Returns
    -------
    (4 N, 4 N) csr_matrix
        Each node has three coordinates and a radius, mm; radii are not affected.
    """
    count, neighbours = len(tubes.radius_mm), tubes.neighbours
    beside = tubes.radius_mm[neighbours]
    child = np.array([nodes[1] for nodes in tubes.branches[1:]], np.int64)
    beside[child, 0] = tubes.radius_mm[child]  # the first node of a branch has its parent's radius
    chord = np.maximum(np.linalg.norm(np.diff(tubes.centre_mm[neighbours], axis=1)[:, 0], axis=1), 1e-9)
    slope = np.clip(np.diff(beside, axis=1)[:, 0] / chord, -1.0, 1.0)  # steeper flanks are inside a neighbouring sphere
    aside = sparse.diags(tubes.radius_mm * slope / chord) @ _differences(neighbours, np.array([-1.0, 1.0]), count)
    return (sparse.identity(4 * count) + sparse.kron(aside, sparse.diags([1.0, 1.0, 1.0, 0.0]))).tocsr()


def _limit_radii(tubes: Tubes, thick: NDArray[np.bool_]) -> Array:
    """Return the radii (N,), limited to a range around the median radius of the surrounding nodes, mm.

    Thick roots may have swellings of any length.
    """
    typical = _median_radii(tubes)
    return np.where(thick, tubes.radius_mm, np.clip(tubes.radius_mm, typical / _BULGE, typical * _BULGE))


def _median_radii(tubes: Tubes) -> Array:
    """Return the median radius (N,) of the surrounding nodes on the same branch, mm."""
    line, first, last = tubes.flattened
    first = first + (first > 0)  # the first node of a branch has its parent's radius
    own = np.arange(len(line))
    own = own[own >= first]
    stretch = own[:, None] + np.arange(_STRETCH_NODES) - _STRETCH_NODES // 2
    typical = tubes.radius_mm.copy()
    typical[line[own]] = np.median(tubes.radius_mm[line[np.clip(stretch, first[own][:, None], last[own][:, None])]], axis=1)
    return typical


def prior(tubes: Tubes) -> sparse.csr_matrix:
    """Return the quadratic form (4 N, 4 N) of the smoothness prior.

    The prior penalises bending, and changes of the radius within a branch. Changes of the radius are relative to the
    typical radius of the surrounding nodes, so that a taproot may taper by the same fraction of its width as a lateral.
    """
    count = len(tubes.radius_mm)
    line, first, last = tubes.flattened
    place = np.arange(len(line))
    middle = np.flatnonzero((first < place) & (place < last))
    triples = np.stack([line[middle - 1], line[middle], line[middle + 1]], axis=1)
    second = np.flatnonzero(place > first + (first > 0))  # the first node of a branch has its parent's radius
    neighbours = np.stack([line[second - 1], line[second]], axis=1)
    bend = _differences(triples, np.array([1.0, -2.0, 1.0]), count)
    beam = (tubes.radius_mm[triples].min(axis=1) / _SUPPLE_MM) ** 4
    beam[(middle == first[middle] + 1) & (first[middle] > 0)] = 0.0  # a branch is hinged to its parent
    stiff = sparse.diags(_BEND * (1.0 + beam))
    taper = _differences(neighbours, np.array([-1.0, 1.0]), count)
    typical = _median_radii(tubes)
    taper = sparse.diags(typical[neighbours].prod(axis=1) ** -0.5) @ taper
    position, radius = sparse.diags([1.0, 1.0, 1.0, 0.0]), sparse.diags([0.0, 0.0, 0.0, 1.0])
    return (sparse.kron(bend.T @ stiff @ bend, position) + sparse.kron(_TAPER * taper.T @ taper, radius)).tocsr()


def _differences(nodes: NDArray[np.int64], weights: Array, count: int) -> sparse.csr_matrix:
    """Return a sparse matrix (R, N) that computes weighted sums of nodes.

    Row r adds the nodes in row r of ``nodes``, multiplied by ``weights``. N is ``count``.
    """
    rows = np.repeat(np.arange(len(nodes)), nodes.shape[1])
    return sparse.coo_matrix((np.tile(weights, len(nodes)), (rows, nodes.ravel())), shape=(len(nodes), count)).tocsr()
