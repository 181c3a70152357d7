"""Uncertainty of total length, tips and mean diameter, from a comparison of the rendered roots with the pictures.

`root_residual` measures what is missing and surplus in each picture. Roots that share a path appear as one line in all
pictures, and their shared length is taken from the roots. Roots that overlap in few views, or that are closer together
than the pictures resolve, may be merged, with nothing missing in any picture; the overlap of the projected roots
predicts how many, and `bundles` how much length is merged where roots spread from one place.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.settings import TrustSettings
from rhizotwin.recon.uncertainty import bundles, checks, root_residual
from rhizotwin.recon.uncertainty.budget import NINETY
from rhizotwin.recon.uncertainty.calibration import NOT_CALIBRATED, Calibration
from rhizotwin.recon.uncertainty.checks import Estimate
from rhizotwin.recon.uncertainty.root_residual import Residual
from rhizotwin.scenes import rsml
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.traced_roots import merge_shared_stretches

VIEWS = 16
"""Number of pictures that are compared; carving orders them so that neighbours are spread over the turn. More pictures
change the means by less than their standard error."""
_MODEL = {"total_length_mm": 0.035, "tips": 0.1, "mean_diameter_mm": 0.03}
"""Relative 90 % half-widths of errors that the comparison does not show: lines that begin inside thick parents,
undulation along the line of sight, and ends between pixels. They hold for nine in ten random scans in which the
pictures show no difference (docs/intervals.md)."""
_THIN_PX, _MUCH_THIN = 0.5, 0.15
"""Width in pixels below which a root is hardly above noise, and maximum fraction of the length below it; with more,
further roots may be missing. Scans with at most 3 % had length errors within 2 %, one with 47 % lost a fifth, one with
54 % a half (docs/log/reliability.md)."""
_LEVEL = np.pi / 2.0
"""Factor for horizontal roots: over a turn, their line in the picture has on average 2 / pi of their length, so that
missing or surplus length may be this much larger."""
_CROWDED, _SEPARABLE = 20.0, 0.005
"""Two numbers for roots that are merged into thicker ones, where many overlap in few views: the relative length and
volume for an overlap of 1 per view, and the overlap per view up to which all roots are separated. In random scans with
12 to 60 views (docs/intervals.md), a radish had 7, 16 and 11 % too much volume, and 16, 31 and 22 % too little length,
at 0.011, 0.016 and 0.017 per view. At 0.0044, length and volume were right to 1 and 4 %."""
_FILLED, _OPEN = 0.14, 3.0
"""The same for roots between which the views leave no gaps, however many views there are: the relative volume for each
unit of the ratio between hull and shape, and the ratio up to which all roots are separated. Eight dense radishes with
16 to 44 views had -4 to +7 % up to a ratio of 4.6, +18 and +34 % at 5.2 and 5.3, and +63 and +34 % at 5.9 and 6.1."""
_DENSE, _RESOLVED = 1.2, 0.4
"""The same for roots that are closer together than the pictures resolve, however many views there are: the relative
length for a crowding of 1 (`root_residual.Places.crowding`), and the crowding up to which all roots are separated
(docs/decisions/volume-interval.md)."""
_OF_FLAT = 8.0
"""Maximum ratio of the length that may be missing, because roots side by side appear as one flat root, to the fraction
of the volume by which flat roots may be too large. Two touching roots have a ratio of 4. In 40 reconstructions of
radishes, the length lacked at most 7.4 times this fraction (docs/decisions/volume-interval.md)."""
_HALF_HIDDEN = (0.5, 0.75)
"""Fractions of the views in which thick roots hide a part of a thin root that is usually found nevertheless. Parts that
are hidden in more views are usually not found. As many of them are expected as of the former (docs/intervals.md)."""
WIDEST = TrustSettings.widest
"""Maximum relative half-width of an interval for a trusted number: the default of the volume, whatever its setting."""
LEAST_VIEWS = 4
"""Minimum number of pictures that show the roots, to estimate the scatter."""


@dataclass(frozen=True, kw_only=True)
class Known:
    """Facts about a scan that the comparison of its roots with the pictures does not show."""

    lost: Sequence[str] = ()
    """Reasons for which the scan as a whole is not trusted; empty if it is."""
    hull: float = 1.0
    """Volume of the visual hull relative to that of the shape."""
    nodules: Sequence[Root] = ()
    """Nodules and other swellings, which the pictures show beside the roots."""
    flat: float = 0.0
    """Fraction of the volume by which flat roots may be too large, if they are two roots side by side."""
    hidden_mm: float = 0.0
    """Maximum length of the roots that the net pot hides, mm (`hidden_top`)."""
    scattered: float = 0.0
    """Fraction of light that is scattered around roots. The cross-sections of thin roots lose this fraction
    (`scattered_light.scattered_term`), and their diameters half of it."""


def estimates(
    roots: Sequence[Root],
    bank: ViewBank,
    silhouettes: Sequence[Silhouette],
    drawn: NDArray[np.float32],
    *,
    known: Known = Known(),
    calibration: Calibration = NOT_CALIBRATED,
) -> tuple[Estimate, ...]:
    """Compare roots with the pictures.

    Parameters
    ----------
    roots : sequence of Root
        Reconstructed roots; without roots there is no estimate.
    bank, silhouettes : ViewBank, (V,) Silhouette
        All views, neighbours spread over the turn.
    drawn : (V, H, W) float32 array
        Coverage by the rendered roots in these views. Solids and masked pixels are covered.
    known : Known
        Facts that the comparison does not show; by default, there are none.
    calibration : Calibration, optional
        Calibration of the scan's intervals.

    Returns
    -------
    tuple of Estimate
        Estimates of length, tips and mean diameter.
    """
    if not roots:
        return ()
    count = min(VIEWS, bank.count)
    places = root_residual.Places.project([*roots, *known.nodules], bank.select(range(count)))
    lost = (*known.lost, *_thin_objections(places.thin_share(_THIN_PX)))
    views = [
        root_residual.compare(s, picture, places, k) for k, (s, picture) in enumerate(zip(silhouettes[:count], drawn[:count], strict=True))
    ]
    residuals = [view for view in views if view is not None]
    shape = silhouettes[0].coverage.shape
    merged, hidden = _merged_length(places, shape, bank.count, known.hull), _hidden_length(places, shape)
    lacking = {
        f"many roots overlap, so that {100.0 * merged:.0f} % of them may be merged (take more pictures, or larger ones)": merged,
        f"thick roots hide about {100.0 * hidden:.0f} % of the thin roots in most pictures (add a ring that looks from above)": hidden,
    }
    bundled = bundles.bundled_length_mm(roots, places.px_a_mm) / max(rsml.length_mm(roots), 1e-9)
    flat = _OF_FLAT * known.flat
    paired = max(0.0, flat - merged - bundled)  # all three are roots that are not separated
    unseparated = {
        f"roots spread from common points, where {100.0 * bundled:.0f} % of the length may be hidden (take larger pictures)": bundled,
        f"roots appear flat, so that {100.0 * flat:.0f} % of the length may be hidden in pairs (take larger pictures)": paired,
    }
    changes = _changes(roots, residuals, lacking=lacking, bundled=unseparated, known=known)
    factors = {name: calibration.factor(name) for name in changes}
    return tuple(_estimate(name, change, lost, factor=factors[name]) for name, change in changes.items())


def _changes(
    roots: Sequence[Root], residuals: Sequence[Residual], *, lacking: Mapping[str, float], bundled: Mapping[str, float], known: Known
) -> dict[str, _Change]:
    """Return the changes that the pictures suggest, keyed by the name of the trait.

    Parameters
    ----------
    residuals : sequence of Residual
        Differences between the pictures and the rendered roots.
    lacking, bundled : mapping
        Fractions of the roots, and of their length alone, that may be missing, keyed by the cause.
    known : Known
        Hidden roots, which add to the length, and scattered light.
    """
    length_mm = rsml.length_mm(roots)
    shared = (length_mm - rsml.length_mm(merge_shared_stretches(roots)[0])) / max(length_mm, 1e-9)
    along, darker = {**lacking, **bundled}, known.scattered
    above = {f"the net pot may hide up to {known.hidden_mm:.0f} mm": known.hidden_mm / max(length_mm, 1e-9)}
    missing, missing_length, width = sum(lacking.values()), sum(along.values()), [view.width for view in residuals]
    wider = _mean_of(width)
    top = _diameter_of_tops(roots)
    tops = {f"the pictures do not show where thick roots begin, which is {100.0 * top:.0f} % of the mean diameter": top}
    less_wide, more_wide = max(0.0, -wider) + missing_length + 0.5 * max(0.0, -darker) + top, max(0.0, wider) + 0.5 * max(0.0, darker)
    longer = [_LEVEL * view.missing + missing_length + sum(above.values()) for view in residuals]
    shorter = [_LEVEL * view.surplus + shared for view in residuals]
    tips = float(sum(root.tip_seen for root in roots))
    ends = {f"{len(known.nodules)} nodules or other swellings may hide that roots continue": len(known.nodules) / max(tips, 1.0)}
    more_tips = [view.missing_tips + missing for view in residuals]
    less_tips = [view.surplus_tips + sum(ends.values()) for view in residuals]
    return {
        "total_length_mm": _Change(length_mm, shorter, longer, {**along, **above}),
        "tips": _Change(tips, less_tips, more_tips, lacking, surplus=ends),
        "mean_diameter_mm": _Change(rsml.mean_diameter_mm(roots), [less_wide], [more_wide], along, surplus=tops, scatter=width),
    }


def _diameter_of_tops(roots: Sequence[Root]) -> float:
    """Return the fraction by which the mean diameter is smaller if main roots begin one radius below their visible top.

    The end of a thick root may be round or cut, so that its centre line begins anywhere between.
    """
    length_mm, mean_mm = rsml.length_mm(roots), rsml.mean_diameter_mm(roots)
    main = [root for root in roots if root.parent < 0]
    tops_mm = np.array([min(0.5 * root.diameters_mm[0], 0.5 * rsml.length_mm([root])) for root in main])
    rest_mm2 = length_mm * mean_mm - float(tops_mm @ [root.diameters_mm[0] for root in main])
    return max(0.0, 1.0 - rest_mm2 / max((length_mm - float(tops_mm.sum())) * mean_mm, 1e-9))


def _thin_objections(thin: float) -> tuple[str, ...]:
    """Return why roots with a fraction ``thin`` of very thin length are not trusted. The tuple is empty if they are."""
    if thin <= _MUCH_THIN:
        return ()
    return (f"{100.0 * thin:.0f} % of the length is thinner than half a pixel, and more may be missing (use a higher resolution)",)


def merged_volume(roots: Sequence[Root], bank: ViewBank, shape: tuple[int, ...], hull: float) -> tuple[float, float]:
    """Return the fractions of the volume that may be surplus and missing where roots are merged.

    Roots that are merged into a thicker one cover the same area, and have less volume. Roots that are thinner than half
    a pixel are not merged but lost: the coverage of several in a pixel does not show how many there are. As much of
    their volume may be missing as of the length.

    Parameters
    ----------
    shape : tuple of int
        Shape (H, W) of the pictures.
    hull : float
        Volume of the visual hull relative to that of the shape.
    """
    if not roots:
        return 0.0, 0.0
    places = root_residual.Places.project(roots, bank.select(range(min(VIEWS, bank.count))))
    less, lost = (merged(places, shape, bank.count, hull) for merged in (_merged, _merged_length))
    return less, lost * places.thin_share(_THIN_PX, power=2)


def _merged(places: root_residual.Places, shape: tuple[int, ...], views: int, hull: float) -> float:
    """Return the fraction of the roots that may be merged into thicker ones.

    They are merged because many overlap in few views, or because the views show no gaps between them, so that the hull
    is much larger than the roots.
    """
    overlap = _mean_of([places.overlap(view, shape) for view in range(len(places.px))])
    return max(_CROWDED * max(0.0, overlap / views - _SEPARABLE), _FILLED * max(0.0, hull - _OPEN))


def _merged_length(places: root_residual.Places, shape: tuple[int, ...], views: int, hull: float) -> float:
    """Return the fraction of the length that may be merged, in few views or because adjacent roots are not resolved."""
    crowding = _mean_of([places.crowding(view, shape) for view in range(len(places.px))])
    return _merged(places, shape, views, hull) + _DENSE * max(0.0, crowding - _RESOLVED)


def _hidden_length(places: root_residual.Places, shape: tuple[int, ...]) -> float:
    """Return the length of thin roots that thick ones may hide in most views, relative to the length of all roots."""
    thin, share = places.hidden_share(shape)
    half = thin & (share >= _HALF_HIDDEN[0]) & (share < _HALF_HIDDEN[1])
    return float(places.step_mm[half].sum()) / max(float(places.step_mm.sum()), 1e-9)


def _mean_of(values: Sequence[float]) -> float:
    return float(np.mean(values)) if len(values) else 0.0


@dataclass(frozen=True)
class _Change:
    """Value of a trait, and relative changes that the pictures suggest."""

    value: float
    less: Sequence[float]
    """Amount by which the trait may be smaller, by picture."""
    more: Sequence[float]
    """Amount by which the trait may be larger, by picture."""
    lacking: Mapping[str, float]
    """Fractions of the trait that may be missing, which are included, by cause."""
    surplus: Mapping[str, float] = field(default_factory=dict)
    """Fractions of the trait that may not be there, which are included, by cause."""
    scatter: Sequence[float] | None = None
    """Changes whose standard error is used; ``more`` minus ``less`` for None."""

    @property
    def error(self) -> float:
        """90 % half-width of the mean change."""
        changes = np.subtract(self.more, self.less) if self.scatter is None else np.asarray(self.scatter)
        return NINETY * float(np.std(changes, ddof=1)) / len(changes) ** 0.5 if len(changes) >= LEAST_VIEWS else WIDEST


def _estimate(name: str, change: _Change, lost: Sequence[str], *, factor: float) -> Estimate:
    """Convert relative changes in each picture to an interval: means on their sides, scatter and model error on both.

    The limits of a number of tips are whole numbers.

    Parameters
    ----------
    name : str
        Name of the trait.
    change : _Change
        Value, and changes that the pictures suggest.
    lost : sequence of str
        Reasons for which the scan as a whole is not trusted.
    factor : float
        Factor of the calibration on both half-widths.
    """
    value, error, lacking = change.value, change.error, sum(change.lacking.values())
    under, over = _mean_of(change.less), _mean_of(change.more)
    less, more = (factor * math.hypot(error, _MODEL[name], side) for side in (under, over))
    low, high = max(0.0, value * (1.0 - less)), value * (1.0 + more)
    if name == "tips":
        low, high = math.floor(low), math.ceil(high)
    reasons = list(lost)
    if max(less, more) > WIDEST:
        causes = {
            **change.lacking,
            **change.surplus,
            f"the pictures show {100.0 * over:.0f} % more than the reconstructed roots": over - lacking,
            f"the pictures show {100.0 * under:.0f} % less than the reconstructed roots": under - sum(change.surplus.values()),
            f"the pictures disagree by {100.0 * error:.0f} %": error,
        }
        reasons.append(max(causes, key=causes.__getitem__))
    words = _WORDS[name]
    verdict = f"{words} not reliable: {'; '.join(reasons)}" if reasons else f"{words} between {low:.3g} and {high:.3g} with 90 % confidence"
    return Estimate(name=name, value=value, interval=(low, high), trusted=not reasons, verdict=verdict.removeprefix(checks.NO_VOLUME))


_WORDS = {
    "total_length_mm": "the total length (mm) is",
    "tips": "the number of tips is",
    "mean_diameter_mm": "the mean diameter (mm) is",
}
