"""What fitted tubes tell of the roots' translucency: the attenuation that explains the pictures of all views best.

A thin root's opacity fixes mu w^2 and leaves mu and w open, but not under all angles: a root that leans towards the
line of sight is darker by 1 / sin(theta) where it is faint and hardly darker where it is nearly opaque; and a picture
shows how wide it is. So for every tried mu the radii are guessed anew from the same light, the tubes are refitted, and
what they leave is compared on the profiles of lone roots (`tube_profiles.misfit`), with the loss that the fit itself
has: a profile in which something else stands counts little.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.translucency import CLEARLY, Hairs
from rhizotwin.recon.tubes import translucent_tube, tube_fit, tube_picture, tube_profiles, tubes
from rhizotwin.recon.tubes.tube_profiles import OUTLIER
from rhizotwin.recon.tubes.tubes import Tubes

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Light = tuple[float | None, Hairs | None]
"""What takes a root's light: its attenuation, 1/mm, or None where it is opaque, and its hairs."""

_FAINTEST, _DARKEST = 0.5, 16.0
"""Attenuations, 1/mm, between which is sought; roots of more count as opaque (one of 0.2 mm absorbs 97 % of the
light)."""
_COARSE, _MIDDLE, _FINE = 2.0, 2.0**0.5, 2.0**0.25
"""Ratios of neighbouring attenuations: on the way from opaque roots, for a first parabola, and for that of the tubes at
rest."""
_STEPS = 4
"""Gauss-Newton steps for every tried attenuation, from tubes that absorb as much light as those of the nearest one
before."""
_MOST_PROFILES = 40_000
"""Nodes times views that are compared; of more, only some views are."""
_LEAST_VIEWS = 12
"""Views that are compared at least: more directions tell attenuation from width."""
_OPAQUE = 1e3
"""Attenuation, 1/mm, of roots that count as opaque."""
_ALONE = 0.95
"""Share of a lone root that no other hides."""
_LEAST_SINE = 0.3
"""Roots that lean towards the camera more than this tell more of their bends than of their light."""
_LEAST_LONE = 500
"""Profiles; fewer tell nothing: roots then let as much light through as the widest ones in the pictures seemed to."""
_LEARNED_SIGMA = 0.2
"""Standard deviation of the logarithm of what the widest roots seemed to: of roots of 1.0 a mm that refract and have
hairs, three plants seemed to have 1.03, 1.03 and 1.18."""
_PERHAPS = 1.1
"""Half of `CLEARLY`: opaque roots of the twin left up to 1.01 times as much as the darkest translucent ones."""
BLUR_STEP_PX = 0.1
"""Blurs that differ by less are not told apart."""
_MOST_BLUR_PX = 0.8
"""A camera in focus blurs less."""


@dataclass(frozen=True)
class TubeAttenuation:
    """The attenuation that the tubes found."""

    mu_per_mm: float | None
    """None: roots are opaque."""
    sigma: float
    """Standard deviation of log mu, from the scatter of roots and views and from the uncertainty of the blur; 0 for
    opaque roots."""
    blur_px: float
    """With which it explains the pictures best."""
    against_opaque: float
    """How many times more opaque roots leave unexplained on lone roots; less than 1 where they leave less, 0 where
    nothing was compared."""
    profiles: int
    """Profiles of lone roots that told it."""
    rival_per_mm: float | None = None
    """Attenuation that explains the pictures better than opaque roots, but not clearly so."""
    hairs: Literal["none", "maybe", "there"] = "none"
    """Whether hairs stand about the roots; maybe, where pictures with and without them would look alike."""

    @staticmethod
    def opaque(blur_px: float, profiles: int = 0) -> TubeAttenuation:
        """Return the attenuation of opaque roots, where nothing was compared."""
        return TubeAttenuation(None, 0.0, blur_px, 0.0, profiles)

    def warnings(self) -> list[str]:
        """Return what is to be said of an attenuation that is not sure."""
        hairs = []
        if self.hairs == "there":
            hairs = [
                f"hairs of about {translucent_tube.HAIRS.length_mm:g} mm seem to stand about the roots; their light is not counted as root"
            ]
        if self.rival_per_mm is None:
            return hairs
        return [
            *hairs,
            f"roots may be translucent ({self.rival_per_mm:.2g} per mm): opaque ones leave {self.against_opaque:.2f} times as much of lone "
            f"roots unexplained, not the {CLEARLY:g} times that would be believed; they are taken to be opaque",
        ]


@dataclass(frozen=True)
class _Trial:
    """Tubes fitted with some attenuation and blur."""

    mu_per_mm: float | None
    blur_px: float
    tubes: Tubes
    loss: Array
    """(V, N) what is left on each profile."""
    cost: float
    """Of the lone profiles together."""


