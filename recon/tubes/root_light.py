"""What all roots share: attenuation, blur of the pictures, hairs and index, as columns of the tubes' normal equations.

Tubes x (positions and radii of the nodes) and light q (`tube_profiles.LIGHT`) are fitted together. A Gauss-Newton step
solves

    (H + P) dx + B dq = g - P x        every node, from all of its profiles, P being the prior of smooth branches
    C^T dx + D dq     = h              light, from lone profiles only: what stands on others biases what all share

Eliminating the nodes (Schur complement, one factorisation with as many more right-hand sides as there are columns),

    S dq = s,    S = D - C^T (H + P)^-1 B,    s = h - C^T (H + P)^-1 (g - P x),

and the nodes follow by dx = (H + P)^-1 (g - P x - B dq): radii go along the valley in which the wider, fainter root
looks the same. The covariance of q is the sandwich S^-1 M S^-T, M being the scatter of the scores of whole roots and
whole views (`robust.scatter`), with which what was known before is weighed.
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
from rhizotwin.recon.tubes.tubes import Tubes, moved

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MU, BLUR, HAIRS, INDEX = range(len(LIGHT))
FAINTEST, DARKEST = 0.5, 8.0
"""Attenuations, 1/mm, between which is sought; roots of more count as opaque. Those of the twin that let light through
have 1.0 to 2.2; blurred edges of opaque ones looked like 9 to 16 (a bean, which left 1.09 times as much)."""
_MOST_BLUR_PX = 0.8
"""A camera in focus blurs less."""
_MOST_HAIRS = 4.0
"""Hairs four times as dark as those of radish take most of the light."""
_MOST_INDEX = 0.07
"""Cell walls alone have 1.425 (Appl. Opt. 13:109), which is 1.069 times that of water."""
_BOUNDS = np.array([[np.log(FAINTEST), 0.0, 0.0, 0.0], [np.log(DARKEST), _MOST_BLUR_PX**2, _MOST_HAIRS, _MOST_INDEX]])
"""Least and largest value of each of `LIGHT`."""
ROUNDING = 1e-9
"""Nearer to a bound is at it: log(exp(x)) is not always x."""
_LARGEST_STEP = np.array([0.35, 0.06, 0.5, 0.01])
"""A step changes light by no more: within these the profiles' slopes tell the way."""
LEARNED_SIGMA = 0.2
"""Standard deviation of the logarithm of what the widest roots seemed to: of roots of 1.0 a mm that refract and have
hairs, three plants seemed to have 1.03, 1.03 and 1.18."""
_CHANGES, _WIDER = (0.01, 0.005, 0.02, 0.002), 0.005
"""Steps of the difference quotients by the light, and by the logarithm of the radii: pictures change by less than a
hundredth, and are known to 1e-6."""
_RIDGE = 1e-4
"""Curvature, 1/mm2, that holds nodes of which no lone profile tells. A node's own is some 100, of which a thousandth is
left along the valley in which it follows the light."""
LEAST_VARIANCE = 1e-5
"""Coverage is never known better than to 0.003, which is a grey level of 8 bits."""
LEAST_LONE = 1500
"""Profiles of lone roots; fewer tell no attenuation and no hairs, and every profile tells of the blur. An opaque print
in 40 pictures of 400x300 has 1,140, of few roots, of which opaque ones leave 1.15 times as much; translucent plants
have 30,000 and more."""
HAIRY = 1.0, 0.5
"""Mean and standard deviation of the hairs' strength about what lets light through, which is young: radish in water has
hairs of a tenth to half a millimetre, half or one and a half times as dark as those of the middle."""

BENDING = 0.024, 0.012
"""Mean and standard deviation of the index: whole wet roots have 1.35 to 1.38, 0.013 to 0.035 more than water over that
of water; those that refract not at all are two deviations away."""


