"""What fitted tubes tell of the roots' translucency: the attenuation that explains the pictures of all views best.

A thin root's opacity fixes mu w^2 and leaves mu and w open, but not under all angles: a root that leans towards the
line of sight is darker by 1 / sin(theta) where it is faint and hardly darker where it is nearly opaque; and a picture
shows how wide it is. So for every tried mu the radii are guessed anew from the same light, the tubes are refitted, and
what they leave is compared on the profiles of lone roots (`tube_profiles.misfit`), with the loss that the fit itself
has: a profile in which something else stands counts little.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.translucency import CLEARLY, FAINTEST_LEARNED
from rhizotwin.recon.tubes import translucent_tube
from rhizotwin.recon.tubes.attenuation_trials import Trial, Trials, scaled
from rhizotwin.recon.tubes.tubes import Tubes

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_FAINTEST, _DARKEST = 0.5, 16.0
"""Attenuations, 1/mm, between which is sought; roots of more count as opaque (one of 0.2 mm absorbs 97 % of the
light)."""
_COARSE, _MIDDLE, _FINE = 2.0, 2.0**0.5, 2.0**0.25
"""Ratios of neighbouring attenuations: on the way from opaque roots, for a first parabola, and for that of the tubes at
rest."""
_LEAST_LONE = 500
"""Profiles; fewer tell nothing: roots then let as much light through as the widest ones in the pictures seemed to."""
_LEARNED_SIGMA = 0.2
"""Standard deviation of the logarithm of what the widest roots seemed to: of roots of 1.0 a mm that refract and have
hairs, three plants seemed to have 1.03, 1.03 and 1.18."""
_PERHAPS = 1.1
"""Half of `CLEARLY`: where opaque roots leave this many times as much, and by more than chance (`TELLING`), roots are
translucent, too. Opaque plants of the twin left 1.01 to 1.03 times as much, an opaque bean 1.09."""
TELLING = 2.0
"""Standard deviations, from the scatter of roots and views, by which two models must differ to be told apart: opaque
plants of the twin had 0.2 to 1.7, thin translucent ones 2.8 to 12."""
BLUR_STEP_PX = 0.1
"""Blurs that differ by less are not told apart."""
_FAR_BEHIND = 3.0
"""Standard deviations: a blur that leaves so much more has a weight of a hundredth, and those beyond have less."""
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
            "roots unexplained, which may be chance; they are taken to be opaque",
        ]


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
    near = trials.nearest(least.mu_per_mm, least.blur_px)
    if not _is_translucent(trials, opaque, least.cost):
        return TubeAttenuation(None, 0.0, blur_px, opaque.cost / least.cost, count, _rival(opaque, least)), fitted
    attenuation = TubeAttenuation(*_with_learned(least, learned_per_mm), least.blur_px, float(opaque.cost / least.cost), count)
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
    opaque = best_blur(trials, None, attenuation.blur_px)
    if not _is_translucent(trials, opaque, least.cost):
        against, rival = opaque.cost / least.cost, _rival(opaque, least)
        return TubeAttenuation(None, 0.0, opaque.blur_px, against, int(trials.lone.sum()), rival, attenuation.hairs), opaque.tubes
    mu_per_mm, sigma = _with_learned(least, learned_per_mm)
    found = replace(attenuation, mu_per_mm=mu_per_mm, sigma=sigma, blur_px=least.blur_px, profiles=int(trials.lone.sum()))
    return found, scaled(fitted, organ, attenuation.mu_per_mm, found.mu_per_mm, seen.hairs)


def _is_translucent(trials: Trials, opaque: Trial, least_cost: float) -> bool:
    """Tell whether translucent roots explain the pictures better than opaque ones do, and not by chance."""
    if opaque.cost > CLEARLY * least_cost:
        return True
    return opaque.cost > _PERHAPS * least_cost and trials.significance(opaque, trials.best_translucent) > TELLING


def _rival(opaque: Trial, least: _Least) -> float | None:
    """Return the attenuation that explains the pictures better than opaque roots that are believed."""
    return least.mu_per_mm if opaque.cost > _PERHAPS * least.cost else None


@dataclass(frozen=True)
class _Least:
    """The best attenuation for a blur."""

    mu_per_mm: float
    blur_px: float
    cost: float
    sigma: float


def _with_learned(least: _Least, learned_per_mm: float | None) -> tuple[float, float]:
    """Return what thin and wide roots together say of attenuation and the standard deviation of its logarithm."""
    if learned_per_mm is None or learned_per_mm <= FAINTEST_LEARNED:
        return least.mu_per_mm, least.sigma
    told, learned = max(least.sigma, 1e-6) ** -2, _LEARNED_SIGMA**-2
    log_mu = (told * np.log(least.mu_per_mm) + learned * np.log(learned_per_mm)) / (told + learned)
    return float(np.exp(log_mu)), float((told + learned) ** -0.5)


def _joint(trials: Trials, mu_per_mm: float, blur_px: float) -> _Least:
    """Find attenuation and blur together.

    Roots that are wider and fainter look like more blur: along a valley both change, and the pictures are explained
    hardly worse. So every blur has its best attenuation, and they are averaged, with the weights that normal errors
    give blurs that leave so many standard deviations more than the best one.
    """
    known: dict[int, _Least] = {}

    def at(step: int) -> _Least:
        if step not in known:
            near = min(known, key=lambda one: abs(one - step), default=None)
            known[step] = _least(
                trials, mu_per_mm if near is None else known[near].mu_per_mm, max(0.0, blur_px + BLUR_STEP_PX * step), _FINE
            )
        return known[step]

    def behind(step: int) -> float:
        """Return by how many standard deviations a blur leaves more than the best of those that are known."""
        here, best = at(step), min(known.values(), key=lambda one: one.cost)
        return trials.behind(*(trials.nearest(one.mu_per_mm, one.blur_px) for one in (here, best)))

    at(0)
    for way in (1, -1):
        step = way
        while -1e-6 < blur_px + BLUR_STEP_PX * step < _MOST_BLUR_PX and behind(step) < _FAR_BEHIND:
            step += way
    weight = np.array([np.exp(-0.5 * max(0.0, behind(step)) ** 2) for step in known])
    weight /= weight.sum()
    log_mu, blurs, sigma = np.array([(np.log(one.mu_per_mm), one.blur_px, one.sigma) for one in known.values()]).T
    mean = float(weight @ log_mu)
    variance = float(weight @ (sigma**2 + (log_mu - mean) ** 2))
    best = min(known.values(), key=lambda one: one.cost)
    return _Least(float(np.exp(mean)), float(weight @ blurs), best.cost, variance**0.5)


def best_blur(trials: Trials, mu_per_mm: float | None, blur_px: float) -> Trial:
    """Walk from a blur to the one with which roots of some attenuation explain the pictures best."""
    best = trials.at(mu_per_mm, blur_px)
    for way in (BLUR_STEP_PX, -BLUR_STEP_PX):
        while -1e-6 < best.blur_px + way < _MOST_BLUR_PX:
            tried = trials.at(mu_per_mm, best.blur_px + way)
            if tried.cost >= best.cost:
                break
            best = tried
    return best


def _least(trials: Trials, mu_per_mm: float, blur_px: float, ratio: float) -> _Least:
    """Walk from an attenuation to the least cost in its neighbourhood, and put a parabola through it."""

    def trial(step: int) -> Trial:
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