@dataclass
class Trials:
    """Trials on the same profiles, each made once."""

    light: Evidence
    organ: Mask
    start: _Trial
    nodes: Tubes
    """Where profiles are compared."""
    lone: Mask
    """(V, N) those that are."""
    made: dict[tuple[float | None, float], _Trial] = field(default_factory=dict)

    @staticmethod
    def of(light: Evidence, fitted: Tubes, organ: Mask, blur_px: float) -> Trials:
        """Begin with tubes that were fitted to the light, or nearly so.

        Parameters
        ----------
        light : Evidence
            Opacity, with the attenuation and hairs that the tubes have.
        fitted : Tubes
            The tubes.
        organ : (N,) bool array
            Nodes whose radius stays.
        blur_px : float
            Of the pictures.
        """
        light = _some_views(light, len(fitted.radius_mm))
        fitted, _ = tube_fit.fit(light, fitted, organ, blur_px=blur_px, steps=_STEPS)
        at = light.project(fitted.centre_mm)
        depth, difference = tube_picture.compared(light, fitted, at, blur_px)
        found = tube_profiles.profiles(light, fitted, at, depth, difference, blur_px).host()
        alone = (found.shown > _ALONE * found.whole) & (found.whole > 0.0) & (at.sine(fitted.tangents) > _LEAST_SINE) & ~organ
        left = tube_profiles.misfit(light, fitted, difference)
        return Trials(light, organ, _Trial(light.mu_per_mm, blur_px, fitted, left, 0.0), fitted, alone & np.isfinite(left))

    def at(self, mu_per_mm: float | None, blur_px: float) -> _Trial:
        """Refit the tubes with some attenuation and blur."""
        if (mu_per_mm, blur_px) not in self.made:
            seen = replace(self.light, mu_per_mm=mu_per_mm)
            fitted, _ = tube_fit.fit(seen, self._guess(mu_per_mm), self.organ, blur_px=blur_px, steps=_STEPS)
            _, difference = tube_picture.compared(seen, fitted, seen.project(fitted.centre_mm), blur_px)
            left = tube_profiles.misfit(seen, self.nodes, difference)
            loss = np.where(self.lone, OUTLIER * np.log1p(np.nan_to_num(left) / OUTLIER), 0.0)
            self.made[mu_per_mm, blur_px] = _Trial(mu_per_mm, blur_px, fitted, loss, float(loss.sum()))
        return self.made[mu_per_mm, blur_px]

    def _guess(self, mu_per_mm: float | None) -> Tubes:
        """Return the tubes of the nearest trial, with radii that absorb as much light from the side."""
        known = [*self.made.values(), self.start]
        near = min(known, key=lambda trial: abs(np.log((trial.mu_per_mm or _OPAQUE) / (mu_per_mm or _OPAQUE))))
        return scaled(near.tubes, self.organ, near.mu_per_mm, mu_per_mm, self.light.hairs)


def find(seen: Evidence, fitted: Tubes, organ: Mask, blur_px: float, learned_per_mm: float | None = None) -> tuple[TubeAttenuation, Tubes]:
    """Find the attenuation, and the tubes as they are with it.

    Parameters
    ----------
    seen : Evidence
        Coverage; its silhouettes hold the opacity that is compared.
    fitted : Tubes
        Tubes that were fitted to it.
    organ : (N,) bool array
        Nodes that stay as they are.
    blur_px : float
        Of the pictures, as opaque roots have it.
    learned_per_mm : float or None
        As the widest roots seem to have it (`translucency.learn`): that of all, where lone tubes are too few to tell.

    Returns
    -------
    attenuation : TubeAttenuation
        Opaque where nothing is clearly better.
    tubes : Tubes
        With the attenuation's radii; ``fitted`` as they were for opaque roots.
    """
    if not seen.has_opacity:
        return TubeAttenuation.opaque(blur_px), fitted
    trials = Trials.of(seen.by_light(), fitted, organ, blur_px)
    count = int(trials.lone.sum())
    if count < _LEAST_LONE:
        if learned_per_mm is None:
            return TubeAttenuation.opaque(blur_px, count), fitted
        best = best_blur(trials, learned_per_mm, 0.0)
        return TubeAttenuation(learned_per_mm, _LEARNED_SIGMA, best.blur_px, 0.0, count), best.tubes
    opaque, dark = trials.at(None, blur_px), trials.at(_DARKEST, blur_px)
    if opaque.cost <= dark.cost:
        return TubeAttenuation(None, 0.0, blur_px, opaque.cost / dark.cost, count), fitted
    mu = _DARKEST
    while mu > _FAINTEST and trials.at(mu / _COARSE, 0.0).cost < trials.at(mu, 0.0).cost:
        mu /= _COARSE
    least = _least(trials, mu, 0.0, _MIDDLE)
    if opaque.cost <= CLEARLY * least.cost:
        rival = least.mu_per_mm if opaque.cost > _PERHAPS * least.cost else None
        return TubeAttenuation(None, 0.0, blur_px, opaque.cost / least.cost, count, rival), fitted
    near = trials.at(
        min((mu for mu, blur in trials.made if mu and blur == least.blur_px), key=lambda mu: abs(np.log(mu / least.mu_per_mm))),
        least.blur_px,
    )
    attenuation = TubeAttenuation(*_with_learned(least, learned_per_mm), least.blur_px, opaque.cost / least.cost, count)
    return attenuation, scaled(near.tubes, organ, near.mu_per_mm, attenuation.mu_per_mm, seen.hairs)


