"""Text of reports: the verdict on a result, its traits with units and intervals, and the method."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from math import hypot
from typing import Any, Literal

from rhizotwin.recon.uncertainty.calibration import Calibration
from rhizotwin.scenes.assessment import Assessment
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.formatting import count, decimals, interval_ml, ml, round_digits
from rhizotwin.scenes.subject import Subject
from rhizotwin.scenes.trait_table import DEFINITIONS, Definition

Light = Literal["good", "bad"]

SMALLEST_SHARE = 0.05
"""Threshold above which a cause of uncertainty is listed in a report, as a fraction of the largest cause."""
LABELS = {
    "total_length_mm": "Total root length",
    "volume_mm3": "Volume",
    "surface_mm2": "Surface area",
    "mean_diameter_mm": "Mean diameter",
    "median_diameter_mm": "Median diameter",
    "max_diameter_mm": "Largest diameter",
    "depth_mm": "Depth",
    "width_mm": "Width",
    "convex_hull_mm3": "Volume of the convex hull",
    "solidity": "Solidity",
    "max_root_count": "Maximum number of roots at one height",
    "median_root_count": "Median number of roots per height",
    "bushiness": "Bushiness",
    "lower_length_share": "Fraction of the length in the lower two thirds",
    "roots": "Number of roots",
    "tips": "Number of root tips",
    "branch_points": "Number of branch points",
    "branch_distance_mm": "Distance between branch points",
    "lateral_density_per_cm": "Laterals per length of the branched zone",
    "tortuosity": "Tortuosity",
    "angle_to_gravity_deg": "Angle to the vertical",
    "angle_to_parent_deg": "Angle of laterals to their parents",
    "specific_root_length_m_per_g": "Specific root length",
    "tissue_density_g_per_ml": "Tissue density",
}
"""Labels of the traits in reports, keyed by field name of `scenes.traits.Traits`."""
COUNTS = ("max_root_count", "median_root_count", "roots", "tips", "branch_points")
"""Field names of the traits that are displayed as integers."""
IN_ML = ("volume_mm3", "convex_hull_mm3")
"""Field names of the traits that are displayed in ml."""
UNITS = {"mm2": "mm²", "mm3": "ml", "deg": "degrees"}
"""Units in reports, keyed by the unit in files. Units that are the same in both are omitted."""
CAUSES = {
    "area": "Area covered in the pictures",
    "cameras": "Cameras without markers",
    "canister": "Shape of the canister",
    "flat roots": "Roots side by side",
    "hairs": "Root hairs",
    "merged roots": "Roots merged into others",
    "missing roots": "Roots that were not found",
    "occluded": "Hidden by the net pot",
    "outlines": "Position of the outlines",
    "overlapping roots": "Gaps between thick roots",
    "radii, blur": "Blur of the pictures",
    "radii, hidden": "Diameters of hidden roots",
    "radii, residual gradient": "Smoothing of diameters",
    "radii, view against view": "Diameters in different views",
    "scale": "Scale",
    "scattered light": "Scattered light",
    "sections": "Roots that are not round",
    "taproot extrapolated": "Extrapolated taproot",
    "translucency": "Translucency of the roots",
    "trimmed away": "Trimming of the hull",
    "uncertain ends": "Ends that may not be roots",
    "untrimmed hull": "Hull that was not trimmed",
    "views disagree": "Disagreement between views",
    "wall_contact": "Contact with the wall",
    "water": "Refractive index of the water",
}
"""Labels of the causes of a volume's uncertainty, keyed by their names in ``result.json``."""
_PICTURES = (
    "{made} of roots in a round canister of nutrient solution in front of a diffuse backlight: {pictures} images around one rotation."
)
_METHOD = (
    "Camera poses were estimated from a strip of printed markers{by}. Rays were traced through air, acrylic and water in closed form. "
    "The fraction of each pixel that roots cover was measured relative to the empty backlight, a visual hull was carved from these "
    "silhouettes, and {shape}. The 90 % interval of the volume is the root sum of squares of all estimated causes of uncertainty."
)
_BASELINE = (
    "Camera poses were estimated from a strip of printed markers, or given. Rays were traced through air, acrylic and water in closed "
    "form. The shape was reconstructed by {title}, a baseline without an error budget."
)
_RIG = (
    "The rig follows R. Kliman, Design of a robotic platform for plant root imaging and biomass estimation, Georgia Institute of "
    "Technology, 2022."
)


def volume_text(summary: dict[str, Any]) -> tuple[str, str]:
    """Return the volume, ml, and its 90 % interval as text, rounded to the digits that the interval supports."""
    low, high = summary["volume_interval_mm3"]
    half = 0.5 * (high - low)
    return f"{ml(summary['volume_mm3'], half_mm3=half)} ml", interval_ml(low, high)


def headline(summary: dict[str, Any]) -> tuple[str, str]:
    """Return a headline that states the volume, and a line to print below it."""
    found, interval = volume_text(summary)
    if summary["volume_trusted"]:
        return f"volume {found}", f"90 % interval {interval}"
    return "volume could not be determined", f"the reconstructed shape has {found} ({interval}), which is not reliable"


