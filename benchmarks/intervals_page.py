"""Tables and figures of intervals: coverage by regime, reliability diagrams, and right volumes that were refused."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks import conformal
from benchmarks.intervals_table import TRAITS, ratios
from benchmarks.output import markdown
from rhizotwin.recon.uncertainty.calibration import THIN_PX
from rhizotwin.scenes.atomic import write_bytes
from rhizotwin.scenes.figures import figure, png

LABELS = {"volume_mm3": "volume", "total_length_mm": "length", "tips": "tips", "mean_diameter_mm": "mean diameter"}
DERIVED_LABELS = {
    "depth_mm": "depth",
    "width_mm": "width",
    "branch_points": "branch points",
    "length_by_order_mm": "length of first-order laterals",
}
"""Columns of traits with a label in the tables; the derived ones have a table of their own."""
LEVELS = np.linspace(0.05, 0.95, 19)
"""Nominal levels of the reliability diagram."""
CAUSES: Mapping[str, tuple[str, ...]] = {
    "dirty_canister": ("dust", "algae", "floating", "highlight", "seam", "harsh"),
    "inconsistent_views": ("tube", "seat", "sway", "turbidity", "algae", "floating", "seam", "coarse", "harsh"),
    "moving_roots": ("sway",),
    "canister_mismatch": ("tube", "harsh"),
    "poor_markers": ("seat", "harsh"),
    "wrong_exposure": ("highlight",),
    "coarse_pictures": ("coarse",),
    "few_views": ("few",),
    "high_missing_roots": ("coarse", "few", "dust", "algae", "floating", "turbidity", "harsh"),
    "high_translucency": ("glass", "hairs", "harsh"),
    "high_hairs": ("hairs", "harsh"),
    "high_occluded": ("hidden",),
    "high_scattered_light": ("dust", "algae", "floating", "turbidity", "highlight", "seam", "harsh"),
    "high_area": ("coarse", "turbidity", "dust", "algae", "harsh"),
    "high_merged_roots": ("few", "coarse"),
    "high_trimmed_away": ("few",),
}
"""Simulated causes that each reason code names correctly. ``harsh`` is the profile of that name, ``coarse`` roots
thinner than `THIN_PX`, ``few`` fewer than `FEW` views, ``hidden`` the regime of hidden parts."""
WIDTH_MM = 210.0
"""Width of a picture at the canister's axis: 246 mm in air with the camera of the library. The water magnifies 1.33
times across the axis and 1.05 times along it, which is 1.18 times on the geometric mean."""
FEW = 18
"""Number of views below which they are few."""


def page(table: pd.DataFrame, factors: conformal.Factors, *, widest: float) -> str:
    """Return the tables as Markdown.

    Parameters
    ----------
    table : DataFrame
        All scans, with intervals without calibration.
    factors : dict of dict of float
        Factors from all scans, by regime and trait. The coverage is that of cross-validation: each half of the scans
        has the factors of the other half.
    widest : float
        Maximum relative half-width of the interval of a reliable trait.
    """
    table = table[table["volume_mm3.value"].notna()].sort_values("number", ignore_index=True)
    before, after = conformal.apply(table, {}, widest=widest), conformal.cross_apply(table, widest=widest)
    rows = []
    for trait, label in LABELS.items():
        for regime in ("all", *sorted(factors)):
            some = slice(None) if regime == "all" else (table["regime"] == regime).to_numpy()
            new, old = (conformal.coverage(one[some], trait) for one in (after, before))
            factor = "" if regime == "all" else f"{factors[regime].get(trait, 1.0):.2f}"
            low, high = new["band"]
            of_old = f"{_share(old)} of {old['scans']}", f"{old['score']:.3f}"
            widths = f"{100 * low:.0f}-{100 * high:.0f} %", f"{100 * new['width']:.1f} %", f"{new['score']:.3f}"
            rows.append((label, regime, factor, f"{new['scans']}", _share(new), *widths, *of_old))
    titles = "trait | regime | factor | scans | hold | 90 % band | median width | score | uncalibrated: hold | score"
    return "\n".join([markdown(titles, rows), "", _derived(table), "", *_totals(after), ""])


def _derived(table: pd.DataFrame) -> str:
    """Return the table of traits whose intervals follow from those of others."""
    rows = []
    for trait, label in DERIVED_LABELS.items():
        if f"{trait}.true" not in table:  # no scan states it
            continue
        found = conformal.coverage(table[table[f"{trait}.true"].notna()], trait)
        band = "-".join(f"{100 * limit:.0f}" for limit in found["band"])
        rows.append((label, f"{found['scans']}", _share(found), f"{band} %", f"{100 * found['width']:.1f} %", f"{found['score']:.3f}"))
    return markdown("trait | scans | hold | 90 % band | median width | score", rows) if rows else ""


def _share(found: Mapping[str, float]) -> str:
    return f"{100.0 * found['hold'] / found['scans']:.0f} %" if found["scans"] else "-"


def _totals(table: pd.DataFrame) -> list[str]:
    """Return the fractions of wrong volumes that are reliable, and of right volumes that are refused."""
    error = (table["volume_mm3.value"] / table["volume_mm3.true"] - 1.0).abs()
    reliable, right = table["volume_mm3.reliable"].astype(bool), error <= conformal.WRONG
    missed = reliable & ~right & ~conformal.holds(table, "volume_mm3")
    refused = table[right & ~reliable]
    percent = round(100 * conformal.WRONG)
    named = refused[[_names_cause(row) for _, row in refused.iterrows()]] if len(refused) else refused
    return [
        f"- Reliable, more than {percent} % wrong, and the interval misses: {missed.sum()} of {len(table)} scans "
        f"({100 * missed.mean():.1f} %).",
        f"- Right to {percent} %: {right.sum()}; of these, refused: {len(refused)} ({100 * len(refused) / max(right.sum(), 1):.0f} %); "
        f"the reason names a simulated cause in {len(named)} of them ({100 * len(named) / max(len(refused), 1):.0f} %).",
    ]


def _names_cause(row: pd.Series) -> bool:
    """Return whether a reason code names a simulated cause."""
    views = sum(int(count) for count in str(row["views"]).split("+"))
    present = set(str(row["troubles"]).split()) if isinstance(row["troubles"], str) else set()
    width_px = row["mean_diameter_mm.true"] * row["width_px"] / WIDTH_MM
    applies = {"few": views < FEW, "hidden": row["regime"] == "hidden parts", "coarse": width_px < THIN_PX}
    present |= {row["profile"], *(cause for cause, here in applies.items() if here)}
    return any(cause in present for code in str(row["reasons"]).split() for cause in CAUSES.get(code, ()))


def draw(table: pd.DataFrame, path: Path, *, widest: float) -> None:
    """Draw reliability diagrams and histograms of the probability integral transform, by trait and regime.

    Parameters
    ----------
    table : DataFrame
        All scans, with intervals without calibration.
    path : Path
        PNG file to write.
    widest : float
        Maximum relative half-width of the interval of a reliable trait.
    """
    table = table.sort_values("number", ignore_index=True)
    judged = conformal.cross_apply(table, widest=widest)
    drawn = figure(13.0, 6.2)
    axes = drawn.subplots(2, len(TRAITS))
    for column, (trait, label) in enumerate(LABELS.items()):
        diagram, histogram, reliable = axes[0, column], axes[1, column], conformal.is_reliable(table, trait, widest)
        values, names = [], []
        for regime in sorted(judged["regime"].dropna().unique()):
            some = judged[reliable & (judged["regime"] == regime) & ratios(judged, trait).notna()]
            if not len(some):
                continue
            pit = conformal.probability_integral(some, trait)
            observed = [float((np.abs(pit - 0.5) <= 0.5 * level).mean()) for level in LEVELS]
            diagram.plot(LEVELS, observed, marker=".", label=f"{regime} ({len(some)})")
            values.append(pit.to_numpy())
            names.append(regime)
        diagram.plot([0, 1], [0, 1], color="0.5", linewidth=0.8)
        diagram.set_title(label)
        diagram.set_xlabel("nominal level")
        if values:
            histogram.hist(values, bins=np.linspace(0.0, 1.0, 11), stacked=True)
        histogram.set_xlabel("probability integral transform")
        if column == 0:
            diagram.set_ylabel("fraction of intervals that hold the truth")
            histogram.set_ylabel("scans")
            diagram.legend(fontsize=7)
    write_bytes(path, png(drawn, dpi=110))
