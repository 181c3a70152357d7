"""Light parameters shared by all roots, as columns of the tubes' normal equations: attenuation, blur, hairs and index.

Tubes x (positions and radii of the nodes) and light parameters q (`tube_profiles.LIGHT`) are fitted together. A
Gauss-Newton step solves

    (H + P) dx + B dq = g - P x        every node, from all of its profiles, P being the prior of smooth branches
    C^T dx + D dq     = h              light, from lone profiles only: others would bias the shared parameters

Eliminating the nodes (Schur complement, one factorisation with as many more right-hand sides as there are columns),

    S dq = s,    S = D - C^T (H + P)^-1 B,    s = h - C^T (H + P)^-1 (g - P x),

and the nodes follow by dx = (H + P)^-1 (g - P x - B dq): radii move along the valley in which a wider, fainter root
looks the same. The covariance of q is the sandwich S^-1 M S^-T, where M is the scatter of the scores of whole roots and
whole views (`robust.scatter`); it determines the weight of the data relative to the prior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.translucency import FAINTEST_LEARNED
from rhizotwin.recon.robust import inverse, scatter
from rhizotwin.recon.tubes import translucent_tube
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.recon.tubes.tube_profiles import LIGHT, Changes, LightEquations, Profiles
from rhizotwin.recon.tubes.tubes import Tubes, with_geometry

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MU, BLUR, HAIRS, INDEX = range(len(LIGHT))
FAINTEST, DARKEST = 0.5, 8.0
"""Range of attenuation, 1/mm; roots above it count as opaque. Translucent roots of the twin have 1.0 to 2.2. Blurred
edges of opaque roots appeared as 9 to 16 (a bean, with a residual 1.09 times as large)."""
_MOST_BLUR_PX = 0.8
"""Maximum blur; a focused camera has less."""
_MOST_HAIRS = 4.0
"""Maximum strength of hairs: hairs four times as dark as those of radish absorb most of the light."""
_MOST_INDEX = 0.07
"""Maximum relative index: pure cell walls have 1.425 (Appl. Opt. 13:109), 1.069 times that of water."""
_BOUNDS = np.array([[np.log(FAINTEST), 0.0, 0.0, 0.0], [np.log(DARKEST), _MOST_BLUR_PX**2, _MOST_HAIRS, _MOST_INDEX]])
"""Lower and upper bound of each parameter in `LIGHT`."""
ROUNDING = 1e-9
"""Distance to a bound below which a value counts as at the bound: log(exp(x)) is not always x."""
_LARGEST_STEP = np.array([0.35, 0.06, 0.5, 0.01])
"""Maximum change per step, within which the slopes of the profiles are valid."""
LEARNED_SIGMA = 0.2
"""Standard deviation of the logarithm of the attenuation estimated from the widest roots: for roots of 1.0 per mm with
refraction and hairs, the estimates of three plants were 1.03, 1.03 and 1.18."""
_CHANGES, _WIDER = (0.01, 0.005, 0.02, 0.002), 0.005
"""Steps of the difference quotients with respect to light parameters and to the logarithm of the radii: pictures change
by less than a hundredth and are accurate to 1e-6."""
_RIDGE = 1e-4
"""Curvature, 1/mm2, that regularises nodes without a lone profile. A node's own curvature is about 100, of which a
thousandth remains along the valley in which it follows the light parameters."""
LEAST_VARIANCE = 1e-5
"""Minimum variance of coverage: 0.003 is one grey level of 8 bits."""
LEAST_LONE = 1500
"""Minimum number of profiles of lone roots to estimate attenuation and hairs; with fewer, only the blur is fitted, to
all profiles. An opaque print in 40 pictures of 400x300 has 1,140, of few roots, and an opaque model leaves a residual
1.15 times as large; translucent plants have 30,000 and more."""
HAIRY = 1.0, 0.5
"""Prior mean and standard deviation of the strength of hairs about translucent, that is young, roots: radish in water
has hairs of 0.1 to 0.5 mm, between half and one and a half times as dark as the mean."""

BENDING = 0.024, 0.012
"""Prior mean and standard deviation of the index: whole wet roots have 1.35 to 1.38, a relative excess over water of
0.013 to 0.035; no refraction is two standard deviations away."""


@dataclass(frozen=True)
class Prior:
    """Prior of the light parameters before the tubes are fitted."""

    mean: Array
    """(L,)"""
    sigma: Array
    """(L,) infinite where nothing is known."""
    free: Mask
    """(L,) parameters that are fitted."""

    @staticmethod
    def from_evidence(evidence: Evidence, learned_per_mm: float | None = None) -> Prior:
        """Return the prior from the evidence and its widest roots (`translucency.learn`).

        Silhouettes constrain the blur only; for opaque roots, hairs are evaluated but not fitted.
        """
        mean, sigma = np.array([0.0, 0.0, HAIRY[0], BENDING[0]]), np.full(len(LIGHT), np.inf)
        if evidence.has_opacity:
            sigma[HAIRS], sigma[INDEX] = HAIRY[1], BENDING[1]
        if learned_per_mm is not None and learned_per_mm > FAINTEST_LEARNED:
            mean[MU], sigma[MU] = np.log(learned_per_mm), LEARNED_SIGMA
        translucent = evidence.has_opacity and evidence.mu_per_mm is not None
        return Prior(mean, sigma, translucent | (np.arange(len(LIGHT)) == BLUR))

    @property
    def evaluated(self) -> Mask:
        """Return the parameters (L,) with derivatives: those that are fitted, and the hairs of opaque roots."""
        return self.free | (np.arange(len(LIGHT)) == HAIRS) & ~np.isinf(self.sigma)

    def blur_only(self) -> Prior:
        """Return the same prior with only the blur free."""
        return replace(self, free=self.free & (np.arange(len(LIGHT)) == BLUR))


def light_vector(evidence: Evidence) -> Array:
    """Return the light parameters (L,) of the evidence."""
    return np.array([np.log(evidence.mu_per_mm or DARKEST), evidence.blur_px**2, evidence.hairs, evidence.index - 1.0])


def with_light(evidence: Evidence, light: Array) -> Evidence:
    """Return the evidence with other light parameters (L,); opaque roots stay opaque."""
    mu_per_mm = None if evidence.mu_per_mm is None else float(np.exp(light[MU]))
    blur_px, hairs, index = float(np.sqrt(max(light[BLUR], 0.0))), float(light[HAIRS]), 1.0 + float(light[INDEX])
    return replace(evidence, mu_per_mm=mu_per_mm, blur_px=blur_px, hairs=hairs, index=index)


def match_absorption(fitted: Tubes, thick: Mask, before: Evidence, after: Evidence) -> Tubes:
    """Return tubes whose radii absorb the same light from the side with another attenuation and other hairs.

    Parameters
    ----------
    fitted : Tubes
        Tubes with radii that match ``before``.
    thick : (N,) bool array
        Mask of nodes whose radius is kept.
    """
    light = translucent_tube.opaque_radius(fitted.radius_mm, before.mu_per_mm, before.hairs, before.index)
    radius_mm = translucent_tube.equivalent_radius(light, after.mu_per_mm, after.hairs, after.index)
    return with_geometry(fitted, fitted.centre_mm, np.where(thick, fitted.radius_mm, radius_mm))


def changes(drawn: Rendering, free: Mask) -> Changes:
    """Return the derivatives of the pictures of tubes by their radii and by the free light parameters (L,)."""
    evidence, tubes, now = drawn.evidence, drawn.tubes, light_vector(drawn.evidence)
    wider = with_geometry(tubes, tubes.centre_mm, (1.0 + _WIDER) * tubes.radius_mm)
    more = {k: with_light(evidence, now + _CHANGES[k] * np.eye(len(now))[k]) for k in np.flatnonzero(free).tolist()}
    return Changes(drawn.change(evidence, wider, _WIDER), {k: drawn.change(other, tubes, _CHANGES[k]) for k, other in more.items()})


@dataclass(frozen=True)
class LightSystem:
    """Normal equations of the light parameters, with the nodes eliminated."""

    reduced: Array
    """S (L, L)."""
    right: Array
    """s (L,)."""
    meat: Array
    """M (L, L)."""
    lone: int
    """Number of profiles of lone roots."""

    @staticmethod
    def build(equations: LightEquations, profiles: Profiles, tubes: Tubes, smooth: sparse.csr_matrix, thick: Mask) -> LightSystem:
        """Eliminate the nodes.

        Parameters
        ----------
        equations, profiles : LightEquations, Profiles
            Residuals of the views, summed and one by one.
        smooth : (4 N, 4 N) sparse matrix
            Smoothness prior of the branches.
        thick : (N,) bool array
            Mask of nodes that are not fitted and do not contribute.
        """
        count, many = len(thick), len(LIGHT)
        joint = np.where(thick[:, None, None], 0.0, equations.lone)
        gradient = np.where(thick[:, None], 0.0, equations.gradient)
        nodes = joint[:, :4, :4] + _RIDGE * np.eye(4)
        blocks = sparse.bsr_matrix((nodes, np.arange(count), np.arange(count + 1)), shape=(4 * count, 4 * count))
        mixed = joint[:, :4, 4:].reshape(-1, many)
        back = splu((blocks + smooth).tocsc(), permc_spec="MMD_AT_PLUS_A").solve(mixed)
        state = np.concatenate([tubes.centre_mm, tubes.radius_mm[:, None]], axis=1).ravel()
        reduced = joint[:, 4:, 4:].sum(axis=0) - mixed.T @ back
        right = gradient[:, 4:].sum(axis=0) - back.T @ (gradient[:, :4].ravel() - smooth @ state)
        lone = profiles.is_lone & ~thick
        meat = _scatter(profiles, back.reshape(count, 4, many), lone, tubes)
        reduced = 0.5 * (reduced + reduced.T)
        return LightSystem(reduced, right, meat + LEAST_VARIANCE * reduced, int(lone.sum()))

    def step(self, light: Array, prior: Prior) -> Array:
        """Return the step (L,) of the light parameters, within bounds; 0 for fixed parameters."""
        return np.asarray(np.clip(light + self._solve(light, prior)[0], *_BOUNDS) - light)

    def covariance(self, light: Array, prior: Prior) -> Array:
        """Return the covariance (L, L) of the light parameters; 0 for those that are fixed or at a bound."""
        return self._solve(light, prior)[1]

    def estimate_without_prior(self, free: Mask) -> tuple[Array, Array]:
        """Return the step (L,) of the free parameters without the prior, and its standard deviation (L,)."""
        change, sigma, f = np.zeros(len(free)), np.full(len(free), np.inf), np.flatnonzero(free & (np.diag(self.reduced) > 0.0))
        bread = inverse(self.reduced[np.ix_(f, f)])
        change[f] = bread @ self.right[f]
        sigma[f] = np.sqrt(np.diag(bread @ self.meat[np.ix_(f, f)] @ bread))
        return change, sigma

    def _solve(self, light: Array, prior: Prior) -> tuple[Array, Array]:
        """Return the step (L,), limited in length and without parameters held at a bound, and the covariance (L, L)."""
        free, many = prior.free & (np.diag(self.reduced) > 0.0), len(light)
        while True:
            change, covariance, f = np.zeros(many), np.zeros((many, many)), np.flatnonzero(free)
            if not len(f):
                return change, covariance
            normal, known = self.reduced[np.ix_(f, f)], np.diag(prior.sigma[f] ** -2.0)
            information = normal @ inverse(self.meat[np.ix_(f, f)])  # times the normal matrix, this is the inverse of the sandwich
            covariance[np.ix_(f, f)] = found = inverse(information @ normal + known)
            change[f] = found @ (information @ self.right[f] + known @ (prior.mean - light)[f])
            change /= max(1.0, float((np.abs(change) / _LARGEST_STEP).max()))
            least, most = _BOUNDS + np.array([[ROUNDING], [-ROUNDING]])
            held = free & (((light <= least) & (change < 0.0)) | ((light >= most) & (change > 0.0)))
            if not held.any():
                return change, covariance
            free &= ~held


def _scatter(profiles: Profiles, back: Array, lone: Mask, tubes: Tubes) -> Array:
    """Return the covariance (L, L) of the gradient by the light parameters, from whole roots and whole views.

    Parameters
    ----------
    back : (N, 4, L) array
        Weights of the nodes' gradients after their elimination.
    lone : (V, N) bool array
        Mask of the profiles that contribute.
    """
    parts, light_profiles = profiles.host(), profiles.light
    if light_profiles is None:
        raise ValueError("these profiles have no derivatives by the light parameters")
    radius, *light = (np.array(part, np.float64).reshape(profiles.shape) for part in (light_profiles.radius, *light_profiles.light))
    (views, count), roots, many = profiles.shape, len(tubes.branches), back.shape[2]
    of_root = sparse.csr_matrix((np.ones(count), (tubes.owner, np.arange(count))), shape=(roots, count))
    scores = []
    for v in range(views):
        score = np.stack([part[v] for part in light], axis=-1)
        score -= np.einsum("ni,nij->nj", parts.across[v] * parts.shift[v, :, None], back[:, :3]) + radius[v, :, None] * back[:, 3]
        scores.append(of_root @ (score * lone[v, :, None]))
    by_root = np.stack(scores)
    share = np.stack([of_root @ one for one in lone]) / max(lone.sum(), 1)
    by_root -= share[..., None] * by_root.sum(axis=(0, 1))  # far from the solution, all scores share a common mean
    return scatter(by_root.reshape(-1, many), np.repeat(np.arange(views), roots), np.tile(np.arange(roots), views))
