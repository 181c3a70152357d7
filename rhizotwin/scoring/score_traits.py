"""Comparison of the traits of a result with the true traits."""

from dataclasses import dataclass
from typing import Any

from rhizotwin.scenes.trait_table import DEFINITIONS, HISTOGRAMS, format_number
from rhizotwin.scenes.traits import Traits


@dataclass(frozen=True, kw_only=True)
class TraitScore:
    """Error of a trait."""

    found: Any
    """Value of the result: a number, a list for a histogram, or None if unknown."""
    true: Any
    """True value, of the same type."""
    unit: str
    """Unit of both values."""
    error: float | None
    """Relative error (found / true - 1). For an angle it is the difference in degrees, and for a histogram the fraction
    of the length in wrong bins. It is None if the trait is unknown in the result or in the truth."""
    error_unit: str
    """Unit of the error: ``deg`` for an angle, otherwise ``1``."""

    def text(self) -> str:
        """Format the error with its unit."""
        if self.error is None:
            return "-"
        return f"{self.error:+.2f} deg" if self.error_unit == "deg" else f"{100.0 * self.error:+.2f} %"


def compare_traits(found: Traits, true: Traits) -> dict[str, TraitScore]:
    """Return the errors of all traits that do not need the mass of the roots, keyed by trait name."""
    scores = {}
    for d in DEFINITIONS:
        a, b = getattr(found, d.field), getattr(true, d.field)
        if d.field in ("specific_root_length_m_per_g", "tissue_density_g_per_ml"):
            continue
        angle = d.unit == "deg"
        error = None if a is None or b is None or (not angle and not b) else float(a - b) if angle else float(a / b - 1.0)
        scores[d.name] = TraitScore(found=a, true=b, unit=d.unit, error=error, error_unit="deg" if angle else "1")
    for h in HISTOGRAMS:
        bins, right = list(getattr(found, h.field)), list(getattr(true, h.field))
        scores[h.name] = TraitScore(found=bins, true=right, unit="mm", error=_wrong_bin_fraction(bins, right), error_unit="1")
    return scores


def rows(scores: dict[str, TraitScore]) -> list[tuple[str, str]]:
    """Return the table rows (name, text) for all traits that are known in both the result and the truth."""
    lines = []
    for name, score in scores.items():
        if score.error is None:
            continue
        if isinstance(score.found, list):
            lines.append((f"  {name}", f"{100.0 * score.error:.2f} % of the length in wrong bins"))
        else:
            unit = f" {score.unit}" if score.unit else ""
            lines.append((f"  {name}", f"{format_number(score.found)}{unit}, true {format_number(score.true)}{unit}: {score.text()}"))
    return lines


def _wrong_bin_fraction(found: list[float], true: list[float]) -> float | None:
    """Return the fraction of the length in a histogram that is in wrong bins.

    It is half the sum of the absolute differences between found and true bins, divided by the true length. It is None
    if a histogram is empty.
    """
    if not found or not true:
        return None
    count = max(len(found), len(true))
    pairs = zip(found + [0.0] * (count - len(found)), true + [0.0] * (count - len(true)), strict=True)
    return 0.5 * sum(abs(a - b) for a, b in pairs) / sum(true)