def refine(
    seen: Evidence, fitted: Tubes, organ: Mask, attenuation: TubeAttenuation, learned_per_mm: float | None = None
) -> tuple[TubeAttenuation, Tubes]:
    """Find attenuation and blur once more, with tubes at rest, or that roots are opaque after all.

    Tubes that are not at rest leave what other attenuations seem to explain: of an opaque bean opaque ones left 1.37
    times as much as translucent ones (4.3 a mm) at first, and 1.09 times as much at rest (10 a mm).

    Parameters
    ----------
    seen : Evidence
        Opacity, with that attenuation.
    fitted : Tubes
        Tubes at rest.
    organ : (N,) bool array
        Nodes whose radius the hull gives.
    attenuation : TubeAttenuation
        As found before.
    learned_per_mm : float or None
        As in `find`.

    Returns
    -------
    TubeAttenuation, Tubes
        With radii that belong to it.
    """
    if attenuation.mu_per_mm is None:
        return attenuation, fitted
    trials = Trials.of(seen, fitted, organ, attenuation.blur_px)
    if trials.lone.sum() < _LEAST_LONE:
        return attenuation, fitted
    least = _joint(trials, attenuation.mu_per_mm, attenuation.blur_px)
    opaque = best_blur(trials, None, least.blur_px)
    if opaque.cost <= CLEARLY * least.cost:
        against, rival = opaque.cost / least.cost, least.mu_per_mm if opaque.cost > _PERHAPS * least.cost else None
        return TubeAttenuation(None, 0.0, opaque.blur_px, against, int(trials.lone.sum()), rival), opaque.tubes
    mu_per_mm, sigma = _with_learned(least, learned_per_mm)
    found = replace(attenuation, mu_per_mm=mu_per_mm, sigma=sigma, blur_px=least.blur_px, profiles=int(trials.lone.sum()))
    return found, scaled(fitted, organ, attenuation.mu_per_mm, found.mu_per_mm, seen.hairs)


@dataclass(frozen=True)
class _Least:
    """The best attenuation for a blur."""

    mu_per_mm: float
    blur_px: float
    cost: float
    sigma: float


def _with_learned(least: _Least, learned_per_mm: float | None) -> tuple[float, float]:
    """Return what thin and wide roots together say of attenuation and the standard deviation of its logarithm."""
    if learned_per_mm is None:
        return least.mu_per_mm, least.sigma
    told, learned = max(least.sigma, 1e-6) ** -2, _LEARNED_SIGMA**-2
    log_mu = (told * np.log(least.mu_per_mm) + learned * np.log(learned_per_mm)) / (told + learned)
    return float(np.exp(log_mu)), float((told + learned) ** -0.5)


def _joint(trials: Trials, mu_per_mm: float, blur_px: float) -> _Least:
    """Walk from a blur to the best of the neighbouring blurs, each with its best attenuation.

    Blur and attenuation look alike to some degree, so that half of what a step of blur changes counts as uncertainty of
    the attenuation.
    """
    known: dict[int, _Least] = {}

    def at(step: int) -> _Least:
        if step not in known:
            near = min(known, key=lambda one: abs(one - step), default=None)
            known[step] = _least(trials, mu_per_mm if near is None else known[near].mu_per_mm, blur_px + BLUR_STEP_PX * step, _FINE)
        return known[step]

    def allowed(step: int) -> bool:
        return -1e-6 < blur_px + BLUR_STEP_PX * step < _MOST_BLUR_PX

    best = 0
    for way in (1, -1):
        while allowed(best + way) and at(best + way).cost < at(best).cost:
            best += way
    found, beside = at(best), [step for step in (best - 1, best + 1) if step in known]
    change = [np.log(known[step].mu_per_mm / found.mu_per_mm) for step in beside]
    off = 0.0
    if len(beside) == 2:  # between the blurs, as a parabola has it
        bend, slope = 0.5 * (known[best - 1].cost + known[best + 1].cost) - found.cost, 0.5 * (known[best + 1].cost - known[best - 1].cost)
        off = float(np.clip(-slope / (2.0 * bend), -0.5, 0.5)) if bend > 0.0 else 0.0
        mu_per_mm = found.mu_per_mm * float(np.exp(0.5 * (change[1] - change[0]) * off + 0.5 * (change[0] + change[1]) * off**2))
        found = replace(found, mu_per_mm=mu_per_mm, blur_px=found.blur_px + BLUR_STEP_PX * off)
    more = 0.5 * sum(abs(one) for one in change) / max(len(beside), 1)
    return replace(found, sigma=float(np.hypot(found.sigma, more)))


