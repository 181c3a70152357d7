"""Estimation of the optical parameters that all roots share: attenuation, blur, root hairs and refractive index.

The tubes x (positions and radii of the nodes) and the light parameters q (`light.LIGHT`) are fitted together. A
Gauss-Newton step solves

    (H + P) dx + B dq = g - P x        every node, from all of its profiles; P is the prior of smooth branches
    C^T dx + D dq     = h              light, from profiles of lone roots; others would bias the shared parameters

The nodes are eliminated by a Schur complement, with one factorisation and one additional right-hand side per light
parameter:

    S dq = s,    S = D - C^T (H + P)^-1 B,    s = h - C^T (H + P)^-1 (g - P x)

The steps of the nodes follow from dx = (H + P)^-1 (g - P x - B dq). Their radii move along the valley in which a wider,
fainter root looks the same. The covariance of q is the sandwich S^-1 M S^-T, where M is the scatter of the scores of
whole roots and whole views (`robust.scatter`). It determines the weight of the data relative to the prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.light import LIGHT, Light
from rhizotwin.recon.coverage.translucency import FAINTEST_LEARNED
from rhizotwin.recon.robust import inverse, scatter
from rhizotwin.recon.tubes import translucent_tube
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.recon.tubes.tube_profiles import Changes, LightEquations, Profiles
from rhizotwin.recon.tubes.tubes import Tubes, with_geometry

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MU, BLUR, HAIRS, INDEX = range(len(LIGHT))
FAINTEST, DARKEST = 0.1, 8.0
"""Limits of the attenuation, 1/mm. Roots above the upper limit are assumed opaque. At the lower limit, a root of 0.2 mm
absorbs 2 % of the light, which is the noise of a picture.

Translucent roots of the twin have 1.0 to 2.2. Fits to the blurred edges of opaque roots gave 9 to 16 (for a bean, with
a residual 1.09 times as large)."""
_MOST_BLUR_PX = 0.8
"""Maximum blur, px. A focused camera has less."""
_MOST_HAIRS = 4.0
"""Maximum strength of root hairs, relative to those of radish. At this strength, hairs absorb most of the light that
enters them."""
_MOST_INDEX = 0.07
"""Maximum relative excess of the roots' refractive index over that of water. Pure cell walls have an index of 1.425
(Appl. Opt. 13:109), which is 1.069 times that of water."""
_BOUNDS = np.array([[np.log(FAINTEST), 0.0, 0.0, 0.0], [np.log(DARKEST), _MOST_BLUR_PX**2, _MOST_HAIRS, _MOST_INDEX]])
"""Lower and upper bounds of the light parameters, in the order of `LIGHT`."""
ROUNDING = 1e-9
"""Maximum distance between a parameter and its bound for the parameter to be considered at the bound. It allows for
rounding of log(exp(x))."""
_LARGEST_STEP = np.array([0.35, 0.06, 0.5, 0.01])
"""Maximum change of each light parameter per iteration, in the order of `LIGHT`. Larger changes leave the range in
which the profiles are nearly linear in the parameter."""
LEARNED_SIGMA = 0.2
"""Prior standard deviation of the logarithm of the attenuation, if it was estimated from the widest roots.

For roots of 1.0/mm with refraction and hairs, the estimates from three plants were 1.03, 1.03 and 1.18/mm."""
CHANGES, _WIDER = (0.01, 0.005, 0.02, 0.002), 0.005
"""Steps of the difference quotients: for each light parameter in the order of `LIGHT`, and for the logarithm of the
radii. The steps change pictures by less than 0.01, and pictures are accurate to 1e-6."""
_RIDGE = 1e-4
"""Constant that is added to the diagonal of each node's normal matrix, 1/mm2. It keeps the matrix invertible for nodes
without a profile of a lone root (a root that no other hides or overlaps in the view). A node's own curvature is about
100/mm2. A thousandth of it remains in the direction in which a wider, fainter root looks the same."""
LEAST_VARIANCE = 1e-5
"""Minimum variance of the coverage. It corresponds to a standard deviation of 0.003, which is one grey level of 8
bits.

