"""Attenuation of thin roots, found by a comparison of two fits of tubes: as opaque and as translucent roots.

The opacity of a thin root determines the product mu w^2 of its attenuation mu and squared radius w^2, but not mu and w
separately. Two effects separate them. First, a root inclined towards the line of sight is darker by 1 / sin(theta) if
it is faint, but hardly darker if it is nearly opaque. Second, the pictures show its width. Attenuation, blur and hairs
are fitted together with the tubes (`root_light`). The two fits are compared on the profiles of lone roots, with a
robust loss that gives little weight to profiles with other objects.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.light import LIGHT, Light
from rhizotwin.recon.coverage.translucency import CLEARLY, FAINTEST_LEARNED
from rhizotwin.recon.tubes import root_light, translucent_tube, tube_fit, tube_profiles
from rhizotwin.recon.tubes.root_light import (
    BENDING,
    DARKEST,
    FAINTEST,
    HAIRS,
    HAIRY,
    INDEX,
    LEARNED_SIGMA,
    LEAST_LONE,
    MU,
)
from rhizotwin.recon.tubes.system import ROUNDING
from rhizotwin.recon.tubes.tube_fit import Fit
from rhizotwin.recon.tubes.tube_profiles import OUTLIER
from rhizotwin.recon.tubes.tubes import Tubes

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_START_PER_MM = 2.0
"""Initial attenuation in the fit of translucent roots, 1/mm. It is used if the attenuation was not estimated from wide
roots. The value is the geometric mean of 0.5/mm and 8/mm."""
_PERHAPS = 1.1
"""Minimum ratio of the opaque model's residual to the translucent model's residual for roots to be considered
translucent. The difference must also be significant (`_TELLING`).

The excess of this ratio over 1 is half of that of `CLEARLY`. Opaque plants of the twin have ratios of 1.01 to 1.03, and
an opaque bean has 1.09."""
_TELLING, _EXCLUDED = 2.0, 3.0
"""Two thresholds for a difference divided by its standard deviation, which is computed from the scatter of roots and
views.

