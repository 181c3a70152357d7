"""Compare the traits of a result with the truth, each by the same definition and code."""

from dataclasses import dataclass
from typing import Any

from rhizotwin.scenes.trait_table import DEFINITIONS, HISTOGRAMS, format_number
from rhizotwin.scenes.traits import Traits


@dataclass(frozen=True, kw_only=True)
class TraitScore:
    """One trait, found and true."""

    found: Any
    """A number, a list for a histogram, None where it is not known."""
    true: Any
    unit: str
    error: float | None
    """found / true - 1; of angles the difference in degrees; of histograms the share of the true length that lies in
    other bins."""
    error_unit: str
    """1 or deg."""

    def text(self) -> str:
        """Return the error for people."""
        if self.error is None:
            return "-"
        return f"{self.error:+.2f} deg" if self.error_unit == "deg" else f"{100.0 * self.error:+.2f} %"


def compare_traits(found: Traits, true: Traits) -> dict[str, TraitScore]:
    """Return the score of each trait by its name; those of a mass are left out, the truth has none."""
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
        scores[h.name] = TraitScore(found=bins, true=right, unit="mm", error=_misplaced(bins, right), error_unit="1")
    return scores


def rows(scores: dict[str, TraitScore]) -> list[tuple[str, str]]:
    """Return a line for each trait that is known of both."""
    lines = []
    for name, score in scores.items():
        if score.error is None:
            continue
        if isinstance(score.found, list):
            lines.append((f"  {name}", f"{100.0 * score.error:.2f} % of the length in other bins"))
        else:
            unit = f" {score.unit}" if score.unit else ""
            lines.append((f"  {name}", f"{format_number(score.found)}{unit}, true {format_number(score.true)}{unit}: {score.text()}"))
    return lines


def _misplaced(found: list[float], true: list[float]) -> float | None:
    """Return half the sum of the bins' differences over the true length.

    0 where all agree, 1 where none of an equal length does.
    """
    if not found or not true:
        return None
    count = max(len(found), len(true))
    pairs = zip(found + [0.0] * (count - len(found)), true + [0.0] * (count - len(true)), strict=True)
    return 0.5 * sum(abs(a - b) for a, b in pairs) / sum(true)