For the light parameters, it is also the variance of the error that all profiles have in common: that of the empty
backlight, and of the model of a root. The scatter between roots and views does not show it. Without it, the strength of
hairs was 3.0 +- 0.4 instead of 1, and the excess of the refractive index 0.05 +- 0.005 instead of 0."""
LEAST_LONE = 1500
"""Minimum number of profiles of lone roots (roots that no other root hides or overlaps) for attenuation and hairs to be
estimated. With fewer profiles, only the blur is fitted, to all profiles.

An opaque print in 40 pictures of 400x300 px has 1,140 profiles of few roots, and the residual of an opaque model is
1.15 times as large as that of a translucent model. Translucent plants have 30,000 profiles or more."""
HAIRY = 1.0, 0.5
"""Prior mean and standard deviation of the strength of hairs around translucent roots, which are young. It is relative
to that of radish in water, whose hairs are 0.1 to 0.5 mm long, and between half and one and a half times as dark as the
mean."""

BENDING = 0.024, 0.015
"""Prior mean and standard deviation of the relative excess of the roots' refractive index over that of water.

Whole wet roots have an index of 1.35 to 1.38, a relative excess of 0.013 to 0.035. The 90 % range, 0 to 0.048, also
contains roots without refraction, whose radii are 1.8 % larger than those of roots with the mean index. The pictures
determine the excess only to 0.02."""


@dataclass(frozen=True)
class Prior:
    """Prior distribution of the light parameters, before the tubes are fitted."""

    mean: Array
    """Mean of each light parameter, shape (L,)."""
    sigma: Array
    """Standard deviation of each light parameter, shape (L,). It is infinite if nothing is known about the
    parameter."""
    free: Mask
    """Mask of the light parameters that are fitted, shape (L,)."""

    @staticmethod
    def from_evidence(evidence: Evidence, learned_per_mm: float = np.inf) -> Prior:
        """Return the prior for given pictures.

        If ``learned_per_mm`` is finite, it is the attenuation of the widest roots (`translucency.learn`). Silhouettes
        constrain only the blur. For opaque roots, hairs are evaluated but not fitted.
        """
        mean, sigma = np.array([0.0, 0.0, HAIRY[0], BENDING[0]]), np.full(len(LIGHT), np.inf)
        if not evidence.is_mask:
            sigma[HAIRS], sigma[INDEX] = HAIRY[1], BENDING[1]
        if FAINTEST_LEARNED < learned_per_mm < np.inf:
            mean[MU], sigma[MU] = np.log(learned_per_mm), LEARNED_SIGMA
        translucent = not (evidence.is_mask or evidence.light.is_opaque)
        return Prior(mean, sigma, translucent | (np.arange(len(LIGHT)) == BLUR))

    @property
    def evaluated(self) -> Mask:
        """Return the mask (L,) of parameters with respect to which pictures are differentiated.

        These are the fitted parameters. If roots are opaque, derivatives with respect to the hairs are also computed.
        """
        return self.free | (np.arange(len(LIGHT)) == HAIRS) & ~np.isinf(self.sigma)

    def blur_only(self) -> Prior:
        """Return the same prior with the blur as the only free parameter."""
        return replace(self, free=self.free & (np.arange(len(LIGHT)) == BLUR))


def match_absorption(fitted: Tubes, thick: Mask, before: Light, after: Light) -> Tubes:
    """Adjust the radii of tubes to a change of the light parameters, so that they absorb as much light as before.

    The absorption is that of roots viewed from the side.

    Parameters
    ----------
    fitted : Tubes
        Tubes with radii that match the light parameters ``before``.
    thick : (N,) bool array
        Mask of nodes whose radius is not changed.
    """
    radius_mm = translucent_tube.equivalent_radius(translucent_tube.opaque_radius(fitted.radius_mm, before), after)
    return with_geometry(fitted, fitted.centre_mm, np.where(thick, fitted.radius_mm, radius_mm))


def changes(drawn: Rendering, free: Mask, steps: Sequence[float] = CHANGES) -> Changes:
    """Return the derivatives of the rendered tubes.

    They are computed with respect to the logarithm of the radii, and to the light parameters marked in ``free`` (L,),
    as difference quotients over given steps (L,) of the light parameters.
    """
    evidence, tubes, now = drawn.evidence, drawn.tubes, drawn.evidence.light.vector
    wider = with_geometry(tubes, tubes.centre_mm, (1.0 + _WIDER) * tubes.radius_mm)
    more = {k: replace(evidence, light=Light.from_vector(now + steps[k] * np.eye(len(now))[k])) for k in np.flatnonzero(free).tolist()}
    return Changes(drawn.change(evidence, wider, _WIDER), {k: drawn.change(other, tubes, steps[k]) for k, other in more.items()})


@dataclass(frozen=True)
class LightSystem:
    """Normal equations of the light parameters, with the nodes eliminated."""

    reduced: Array
    """Reduced normal matrix S of the light parameters, shape (L, L)."""
    right: Array
    """Right-hand side s of the reduced normal equations, shape (L,)."""
    meat: Array
    """Scatter matrix M of the scores, shape (L, L)."""
    lone: int
    """Number of profiles of lone roots, which no other root hides or overlaps in the view."""

    @staticmethod
    def build(equations: LightEquations, profiles: Profiles, tubes: Tubes, smooth: sparse.csr_matrix, thick: Mask) -> LightSystem:
        """Eliminate the nodes, and return the reduced normal equations.

        Parameters
        ----------
        equations, profiles : LightEquations, Profiles
            Residuals summed over the views, and residuals of each view.
        smooth : (4 N, 4 N) sparse matrix
            Quadratic form of the smoothness prior of the branches.
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
        count = int(lone.sum())
        return LightSystem(reduced, right, meat + (1 + count) * LEAST_VARIANCE * reduced, count)

    def step(self, light: Array, prior: Prior) -> Array:
        """Return the step (L,) of the light parameters within their bounds.

        The step is 0 for parameters that are not fitted.
        """
        return np.where(prior.free, np.clip(light + self._solve(light, prior)[0], *_BOUNDS) - light, 0.0)

    def covariance(self, light: Array, prior: Prior) -> Array:
        """Return the covariance (L, L) of the light parameters.

        It is 0 for parameters that are not fitted, or at a bound.
        """
        return self._solve(light, prior)[1]

    def estimate_without_prior(self, free: Mask) -> tuple[Array, Array]:
        """Return the step (L,) of the free parameters if the prior is ignored, and its standard deviation (L,)."""
        change, sigma, f = np.zeros(len(free)), np.full(len(free), np.inf), np.flatnonzero(free & (np.diag(self.reduced) > 0.0))
        bread = inverse(self.reduced[np.ix_(f, f)])
        change[f] = bread @ self.right[f]
        sigma[f] = np.sqrt(np.diag(bread @ self.meat[np.ix_(f, f)] @ bread))
        return change, sigma

    def _solve(self, light: Array, prior: Prior) -> tuple[Array, Array]:
        """Return the step (L,) and the covariance (L, L) of the light parameters.

        The step is shortened if it exceeds `_LARGEST_STEP`. Parameters at a bound that would leave their range are kept
        fixed.
        """
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
    """Return the covariance (L, L) of the gradient with respect to the light parameters.

    It is estimated from the scatter between roots and between views, since residuals on one root or in one view are
    correlated.

    Parameters
    ----------
    back : (N, 4, L) array
        Weights of the nodes' gradients after elimination of the nodes.
    lone : (V, N) bool array
        Mask of the profiles that contribute.
    """
    parts, light_profiles = profiles.host(), profiles.light
    if light_profiles is None:
        raise ValueError("the profiles have no derivatives with respect to the light parameters; pass changes to profiles()")
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