Above the first threshold, the difference between two models, or between the attenuation and its upper bound, is
significant. Above the second, hairs half as strong as those of radish are excluded. Opaque plants of the twin have
differences of 0.2 to 1.7, and thin translucent plants of 2.8 to 12."""
_BOUND_SIGMA = float(np.log(FAINTEST_LEARNED / FAINTEST)) / 3.0**0.5
"""Standard deviation of log mu about its upper bound, if only the bound is known. It is that of a uniform distribution
between the smallest attenuation and the bound, about its upper end."""


@dataclass(frozen=True)
class TubeAttenuation:
    """Attenuation of light by the roots, with the other light parameters that they share."""

    light: Light
    """Fitted light parameters."""
    covariance: Array
    """Covariance of the light parameters, shape (L, L), in the order of `LIGHT`. It is 0 for parameters that were not
    fitted."""
    against_opaque: float
    """Residual of the opaque model divided by the residual of the translucent model, for roots that no other root hides
    or overlaps. Values below 1 favour the opaque model. The value is 0 if the models were not compared."""
    profiles: int
    """Number of profiles over which the models were compared. These are profiles of roots that no other root hides or
    overlaps."""
    rival_per_mm: float | None = None
    """Attenuation of the translucent model if it explains the pictures better, but not significantly better, than the
    opaque model, 1/mm. Otherwise None."""
    hairs: Literal["none", "maybe", "there"] = "none"
    """Whether the roots have hairs. The value is "maybe" if the pictures do not distinguish between roots with and
    without hairs."""

    @staticmethod
    def opaque() -> TubeAttenuation:
        """Return the attenuation of opaque roots if models were not compared."""
        return TubeAttenuation(Light(), np.zeros((len(LIGHT), len(LIGHT))), 0.0, 0)

    @property
    def sigma(self) -> float:
        """Return the standard deviation of the logarithm of the attenuation. It is 0 for opaque roots."""
        return float(np.sqrt(self.covariance[MU, MU]))

    def warnings(self) -> list[str]:
        """Return warnings about root hairs and about an uncertain attenuation."""
        hairs = []
        if self.hairs == "there":
            long_mm = translucent_tube.HAIRS.length_mm
            hairs = [
                f"the roots appear to have root hairs about {long_mm:g} mm long; "
                "the light that these hairs absorb is not counted as root volume"
            ]
        if self.rival_per_mm is None:
            return hairs
        return [
            *hairs,
            f"the roots may be translucent (attenuation {self.rival_per_mm:.2g} per mm): opaque roots explain the pictures less well "
            f"(the residual is {self.against_opaque:.2f} times as large), but this may be due to chance, so the roots are assumed opaque",
        ]


def find(evidence: Evidence, fitted: Tubes, thick: Mask, learned_per_mm: float = np.inf) -> tuple[TubeAttenuation, Fit]:
    """Fit tubes as opaque and as translucent roots, and return the better fit.

    The translucent fit is returned only if it is clearly better. `update_attenuation` adds covariance and hairs.

    Parameters
    ----------
    evidence : Evidence
        Measured opacity, with roots assumed opaque. Silhouettes constrain only the blur.
    fitted : Tubes
        Tubes to be fitted.
    thick : (N,) bool array
        Mask of the nodes of thick roots, whose radii are not adapted to the attenuation.
    learned_per_mm : float
        Attenuation estimated from the widest roots, 1/mm (`translucency.learn`). It is infinite if they are opaque, or
        if there is no estimate.
    """
    opaque = tube_fit.fit(evidence, fitted, thick, light=root_light.parameters(evidence))
    if evidence.is_mask or (opaque.few and learned_per_mm == np.inf):
        return replace(TubeAttenuation.opaque(), light=opaque.evidence.light), opaque
    start_per_mm = _START_PER_MM if learned_per_mm == np.inf else min(learned_per_mm, DARKEST)
    glassy = replace(opaque.evidence, light=replace(opaque.evidence.light, mu_per_mm=start_per_mm, hairs=HAIRY[0]))
    tubes = root_light.match_absorption(opaque.tubes, thick, evidence.light, glassy.light)
    light = root_light.parameters(glassy, learned_per_mm)
    # With a free index, some combination of parameters would match any edge.
    light = replace(light, free=light.free & (np.arange(len(light.free)) != INDEX))
    translucent = tube_fit.fit(glassy, tubes, thick, light=light)
    losses, lone = _losses(opaque, translucent, thick)
    against, profiles = float(losses[0].sum() / max(losses[1].sum(), 1e-12)), int(lone.sum())
    mu_per_mm = translucent.evidence.light.mu_per_mm
    is_sufficient = profiles >= LEAST_LONE
    perhaps = is_sufficient and against > _PERHAPS
    if perhaps:
        perhaps = float(np.log(DARKEST / mu_per_mm)) > _TELLING * update_attenuation(TubeAttenuation.opaque(), translucent).sigma + ROUNDING
    clearly = perhaps and (against > CLEARLY or significance(losses[0] - losses[1], opaque.tubes.owner) > _TELLING)
    is_translucent = clearly or (not is_sufficient and learned_per_mm < np.inf)
    fit = translucent if is_translucent else opaque
    found = replace(TubeAttenuation.opaque(), light=fit.evidence.light, against_opaque=against, profiles=profiles)
    return replace(found, rival_per_mm=mu_per_mm if perhaps and not clearly else None), fit


def follow(evidence: Evidence, fitted: Tubes, thick: Mask, learned_per_mm: float, known: TubeAttenuation) -> Fit:
    """Fit tubes and light parameters, starting from the light parameters of an earlier fit.

    Parameters
    ----------
    evidence, fitted, thick, learned_per_mm : Evidence, Tubes, (N,) bool array, float
        Same as in `find`.
    known : TubeAttenuation
        Known attenuation of the same roots.
    """
    lit = replace(evidence, light=known.light)
    tubes = root_light.match_absorption(fitted, thick, evidence.light, lit.light)
    return tube_fit.fit(lit, tubes, thick, light=root_light.parameters(lit, learned_per_mm))


def update_attenuation(attenuation: TubeAttenuation, fit: Fit) -> TubeAttenuation:
    """Return an attenuation with the results of a fit.

    These are the light parameters, their covariance, and the presence of hairs.
    """
    light, fitted = fit.evidence.light, fit.light
    if fit.lit is None or fitted is None:
        return attenuation
    covariance = fit.lit.solve(fitted)[1]
    if fit.few and not light.is_opaque:
        sigma = LEARNED_SIGMA if light.mu_per_mm > FAINTEST_LEARNED else _BOUND_SIGMA
        covariance[MU, MU], covariance[INDEX, INDEX] = sigma**2, BENDING[1] ** 2
    hairs: Literal["none", "maybe", "there"] = "none"
    if not (fit.evidence.is_mask or fit.few):
        change, spread = fit.lit.solve(fitted.unconstrained(root_light.evaluated(fitted)))
        strength, sigma = light.hairs + float(change[HAIRS]), float(np.sqrt(spread[HAIRS, HAIRS]))
        if strength + _EXCLUDED * sigma > 0.5:
            hairs = "there" if not light.is_opaque and strength > _TELLING * sigma else "maybe"
    return replace(attenuation, light=light, covariance=covariance, hairs=hairs)


def _losses(opaque: Fit, translucent: Fit, thick: Mask) -> tuple[Array, Mask]:
    """Return the losses (2, V, N) of both fits, and the mask (V, N) of the profiles that were compared.

    A profile is used only if it shows, in both fits, a root that no other root hides or overlaps.
    """
    fits = opaque, translucent
    lone = np.logical_and.reduce([tube_profiles.profiles(fit.rendering).is_lone for fit in fits]) & ~thick
    left = np.stack([tube_profiles.misfit(opaque.evidence, opaque.tubes, fit.rendering.difference) for fit in fits])
    lone &= np.isfinite(left).all(axis=0)
    return np.where(lone, OUTLIER * np.log1p(np.nan_to_num(left) / OUTLIER), 0.0), lone


def significance(difference: Array, owner: NDArray[np.int64]) -> float:
    """Return the sum of differences (V, N) divided by its standard deviation.

    Profiles of one root, or of one view, are not independent. The variance is therefore that of their sums about zero.
    The result is never larger than the square root of the number of profiles.

    Parameters
    ----------
    owner : (N,) int array
        Index of the root of each node.
    """
    by_root, by_view = np.bincount(owner, weights=difference.sum(axis=0)), difference.sum(axis=1)
    return float(difference.sum() / max(np.sqrt(np.square(by_root).sum() + np.square(by_view - by_view.mean()).sum()), 1e-12))