def best_blur(trials: Trials, mu_per_mm: float | None, blur_px: float) -> _Trial:
    """Walk from a blur to the one with which roots of some attenuation explain the pictures best."""
    best = trials.at(mu_per_mm, blur_px)
    while blur_px + BLUR_STEP_PX < _MOST_BLUR_PX:
        blur_px += BLUR_STEP_PX
        wider = trials.at(mu_per_mm, blur_px)
        if wider.cost >= best.cost:
            break
        best = wider
    return best


def _least(trials: Trials, mu_per_mm: float, blur_px: float, ratio: float) -> _Least:
    """Walk from an attenuation to the least cost in its neighbourhood, and put a parabola through it."""

    def trial(step: int) -> _Trial:
        return trials.at(mu_per_mm * ratio**step, blur_px)

    best = 0
    for way in (-1, 1):
        while _FAINTEST <= mu_per_mm * ratio ** (best + way) <= _DARKEST and trial(best + way).cost < trial(best).cost:
            best += way
    steps = (best - 1, best, best + 1)
    loss = np.stack([trial(step).loss for step in steps])
    owner = trials.nodes.owner
    at = np.log(ratio) * np.array([-1.0, 0.0, 1.0])
    bend, slope, level = np.polyfit(at, loss.sum(axis=(1, 2)), 2)
    if bend <= 0.0:
        # anything that was tried
        return _Least(mu_per_mm * ratio**best, blur_px, trial(best).cost, float(np.log(_DARKEST / _FAINTEST)))
    off = float(np.clip(-slope / (2.0 * bend), at[0], at[-1]))
    # sandwich: the slope at the least that every root and every view has by itself
    variance = 0.0
    for of in (loss.sum(axis=2).T, np.stack([np.bincount(owner, weights=one.sum(axis=0)) for one in loss]).T):
        a, b, _ = np.polyfit(at, of.T, 2)
        variance += float(np.square((2.0 * a * off + b) / (2.0 * bend)).sum())
    return _Least(float(mu_per_mm * ratio**best * np.exp(off)), blur_px, level + slope * off + bend * off**2, float(np.sqrt(variance)))


def scaled(fitted: Tubes, organ: Mask, before: float | None, after: float | None, hairs: Hairs | None = None) -> Tubes:
    """Give tubes the radii that absorb as much light from the side with another attenuation; None is opaque.

    Parameters
    ----------
    fitted : Tubes
        With radii that belong to ``before``.
    organ : (N,) bool array
        Nodes whose radius the hull gives.
    before, after : float or None
        1/mm.
    hairs : Hairs or None
        That stand about them.

    Returns
    -------
    Tubes
        With radii that belong to ``after``.
    """
    return with_light_kept(fitted, organ, (before, hairs), (after, hairs))


def with_light_kept(fitted: Tubes, organ: Mask, before: Light, after: Light) -> Tubes:
    """Give tubes the radii that absorb as much light from the side with another attenuation and other hairs.

    Parameters
    ----------
    fitted : Tubes
        With radii that belong to ``before``.
    organ : (N,) bool array
        Nodes whose radius stays.
    before, after : Light
        Attenuation and hairs.

    Returns
    -------
    Tubes
        With radii that belong to ``after``.
    """
    light = translucent_tube.opaque_radius(fitted.radius_mm, *before)
    return tubes.moved(fitted, fitted.centre_mm, np.where(organ, fitted.radius_mm, translucent_tube.radius_of(light, *after)))


def _some_views(light: Evidence, nodes: int) -> Evidence:
    """Return as many views as are compared; they come in an order that spreads neighbours over the turn."""
    count = light.bank.count
    most = max(_LEAST_VIEWS, _MOST_PROFILES // max(nodes, 1))
    return light if count <= most else light.of_views(list(range(most)))
