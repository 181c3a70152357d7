"""Table of random scans: one row per scan, with the truth and the intervals of the traits."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from rhizotwin.recon.results import reasons

TRAITS = {"volume_mm3": "volume", "total_length_mm": "total_length", "tips": "tips", "mean_diameter_mm": "mean_diameter"}
"""Calibrated traits, and their names in scores."""
DERIVED = {"depth_mm": "depth", "width_mm": "width", "branch_points": "branch_points", "length_by_order_mm": "length_by_order"}
"""Traits whose intervals follow from those of the calibrated ones, and their names in scores. The last one is the
length of the roots of order `ORDER`."""
ORDER = 1
"""Order of the roots whose length is compared, 1 for the laterals of main roots."""
COLUMNS = ("true", "value", "low", "high", "reliable")
"""Columns of each trait, after its name and a point; ``low`` and ``high`` are the interval without calibration."""


def table_of(records: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """Return one row per scan.

    Parameters
    ----------
    records : sequence of dict
        Records of `benchmarks.intervals.measure`.

    Returns
    -------
    DataFrame
        Properties of the scan (number, profile, family, troubles, picture width, number of views in each ring),
        ``error`` of a failed scan, ``regime``, ``reasons`` (codes, for a volume that is not reliable), recall and
        precision of roots and tips, processor seconds, and the `COLUMNS` of every trait. The intervals of `DERIVED`
        are those that the result states.
    """
    return pd.DataFrame([_row(record) for record in records]).sort_values("number", ignore_index=True)


def derived_intervals(folder: Path) -> dict[str, dict[str, Any]]:
    """Return value, interval and verdict of the traits in `DERIVED`, as stated in a result folder."""
    stated = json.loads((folder / "traits.json").read_text(encoding="utf-8"))
    rows = {row["name"]: row for row in stated["traits"]}
    for histogram in stated["histograms"]:
        for one in histogram["bins"]:
            if histogram["name"] in DERIVED and one["from"] == ORDER:
                rows[histogram["name"]] = one
    return {trait: {key: rows[trait][key] for key in ("value", "low", "high", "verdict")} for trait in DERIVED if trait in rows}


def read(path: Path) -> pd.DataFrame:
    """Read a table that was written as CSV."""
    return pd.read_csv(path, keep_default_na=False, na_values=[""], dtype={"troubles": "string", "reasons": "string", "regime": "str"})


def failures(table: pd.DataFrame) -> list[str]:
    """Return the number and error of each failed scan."""
    if "error" not in table:
        return []
    return [f"scan {row['number']}: {row['error']}" for _, row in table[table["error"].notna()].iterrows()]


def _row(record: dict[str, Any]) -> dict[str, Any]:
    row = {
        "number": record["number"],
        "profile": record["profile"],
        "family": record["family"],
        "troubles": " ".join(record["troubles"]),
        "width_px": record["image_wh"][0],
        "views": "+".join(str(count) for count in record["views"]),
    }
    if "crashed" in record:
        return row | {"error": record["crashed"].strip().splitlines()[-1][:200]}
    score, summary = record["score"], record["summary"]
    calibration = summary.get("calibration") or {}
    roots = score["roots"] or {}
    row |= {
        "regime": calibration.get("regime"),
        "reasons": " ".join(reasons.reasons_for_volume({**summary, "views": [{"used": True}] * sum(record["views"])})),
        **{name: roots.get(name) for name in ("recall", "precision", "tip_recall", "tip_precision")},
        "cpu_s": round(record["cpu_s"], 1),
    }
    found = {
        "volume_mm3": {"value": summary["volume_mm3"], "interval": summary["volume_interval_mm3"], "trusted": summary["volume_trusted"]},
        **{one["name"]: one for one in summary["estimates"]},
    }
    for trait, name in DERIVED.items():
        one, scored = record["derived"].get(trait), score["traits"].get(name)
        if one and scored and one["low"] is not None:
            true = scored["true"]
            numbers = {"true": sum(true[ORDER : ORDER + 1]) if isinstance(true, list) else true, **one}
            row |= {f"{trait}.{key}": float(f"{numbers[key]:.6g}") for key in ("true", "value", "low", "high")}
            row[f"{trait}.reliable"] = one["verdict"] == "reliable"
    for trait, name in TRAITS.items():
        if trait not in found:
            continue
        one, factor = found[trait], calibration.get("factors", {}).get(trait, 1.0)
        value, (low, high) = one["value"], one["interval"]
        true = score["traits"][name]["true"] if name in score["traits"] else None
        true = score["volume_true_mm3"] if trait == "volume_mm3" else true
        numbers = {"true": true, "value": value, "low": value - (value - low) / factor, "high": value + (high - value) / factor}
        row |= {f"{trait}.{key}": None if number is None else float(f"{number:.6g}") for key, number in numbers.items()}
        row[f"{trait}.reliable"] = bool(one["trusted"])
    return row


def ratios(table: pd.DataFrame, trait: str) -> pd.Series:
    """Return the error of a trait relative to the half-width on the side of the truth.

    It is negative where the truth is smaller than the value, and its absolute value at most 1 where the interval holds
    the truth; NaN if the trait is not known.
    """
    value, true = table[f"{trait}.value"], table[f"{trait}.true"]
    less, more = value - table[f"{trait}.low"], table[f"{trait}.high"] - value
    half = np.where(true > value, more, less)
    return (true - value) / np.maximum(half, 1e-9 * np.abs(value).clip(lower=1e-9))
