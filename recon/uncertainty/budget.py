"""Error budget of a volume: terms, 90 % interval and verdict.

Every term is a 90 % half-width below and above the stated volume, measured on the scan itself. The terms have different
causes and add up in quadrature, separately for each side; a calibration scales the result. A one-sided term (an
undetected root only makes the volume larger) has an expected value of half its width: that half is added linearly, and
only the other half is random (GUM, JCGM 100:2008, F.2.4.5, of a bias that is not corrected). A single term therefore
contributes its full width. Hidden parts of roots are expected in full.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from rhizotwin.recon.settings import TrustSettings
from rhizotwin.recon.uncertainty import checks
from rhizotwin.recon.uncertainty.calibration import NOT_CALIBRATED, Calibration
from rhizotwin.scenes.formatting import interval_ml

NINETY = 1.645
"""Half-width of the 90 % interval of a normal distribution, in standard deviations."""


PROPORTIONAL = ("scale", "water", "canister")
"""Terms that change all parts of a volume by the same factor."""
_EXPECTED = "occluded"
"""One-sided term whose full width is expected: roots do not end behind the net pot, but continue up to its grid."""


@dataclass(frozen=True, kw_only=True)
class Term:
    """One cause of uncertainty."""

    name: str
    less_mm3: float
    """Amount by which the true volume may be smaller for this cause."""
    more_mm3: float
    why: str
    """Description of this cause of uncertainty."""

    @staticmethod
    def symmetric(name: str, half_mm3: float, why: str) -> Term:
        """Return a term of equal width on both sides."""
        return Term(name=name, less_mm3=half_mm3, more_mm3=half_mm3, why=why)


@dataclass(frozen=True, kw_only=True)
class Volume:
    """A volume with its uncertainty."""

    mm3: float
    interval_mm3: tuple[float, float]
    """90 % interval."""
    bounds_mm3: tuple[float, float]
    """Smallest and largest volume that the silhouettes allow."""
    trusted: bool
    """Whether the volume is trusted."""
    verdict: str
    """Reliability of the volume, in one sentence."""
    terms: tuple[Term, ...]
    """Causes of uncertainty."""
    calibration: Calibration = NOT_CALIBRATED
    """Calibration of the scan's intervals."""

    def distrust(self, reasons: Sequence[str]) -> Volume:
        """Return the same volume, not trusted for additional reasons."""
        before = "" if self.trusted else self.verdict.removeprefix(checks.NO_VOLUME)
        return replace(self, trusted=False, verdict=checks.verdict([*([before] if before else []), *reasons]))


@dataclass(frozen=True, kw_only=True)
class Budget:
    """Error budget of a volume."""

    volume_mm3: float
    terms: tuple[Term, ...]
    views: int
    trust: TrustSettings = field(default_factory=TrustSettings)
    """Limits for the volume to be trusted."""
    calibration: Calibration = NOT_CALIBRATED
    """Calibration of the scan's intervals."""

    @property
    def interval_mm3(self) -> tuple[float, float]:
        """Return the 90 % interval."""
        less = _reach([(term.name, term.less_mm3, term.more_mm3) for term in self.terms])
        more = _reach([(term.name, term.more_mm3, term.less_mm3) for term in self.terms])
        factor = self.calibration.factor("volume_mm3")
        return max(0.0, self.volume_mm3 - factor * less), self.volume_mm3 + factor * more

    @property
    def objections(self) -> tuple[str, ...]:
        """Return the reasons for which the volume is not trusted; empty if it is."""
        if not self.terms:
            return ("this method gives no uncertainty, so that its volume has no interval",)
        (low, high), trust, found = self.interval_mm3, self.trust, []
        if self.views < trust.least_views:
            found.append(f"only {self.views} views were used, and false roots cannot be ruled out with fewer than {trust.least_views}")
        # also true if an end is not a number
        under, over = (not reach <= trust.widest * self.volume_mm3 for reach in (self.volume_mm3 - low, high - self.volume_mm3))
        if under or over:
            worst = max(self.terms, key=lambda term: max(under * term.less_mm3, over * term.more_mm3))
            found.append(
                f"the 90 % interval, {interval_ml(low, high)}, extends more than {100.0 * trust.widest:.0f} % to one side, "
                f"mainly for this reason: {worst.why}"
            )
        return tuple(found)

    @property
    def verdict(self) -> str:
        """Return the reliability of the volume, in one sentence."""
        if self.objections:
            return checks.verdict(self.objections)
        low, high = self.interval_mm3
        return f"with 90 % confidence the true volume is {interval_ml(low, high)}"

    def volume(self, bounds_mm3: tuple[float, float]) -> Volume:
        """Return the volume with its interval and verdict."""
        return Volume(
            mm3=self.volume_mm3,
            interval_mm3=self.interval_mm3,
            bounds_mm3=bounds_mm3,
            trusted=not self.objections,
            verdict=self.verdict,
            terms=self.terms,
            calibration=self.calibration,
        )


def part_interval(
    terms: Sequence[Term], *, whole_mm3: float, part_mm3: float, calibration: Calibration = NOT_CALIBRATED
) -> tuple[float, float]:
    """Return the 90 % interval of a part of a volume, mm3.

    Terms in `PROPORTIONAL` count by the share of the part. All others count in full, as the whole uncertainty may
    concern this part: roots that were missed may all belong to one plant.

    Parameters
    ----------
    terms : sequence of Term
        Error budget of the whole volume.
    whole_mm3, part_mm3 : float
        Whole volume, and volume of the part.
    calibration : Calibration, optional
        Calibration of the scan's intervals.
    """
    share = part_mm3 / whole_mm3
    own = [
        replace(term, less_mm3=share * term.less_mm3, more_mm3=share * term.more_mm3) if term.name in PROPORTIONAL else term
        for term in terms
    ]
    return Budget(volume_mm3=part_mm3, terms=tuple(own), views=0, calibration=calibration).interval_mm3


def _reach(terms: Sequence[tuple[str, float, float]]) -> float:
    """Return the combined half-width on one side, from names and half-widths on this side and on the other."""
    expected = [(1.0 if name == _EXPECTED else 0.5) * max(this - other, 0.0) for name, this, other in terms]
    return math.fsum(expected) + math.hypot(*(this - bias for (_, this, _), bias in zip(terms, expected, strict=True)))