@dataclass(frozen=True)
class Prior:
    """What is known of the light before tubes tell."""

    mean: Array
    """(L,)"""
    sigma: Array
    """(L,) infinite where nothing is known."""
    free: Mask
    """(L,) what is fitted."""

    @staticmethod
    def of(evidence: Evidence, learned_per_mm: float | None = None) -> Prior:
        """Return what pictures and their widest roots (`translucency.learn`) say.

        Silhouettes tell of blur alone; about opaque roots hairs are only possible.
        """
        mean, sigma = np.array([0.0, 0.0, HAIRY[0], BENDING[0]]), np.full(len(LIGHT), np.inf)
        if evidence.has_opacity:
            sigma[HAIRS], sigma[INDEX] = HAIRY[1], BENDING[1]
        if learned_per_mm is not None and learned_per_mm > FAINTEST_LEARNED:
            mean[MU], sigma[MU] = np.log(learned_per_mm), LEARNED_SIGMA
        translucent = evidence.has_opacity and evidence.mu_per_mm is not None
        return Prior(mean, sigma, translucent | (np.arange(len(LIGHT)) == BLUR))

    @property
    def seen(self) -> Mask:
        """What pictures are asked about (L,): hairs of opaque roots are not fitted, but may be told."""
        return self.free | (np.arange(len(LIGHT)) == HAIRS) & ~np.isinf(self.sigma)

    def of_blur(self) -> Prior:
        """Return the same with nothing but the blur to be fitted."""
        return replace(self, free=self.free & (np.arange(len(LIGHT)) == BLUR))


def light_of(evidence: Evidence) -> Array:
    """Return the light (L,) that evidence has."""
    return np.array([np.log(evidence.mu_per_mm or DARKEST), evidence.blur_px**2, evidence.hairs, evidence.index - 1.0])


def with_light(evidence: Evidence, light: Array) -> Evidence:
    """Return evidence with another light (L,); opaque roots stay opaque."""
    mu_per_mm = None if evidence.mu_per_mm is None else float(np.exp(light[MU]))
    blur_px, hairs, index = float(np.sqrt(max(light[BLUR], 0.0))), float(light[HAIRS]), 1.0 + float(light[INDEX])
    return replace(evidence, mu_per_mm=mu_per_mm, blur_px=blur_px, hairs=hairs, index=index)


def with_light_kept(fitted: Tubes, thick: Mask, before: Evidence, after: Evidence) -> Tubes:
    """Return tubes with the radii that absorb as much light from the side with another attenuation and other hairs.

    Parameters
    ----------
    fitted : Tubes
        With radii that belong to ``before``.
    thick : (N,) bool array
        Nodes whose radius stays.
    """
    light = translucent_tube.opaque_radius(fitted.radius_mm, before.mu_per_mm, before.hairs, before.index)
    radius_mm = translucent_tube.radius_of(light, after.mu_per_mm, after.hairs, after.index)
    return moved(fitted, fitted.centre_mm, np.where(thick, fitted.radius_mm, radius_mm))


def changes(drawn: Rendering, free: Mask) -> Changes:
    """Return how the pictures of tubes change with their radii and with the light that is free (L,)."""
    seen, tubes, now = drawn.evidence, drawn.tubes, light_of(drawn.evidence)
    wider = moved(tubes, tubes.centre_mm, (1.0 + _WIDER) * tubes.radius_mm)
    more = {k: with_light(seen, now + _CHANGES[k] * np.eye(len(now))[k]) for k in np.flatnonzero(free).tolist()}
    return Changes(drawn.change(seen, wider, _WIDER), {k: drawn.change(other, tubes, _CHANGES[k]) for k, other in more.items()})


