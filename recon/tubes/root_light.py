"""Estimation of the optical parameters that all roots share: attenuation, blur, root hairs and refractive index.

The tubes and the light parameters (`LIGHT`) are fitted together: the step of the light parameters comes from profiles
of lone roots, with the nodes eliminated (`system`), and the nodes follow it. Their radii move along the valley in which
a wider, fainter root looks the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.light import LIGHT, Light
from rhizotwin.recon.coverage.translucency import FAINTEST_LEARNED
from rhizotwin.recon.tubes import translucent_tube
from rhizotwin.recon.tubes.parameters import Parameter, Parameters
from rhizotwin.recon.tubes.system import LEAST_VARIANCE, System
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.recon.tubes.tube_profiles import Changes, Profiles
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
LEARNED_SIGMA = 0.2
"""Prior standard deviation of the logarithm of the attenuation, if it was estimated from the widest roots.

For roots of 1.0/mm with refraction and hairs, the estimates from three plants were 1.03, 1.03 and 1.18/mm."""
_WIDER = 0.005
"""Step of the difference quotients for the logarithm of the radii. The steps change pictures by less than 0.01, and
pictures are accurate to 1e-6."""
PARAMETERS = (
    Parameter(LIGHT[MU], step=0.01, low=float(np.log(FAINTEST)), high=float(np.log(DARKEST)), largest=0.35),
    Parameter(LIGHT[BLUR], step=0.005, low=0.0, high=_MOST_BLUR_PX**2, largest=0.06),
    Parameter(LIGHT[HAIRS], step=0.02, low=0.0, high=_MOST_HAIRS, largest=0.5),
    Parameter(LIGHT[INDEX], step=0.002, low=0.0, high=_MOST_INDEX, largest=0.01),
)
"""Light parameters, in the order of `LIGHT`. Larger changes per iteration leave the range in which the
profiles are nearly linear in the parameter."""
STEPS = tuple(part.step for part in PARAMETERS)
"""Steps of the difference quotients."""
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


def parameters(evidence: Evidence, learned_per_mm: float = np.inf) -> Parameters:
    """Return the light parameters with their prior for given pictures.

    If ``learned_per_mm`` is finite, it is the attenuation of the widest roots (`translucency.learn`). Silhouettes
    constrain only the blur.
    """
    mean, sigma = np.array([0.0, 0.0, HAIRY[0], BENDING[0]]), np.full(len(LIGHT), np.inf)
    if not evidence.is_mask:
        sigma[HAIRS], sigma[INDEX] = HAIRY[1], BENDING[1]
    if FAINTEST_LEARNED < learned_per_mm < np.inf:
        mean[MU], sigma[MU] = np.log(learned_per_mm), LEARNED_SIGMA
    translucent = not (evidence.is_mask or evidence.light.is_opaque)
    return Parameters(PARAMETERS, evidence.light.vector, mean, np.diag(sigma**-2.0), translucent | _only(BLUR))


def evaluated(light: Parameters) -> Mask:
    """Return the mask (L,) of the fitted parameters, and of hairs, which are evaluated even if roots are opaque."""
    return light.free | _only(HAIRS) & (np.diag(light.precision) > 0.0)


def blur_only(light: Parameters) -> Parameters:
    """Return the same parameters with the blur as the only free one."""
    return replace(light, free=light.free & _only(BLUR))


def _only(*which: int) -> Mask:
    return np.isin(np.arange(len(LIGHT)), which)


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


def changes(drawn: Rendering, free: Mask, steps: Sequence[float] = STEPS) -> Changes:
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
    """Normal equations of the light parameters, from the profiles of lone roots. Others would bias the parameters."""

    system: System
    meat: Array
    """Covariance of the right-hand side, shape (L, L)."""
    lone: int
    """Number of profiles of lone roots, which no other root hides or overlaps in the view."""
    by_light: Array
    """Derivative of each node's gradient with respect to the light parameters, from all profiles, shape (N, 4, L)."""

    @staticmethod
    def build(profiles: Profiles, tubes: Tubes, thick: Mask) -> LightSystem:
        """Eliminate the nodes. Those in the mask ``thick`` (N,) do not contribute."""
        by_light, own = profiles.light_equations(thick)
        system, lone = System.eliminate(own, tubes), profiles.is_lone & ~thick
        count = int(lone.sum())
        # far from the solution, all scores share a common mean
        mean = (own.right + np.einsum("nij,ni->j", system.flank_response, own.gradient)) / max(count, 1)
        centred = ((nodes, light - shown[:, None] * mean) for shown, (nodes, light) in zip(lone, _gradients(profiles, lone), strict=True))
        meat = system.scatter(centred)
        return LightSystem(system, meat + (1 + count) * LEAST_VARIANCE * system.reduced, count, by_light)

    def solve(self, light: Parameters) -> tuple[Array, Array]:
        """Return the step (L,) of the light parameters and its covariance (L, L), see `System.solve`."""
        return self.system.solve(light, self.meat)


def _gradients(profiles: Profiles, lone: Mask) -> Iterator[tuple[Array, Array]]:
    """Yield the contributions of each view to the gradients of the nodes (N, 4) and of the light parameters (N, L).

    ``lone`` (V, N) marks the profiles that contribute.
    """
    parts, light_profiles = profiles.host(), profiles.light
    if light_profiles is None:
        raise ValueError("the profiles have no derivatives with respect to the light parameters; pass changes to profiles()")
    radius, *light = (np.array(part, np.float64).reshape(profiles.shape) for part in (light_profiles.radius, *light_profiles.light))
    for v, shown in enumerate(lone[:, :, None]):
        nodes = np.concatenate([parts.across[v] * parts.shift[v, :, None], radius[v, :, None]], axis=1)
        yield nodes * shown, np.stack([part[v] for part in light], axis=1) * shown
