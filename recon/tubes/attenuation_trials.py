"""Trials of attenuations and blurs: tubes are refitted with each, and compared on the profiles of lone roots."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.translucency import Hairs
from rhizotwin.recon.tubes import translucent_tube, tube_fit, tube_picture, tube_profiles, tubes
from rhizotwin.recon.tubes.tube_profiles import OUTLIER
from rhizotwin.recon.tubes.tubes import Tubes

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Light = tuple[float | None, Hairs | None]
"""What takes a root's light: its attenuation, 1/mm, or None where it is opaque, and its hairs."""

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


@dataclass(frozen=True)
class Trial:
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
    start: Trial
    nodes: Tubes
    """Where profiles are compared."""
    lone: Mask
    """(V, N) those that are."""
    made: dict[tuple[float | None, float], Trial] = field(default_factory=dict)

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
        return Trials(light, organ, Trial(light.mu_per_mm, blur_px, fitted, left, 0.0), fitted, alone & np.isfinite(left))

    def at(self, mu_per_mm: float | None, blur_px: float) -> Trial:
        """Refit the tubes with some attenuation and blur."""
        if (mu_per_mm, blur_px) not in self.made:
            seen = replace(self.light, mu_per_mm=mu_per_mm)
            fitted, _ = tube_fit.fit(seen, self._guess(mu_per_mm), self.organ, blur_px=blur_px, steps=_STEPS)
            _, difference = tube_picture.compared(seen, fitted, seen.project(fitted.centre_mm), blur_px)
            left = tube_profiles.misfit(seen, self.nodes, difference)
            loss = np.where(self.lone, OUTLIER * np.log1p(np.nan_to_num(left) / OUTLIER), 0.0)
            self.made[mu_per_mm, blur_px] = Trial(mu_per_mm, blur_px, fitted, loss, float(loss.sum()))
        return self.made[mu_per_mm, blur_px]

    def nearest(self, mu_per_mm: float, blur_px: float) -> Trial:
        """Return the trial of translucent roots that comes nearest to some attenuation and blur."""
        made = {key: trial for key, trial in self.made.items() if key[0] is not None}
        return made[min(made, key=lambda key: (abs(key[1] - blur_px), abs(np.log((key[0] or _OPAQUE) / mu_per_mm))))]

    @property
    def best_translucent(self) -> Trial:
        """Return the trial of translucent roots that leaves least."""
        return min((trial for trial in self.made.values() if trial.mu_per_mm is not None), key=lambda trial: trial.cost)

    def significance(self, first: Trial, second: Trial) -> float:
        """Return by how many standard deviations the first leaves more than the second, if both were alike.

        Profiles of one root, or of one view, are not independent: their sums scatter about nothing. It is never more
        than the root of their number.
        """
        return self._over_scatter(first.loss - second.loss, 0.0)

    def behind(self, first: Trial, second: Trial) -> float:
        """Return by how many standard errors the first leaves more than the second.

        What scatters is how far the sums of each root and each view lie from their share of the whole.
        """
        difference = first.loss - second.loss
        return self._over_scatter(difference, float(difference.sum() / max(self.lone.sum(), 1)))

    def _over_scatter(self, difference: Array, typical: float) -> float:
        """Return a sum over roots and views over its standard deviation, from scatter about a typical profile's."""
        apart = difference - typical * self.lone
        by_root, by_view = np.bincount(self.nodes.owner, weights=apart.sum(axis=0)), difference.sum(axis=1)
        expected = difference.sum() * self.lone.sum(axis=1) / max(self.lone.sum(), 1)
        sigma = float(np.sqrt(np.square(by_root).sum() + np.square(by_view - expected).sum()))
        return float(difference.sum()) / max(sigma, 1e-12)

    def _guess(self, mu_per_mm: float | None) -> Tubes:
        """Return the tubes of the nearest trial, with radii that absorb as much light from the side."""
        known = [*self.made.values(), self.start]
        near = min(known, key=lambda trial: abs(np.log((trial.mu_per_mm or _OPAQUE) / (mu_per_mm or _OPAQUE))))
        return scaled(near.tubes, self.organ, near.mu_per_mm, mu_per_mm, self.light.hairs)


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
