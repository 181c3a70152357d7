"""Calibration of intervals by split conformal prediction, and their coverage on the scans that were not used for it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import beta, norm

from benchmarks.intervals_table import TRAITS, ratios

Factors = Mapping[str, Mapping[str, float]]
"""Factors on half-widths by regime and trait."""
CONFIDENCE = 0.9
"""Nominal coverage of the intervals."""
LEAST_SCANS = 10
"""Minimum number of calibration scans of a regime. With fewer than 9 scans, no finite factor has the nominal
coverage."""
WRONG = 0.04
"""Relative error from which a volume counts as wrong."""
GEOMETRIC = ("wide_interval",)
"""Reason codes that follow from the interval, and not from a check of the scan."""


def is_first_half(table: pd.DataFrame) -> pd.Series:
    """Return which scans belong to the first half: every other block of six scans, so that both have all profiles."""
    return (table["number"] // 6) % 2 == 0


def is_reliable(table: pd.DataFrame, trait: str, widest: float) -> pd.Series:
    """Return in which scans a trait is reliable: no check refuses it, and its interval is not too wide.

    Parameters
    ----------
    table : DataFrame
        Scans with intervals without calibration.
    trait : str
        One of `TRAITS`.
    widest : float
        Maximum relative half-width of the interval of a reliable trait.
    """
    return _passes_checks(table, trait, widest) & ~_is_wide(table, trait, widest)


def calibrate(table: pd.DataFrame, *, widest: float) -> Factors:
    """Return the factor on the half-widths by regime and trait.

    Parameters
    ----------
    table : DataFrame
        Calibration scans (`benchmarks.intervals_table`). Only traits that are reliable without calibration are used.
    widest : float
        Maximum relative half-width of the interval of a reliable trait.

    Returns
    -------
    dict of dict of float
        Factors by regime and trait. A factor is 1 if the coverage without it is not significantly lower than
        `CONFIDENCE`: otherwise the scatter of the factor would be larger than the correction. Intervals are not
        narrowed, since real scans may have disturbances that the simulated ones lack. Regimes with fewer than
        `LEAST_SCANS` reliable scans are missing.
    """
    found: dict[str, dict[str, float]] = {}
    for trait in TRAITS:
        ratio = ratios(table, trait).abs()
        for regime, some in ratio[is_reliable(table, trait, widest) & ratio.notna()].groupby(table["regime"]):
            if len(some) >= LEAST_SCANS:
                _, high = binomial_band(int((some <= 1.0).sum()), len(some))
                factor = max(1.0, conformal_quantile(some.to_numpy())) if high < CONFIDENCE else 1.0
                found.setdefault(str(regime), {})[trait] = float(f"{factor:.3g}")
    return found


def conformal_quantile(scores: NDArray[np.float64]) -> float:
    """Return the score (N,) that a further one does not exceed with probability `CONFIDENCE` (Lei et al. 2018).

    It is the ceil((N + 1) `CONFIDENCE`)-th smallest, and the largest if N is too small for that.
    """
    rank = math.ceil((len(scores) + 1) * CONFIDENCE)
    return float(np.sort(scores)[min(rank, len(scores)) - 1])


def apply(table: pd.DataFrame, factors: Factors, *, widest: float) -> pd.DataFrame:
    """Return a table with calibrated intervals, and with the reliability that follows from them.

    Parameters
    ----------
    table : DataFrame
        Scans with intervals without calibration.
    factors : dict of dict of float
        Result of `calibrate`.
    widest : float
        Maximum relative half-width of the interval of a reliable trait.
    """
    made = table.copy()
    for trait in TRAITS:
        value, low, high = (table[f"{trait}.{name}"] for name in ("value", "low", "high"))
        factor = table["regime"].map({regime: own.get(trait, 1.0) for regime, own in factors.items()}).astype(float).fillna(1.0)
        made[f"{trait}.low"] = (value - factor * (value - low)).clip(lower=0.0)
        made[f"{trait}.high"] = value + factor * (high - value)
        made[f"{trait}.reliable"] = _passes_checks(table, trait, widest) & ~_is_wide(made, trait, widest)
    return made


def _passes_checks(table: pd.DataFrame, trait: str, widest: float) -> pd.Series:
    """Return in which scans no check refuses a trait, whatever the width of its interval, see `is_reliable`."""
    codes = table["reasons"].fillna("").str.split()
    passes = codes.map(lambda found: all(code in GEOMETRIC or code.startswith("high_") for code in found))
    if trait != "volume_mm3":
        passes &= table[f"{trait}.reliable"].astype("boolean").fillna(False) | _is_wide(table, trait, widest)
    return passes.astype(bool) & table["regime"].notna()


def _is_wide(table: pd.DataFrame, trait: str, widest: float) -> pd.Series:
    """Return which intervals are too wide for a reliable trait, see `is_reliable`."""
    value, low, high = (table[f"{trait}.{name}"] for name in ("value", "low", "high"))
    return np.maximum(value - low, high - value) > widest * value


def cross_apply(table: pd.DataFrame, *, widest: float) -> pd.DataFrame:
    """Return a table in which each half of the scans has intervals calibrated on the other half."""
    first = is_first_half(table)
    halves = [apply(table[mine], calibrate(table[~mine], widest=widest), widest=widest) for mine in (first, ~first)]
    return pd.concat(halves).sort_values("number", ignore_index=True)


def holds(table: pd.DataFrame, trait: str) -> pd.Series:
    """Return which intervals contain the truth."""
    return table[f"{trait}.true"].between(table[f"{trait}.low"], table[f"{trait}.high"])


def interval_score(table: pd.DataFrame, trait: str) -> pd.Series:
    """Return the interval score relative to the truth (Gneiting and Raftery 2007, eq. 43): width plus penalties."""
    true, low, high = (table[f"{trait}.{name}"] for name in ("true", "low", "high"))
    penalty = 2.0 / (1.0 - CONFIDENCE) * ((low - true).clip(lower=0.0) + (true - high).clip(lower=0.0))
    return (high - low + penalty) / true


def probability_integral(table: pd.DataFrame, trait: str) -> pd.Series:
    """Return the probability of a value below the truth, for normal distributions with the half-widths of each side."""
    return pd.Series(norm.cdf(norm.ppf(0.5 + 0.5 * CONFIDENCE) * ratios(table, trait)), index=table.index)


def binomial_band(held: int, count: int) -> tuple[float, float]:
    """Return the 90 % confidence interval of a fraction (Clopper and Pearson 1934)."""
    low = float(beta.ppf(0.05, held, count - held + 1)) if held else 0.0
    high = float(beta.ppf(0.95, held + 1, count - held)) if held < count else 1.0
    return low, high


def coverage(table: pd.DataFrame, trait: str) -> dict[str, Any]:
    """Return the coverage of reliable intervals with its binomial band, their mean score and their relative width."""
    some = table[table[f"{trait}.reliable"].astype(bool) & table[f"{trait}.true"].notna()]
    held, count = int(holds(some, trait).sum()), len(some)
    width = (some[f"{trait}.high"] - some[f"{trait}.low"]) / some[f"{trait}.true"]
    return {
        "scans": count,
        "hold": held,
        "band": binomial_band(held, count) if count else (0.0, 1.0),
        "score": float(interval_score(some, trait).mean()) if count else float("nan"),
        "width": float(width.median()) if count else float("nan"),
    }