def verdict(summary: dict[str, Any]) -> tuple[str, str]:
    """Return the verdict of a report, such as "8.01 ml" and "90 % between 7.91 and 8.36 ml; reliable"."""
    if summary["volume_trusted"]:
        found, interval = volume_text(summary)
        return found, f"90 % between {interval.replace(' to ', ' and ')}; reliable"
    headline_text, beside = headline(summary)
    return _sentence(headline_text).rstrip("."), _sentence(beside)


def traffic_light(summary: dict[str, Any]) -> tuple[Light, str, list[str]]:
    """Return the state of the light beside the volume, and recommendations with a heading.

    It is good if the volume is reliable, and bad if not.
    """
    checks = [check for check in summary.get("checks") or [] if isinstance(check, dict)]
    bad = [check for check in checks if check.get("state") == "bad"]
    fair = [check for check in checks if check.get("state") == "fair"]
    advice = [" ".join(filter(None, (_sentence(check.get("found")), _sentence(check.get("advice"))))) for check in (*bad, *fair)]
    if not summary["volume_trusted"]:
        return "bad", "Do not use this volume.", advice or [_sentence(str(summary["volume_verdict"]))]
    advice += [_sentence(str(warning)) for warning in summary["warnings"]]
    return "good", count(len(advice), "possible improvement"), advice


@dataclass(frozen=True)
class Cause:
    """Cause of the volume's uncertainty."""

    name: str
    why: str
    """Explanation, as a clause without a full stop."""
    less_mm3: float
    more_mm3: float
    """Amounts by which the volume may be smaller or larger, mm3."""

    @property
    def amount(self) -> str:
        """Both amounts in ml, such as "± 0.06" or "+ 0.3"."""
        less, more = (round_digits(size / 1000.0, 2) for size in (self.less_mm3, self.more_mm3))
        if less == more:
            return f"± {less} ml"
        small = SMALLEST_SHARE * max(self.less_mm3, self.more_mm3)
        return " ".join([f"− {less}"] * (self.less_mm3 >= small) + [f"+ {more}"] * (self.more_mm3 >= small)) + " ml"


def uncertainty_causes(summary: dict[str, Any]) -> list[Cause]:
    """Return the causes of the volume's uncertainty, largest cause first.

    Causes that are much smaller than the largest one are combined as the root of the sum of their squares. The last
    entry is the 90 % interval, which combines all causes.
    """
    terms = sorted(summary["volume_budget"], key=lambda term: -max(term["less_mm3"], term["more_mm3"]))
    if not terms:
        return []
    causes = [Cause(CAUSES.get(term["name"], title(term["name"])), term["why"], term["less_mm3"], term["more_mm3"]) for term in terms]
    least = SMALLEST_SHARE * max(causes[0].less_mm3, causes[0].more_mm3)
    listed = [cause for cause in causes if max(cause.less_mm3, cause.more_mm3) >= least > 0.0]
    if rest := causes[len(listed) :]:
        less, more = (hypot(*sizes) for sizes in zip(*((one.less_mm3, one.more_mm3) for one in rest), strict=True))
        listed += [Cause(f"{len(rest)} smaller cause{'s' if len(rest) > 1 else ''}", "", less, more)] * (less + more > 0.0)
    low, high = summary["volume_interval_mm3"]
    calibration = Calibration.from_plain(summary.get("calibration"))
    factor = f", by the factor {calibration.factor('volume_mm3'):.2g}" if calibration.factors else ""
    why = f"The interval is {calibration.text}{factor}."
    return [*listed, Cause("90 % interval", why, summary["volume_mm3"] - low, high - summary["volume_mm3"])]


def main_cause(summary: dict[str, Any]) -> str:
    """Return a sentence about the largest cause of the volume's uncertainty. It is empty if no cause is known."""
    causes = uncertainty_causes(summary)
    return "" if len(causes) < 2 else f"Largest cause of uncertainty: {causes[0].why} ({causes[0].amount})."


def title(name: str) -> str:
    """Return a name of a file or a field as words, such as "Printed 8 ml" for ``printed_8ml``."""
    words = re.sub(r"(?<=[a-z]{3})(?=\d)|(?<=\d)(?=(?:ml|mm|cm)\b)", " ", name.replace("_", " ").strip())
    words = re.sub(r"(?<=[a-z]{3} )0+(?=\d)", "", words)  # day05 is day 5
    return words[:1].upper() + words[1:]


def heading(plants: Subject, scene: str) -> tuple[str, str]:
    """Return the name of a scan, such as "P07, day 12", and what else is known about its plants.

    Scans of unnamed plants have the name of their scene.
    """
    if not plants.plant:
        return title(scene), str(plants)
    brief = replace(plants, species="", treatment="", replicate=None, notes="", date="" if plants.day is not None else plants.date)
    rest = replace(plants, plant="", day=None, date=plants.date if plants.day is not None else "")
    return str(brief), str(rest)