@dataclass(frozen=True)
class LightSystem:
    """Normal equations of the light, the nodes eliminated."""

    reduced: Array
    """S (L, L)."""
    right: Array
    """s (L,)"""
    meat: Array
    """M (L, L)."""
    lone: int
    """Profiles of lone roots."""

    @staticmethod
    def of(equations: LightEquations, profiles: Profiles, tubes: Tubes, smooth: sparse.csr_matrix, thick: Mask) -> LightSystem:
        """Eliminate the nodes.

        Parameters
        ----------
        equations, profiles : LightEquations, Profiles
            What the views, together and one by one, say.
        smooth : (4 N, 4 N) sparse matrix
            Prior of smooth branches.
        thick : (N,) bool array
            Nodes that are not fitted: they tell nothing.
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
        """Return the step (L,) of the light, within bounds; 0 for what is not free."""
        return np.asarray(np.clip(light + self._solved(light, prior)[0], *_BOUNDS) - light)

    def covariance(self, light: Array, prior: Prior) -> Array:
        """Return the covariance (L, L) of the light; 0 for what is not free, or held by its bound."""
        return self._solved(light, prior)[1]

    def alone(self, free: Mask) -> tuple[Array, Array]:
        """Return the change (L,) that the pictures alone ask for of what is free, and its standard deviation (L,)."""
        change, sigma, f = np.zeros(len(free)), np.full(len(free), np.inf), np.flatnonzero(free & (np.diag(self.reduced) > 0.0))
        bread = inverse(self.reduced[np.ix_(f, f)])
        change[f] = bread @ self.right[f]
        sigma[f] = np.sqrt(np.diag(bread @ self.meat[np.ix_(f, f)] @ bread))
        return change, sigma

    def _solved(self, light: Array, prior: Prior) -> tuple[Array, Array]:
        """Return the step (L,) that is not too long, without what a bound holds, and the covariance (L, L)."""
        free, many = prior.free & (np.diag(self.reduced) > 0.0), len(light)
        while True:
            change, covariance, f = np.zeros(many), np.zeros((many, many)), np.flatnonzero(free)
            if not len(f):
                return change, covariance
            normal, known = self.reduced[np.ix_(f, f)], np.diag(prior.sigma[f] ** -2.0)
            told = normal @ inverse(self.meat[np.ix_(f, f)])  # times the normal matrix: the inverse of the sandwich
            covariance[np.ix_(f, f)] = found = inverse(told @ normal + known)
            change[f] = found @ (told @ self.right[f] + known @ (prior.mean - light)[f])
            change /= max(1.0, float((np.abs(change) / _LARGEST_STEP).max()))
            least, most = _BOUNDS + np.array([[ROUNDING], [-ROUNDING]])
            held = free & (((light <= least) & (change < 0.0)) | ((light >= most) & (change > 0.0)))
            if not held.any():
                return change, covariance
            free &= ~held


def _scatter(profiles: Profiles, back: Array, lone: Mask, tubes: Tubes) -> Array:
    """Return the covariance (L, L) of the gradient by the light, from whole roots and whole views.

    Parameters
    ----------
    back : (N, 4, L) array
        How the nodes' gradients count where the nodes are eliminated.
    lone : (V, N) bool array
        Profiles that tell.
    """
    parts, of = profiles.host(), profiles.light
    if of is None:
        raise ValueError("these profiles were made without changes by the light")
    radius, *light = (np.array(part, np.float64).reshape(profiles.shape) for part in (of.radius, *of.light))
    (views, count), roots, many = profiles.shape, len(tubes.branches), back.shape[2]
    of_root = sparse.csr_matrix((np.ones(count), (tubes.owner, np.arange(count))), shape=(roots, count))
    scores = []
    for v in range(views):
        score = np.stack([part[v] for part in light], axis=-1)
        score -= np.einsum("ni,nij->nj", parts.across[v] * parts.shift[v, :, None], back[:, :3]) + radius[v, :, None] * back[:, 3]
        scores.append(of_root @ (score * lone[v, :, None]))
    by_root = np.stack(scores)
    share = np.stack([of_root @ one for one in lone]) / max(lone.sum(), 1)
    by_root -= share[..., None] * by_root.sum(axis=(0, 1))  # far from the solution all of them ask for the same
    return scatter(by_root.reshape(-1, many), np.repeat(np.arange(views), roots), np.tile(np.arange(roots), views))