def trait_text(definition: Definition, value: float | int | None, assessed: Assessment) -> tuple[str, str, str, str]:
    """Describe a trait in four texts: label, value with unit, 90 % interval or verdict, and definition.

    Value and interval are rounded to the digits that the interval supports. Without an interval the value has three
    digits.
    """
    label = LABELS.get(definition.field, title(definition.name))
    meaning = re.sub(r"\w+_\w+", lambda word: _FIELD_LABELS.get(word[0], word[0]), definition.meaning)
    meaning = re.sub(rf"^{label}(, |$)", "", meaning, flags=re.IGNORECASE)
    if assessed.interval is None:
        return label, _with_unit(definition, value, None), assessed.verdict, meaning
    low, high = assessed.interval
    half = 0.5 * (high - low)
    interval = f"{_number(definition, low, half)} to {_number(definition, high, half)}"
    text = interval if assessed.verdict == "reliable" else f"{assessed.verdict}; {interval}"
    return label, _with_unit(definition, value, half), text, meaning


_FIELD_LABELS = {key: LABELS[d.field].lower() for d in DEFINITIONS for key in (d.field, d.name) if "_" in key}


def _with_unit(definition: Definition, value: float | int | None, half: float | None) -> str:
    if value is None:
        return "not available"
    return f"{_number(definition, value, half)} {UNITS.get(definition.unit, definition.unit)}".rstrip()


def _number(definition: Definition, value: float, half: float | None) -> str:
    """Format a value of a trait in the unit that is used in reports.

    Parameters
    ----------
    half : float or None
        Half-width of the 90 % interval in the trait's unit, None if unknown.
    """
    if definition.field in COUNTS:
        return f"{value:.0f}"
    scale = 1000.0 if definition.field in IN_ML else 1.0
    return round_digits(value / scale) if half is None else f"{value / scale:.{decimals(half / scale)}f}"


def root_summary(summary: dict[str, Any]) -> list[str]:
    """Return lines of text that summarise the roots.

    The first line states total length, number of tips and mean diameter. If the volume is reliable but one of these
    values is not, a second line states the reason.
    """
    estimates = [one for one in summary.get("estimates") or [] if one["name"] in _AROUND]
    if not estimates:
        return []
    parts = []
    for one in estimates:
        before, after = _AROUND[one["name"]]
        (low, high), counted = one["interval"], one["name"] in COUNTS
        digits = 0 if counted else decimals(0.5 * (high - low))
        value, low, high = (f"{number:.{digits}f}" for number in (one["value"], low, high))
        parts.append(f"{before}{value}{after} ({'' if one['trusted'] else 'not reliable; '}{low} to {high})")
    reasons = [one["verdict"] for one in estimates if not one["trusted"]] if summary["volume_trusted"] else []
    return [", ".join(parts), *reasons[:1]]


_AROUND = {"total_length_mm": ("length ", " mm"), "tips": ("", " tips"), "mean_diameter_mm": ("mean diameter ", " mm")}
"""Text before and after the value of a trait in the summary of the roots, keyed by field name."""


def is_simulated(dataset: Dataset | None) -> bool:
    """Return whether the pictures of a dataset were simulated."""
    return dataset is not None and ((dataset.folder / "truth").is_dir() or dataset.origin.get("program") == "rhizotwin simulate")


def methods_paragraph(summary: dict[str, Any], *, roots: bool, simulated: bool) -> str:
    """Return a paragraph for the methods section of a paper, including the versions of the software.

    Parameters
    ----------
    roots : bool
        Whether the result contains centre lines.
    simulated : bool
        Whether the images were simulated.
    """
    used = sum(view["used"] for view in summary["views"])
    versions = summary.get("versions", {})
    pictures = _PICTURES.format(made="Simulated images" if simulated else "Images", pictures=used)
    tubes = "tubes were fitted to all images at once where roots are too thin for the hull"
    method = _baseline(summary) or _METHOD.format(
        by=" in one fit to all images" if (summary.get("rig") or {}).get("rings") else ", or given",
        shape=tubes if roots else "the hull was trimmed to what the silhouettes require",
    )
    named = ", ".join(f"{name} {versions[name]}" for name in versions if name in ("rhizotwin", "python", "numpy", "mitsuba", "drjit"))
    edits = summary.get("edits")
    by_hand = f" The result was edited by hand ({edits['count']} edits, {100.0 * edits['volume_share']:+.1f} % of volume)." if edits else ""
    return f"{pictures} {method} {_RIG}{by_hand} Voxel size: {summary['voxel_mm']:g} mm. Software: {named}."


def _baseline(summary: dict[str, Any]) -> str:
    """Return the description of the baseline that computed a result, or an empty text for the full method."""
    method = summary.get("settings", {}).get("method")
    if method is None:
        return ""
    from rhizotwin.scoring.baselines import TITLES  # loads the reconstruction

    return _BASELINE.format(title=next((title for name, title in TITLES.items() if name == method), "an unknown method"))


def _sentence(text: str | None) -> str:
    """Return a text with an initial capital letter and a final full stop."""
    text = (text or "").strip()
    return "" if not text else text[0].upper() + text[1:] + ("" if text[-1] in ".!?" else ".")
