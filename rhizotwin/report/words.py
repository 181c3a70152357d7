"""What a result is worth and how it was made, in sentences for people."""

from __future__ import annotations

from typing import Any, Literal

from rhizotwin.scenes.assessment import Assessment
from rhizotwin.scenes.formatting import interval_ml, ml, round_digits
from rhizotwin.scenes.trait_table import Definition

Light = Literal["good", "fair", "bad"]

LEAST_SHARE = 0.05
"""Causes of uncertainty smaller than this share of the largest are not told one by one."""
SAID = {
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
    "max_root_count": "Most roots at one height",
    "median_root_count": "Roots at a typical height",
    "bushiness": "Bushiness",
    "lower_length_share": "Share of the length in the lower two thirds",
    "roots": "Number of roots",
    "tips": "Number of root ends",
    "branch_points": "Number of branch points",
    "angle_to_gravity_deg": "Angle to straight down",
    "angle_to_parent_deg": "Angle of laterals to their parents",
    "specific_root_length_m_per_g": "Specific root length",
    "tissue_density_g_per_ml": "Tissue density",
}
_ML = ("volume_mm3", "convex_hull_mm3")
METHOD = (
    "Roots were imaged in a round canister of nutrient solution before a diffuse backlight, {pictures} pictures round a turn. Cameras were "
    "found from a strip of printed markers{by}, light was followed through air, acrylic and water in closed form, the share of each pixel "
    "that roots cover was measured against the empty backlight, a hull was carved from it and {shape}. The 90 % interval of the volume "
    "adds in quadrature the causes of uncertainty that the pictures themselves tell. The rig is that of R. Kliman, Design of a robotic "
    "platform for plant root imaging and biomass estimation, Georgia Institute of Technology, 2022."
)


def volume(summary: dict[str, Any]) -> tuple[str, str]:
    """Return the volume in ml, and its interval, with the digits that the interval leaves."""
    low, high = summary["volume_interval_mm3"]
    found = summary["volume_mm3"]
    half = max(high - found, found - low)
    return f"{ml(found, half_mm3=half)} ml", f"{ml(low, half_mm3=half)} to {ml(high, half_mm3=half)} ml"


def headline(summary: dict[str, Any]) -> tuple[str, str]:
    """Return what stands first, and what goes with it; a scan that cannot give a volume has none there."""
    found, interval = volume(summary)
    if summary["volume_trusted"]:
        return f"volume {found}", f"90 % interval {interval}"
    return "volume could not be determined", f"the shape found has {found} ({interval}), which is not to be trusted"


def light(summary: dict[str, Any]) -> tuple[Light, str, list[str]]:
    """Return the traffic light, what it means, and what to do."""
    checks = [check for check in summary.get("checks") or [] if isinstance(check, dict)]
    bad = [check for check in checks if check.get("state") == "bad"]
    fair = [check for check in checks if check.get("state") == "fair"]
    told = [" ".join(filter(None, (_sentence(check.get("found")), _sentence(check.get("advice"))))) for check in (*bad, *fair)]
    low, high = summary["volume_interval_mm3"]
    wide = max(high - summary["volume_mm3"], summary["volume_mm3"] - low) / max(summary["volume_mm3"], 1e-9)
    if not summary["volume_trusted"]:
        told = told or [_sentence(str(summary["volume_verdict"]))]
        return "bad", "Do not use this volume.", told
    if fair or summary["warnings"]:
        told += [_sentence(str(warning)) for warning in summary["warnings"]]
        return "fair", f"The volume can be used, within {100.0 * wide:.0f} %. Something could be better:", told
    return "good", f"The volume can be used: with 90 % confidence it is within {100.0 * wide:.0f} %.", told


def budget(summary: dict[str, Any]) -> list[str]:
    """Return the causes of uncertainty in sentences, the largest first."""
    terms = sorted(summary["volume_budget"], key=lambda term: -max(term["less_mm3"], term["more_mm3"]))
    largest = max((max(term["less_mm3"], term["more_mm3"]) for term in terms), default=0.0)
    told = [term for term in terms if max(term["less_mm3"], term["more_mm3"]) >= LEAST_SHARE * largest > 0.0]
    sentences = [f"The volume may be {_reach(term['less_mm3'], term['more_mm3'])}, because {term['why']}." for term in told]
    if len(told) < len(terms):
        sentences.append(f"{len(terms) - len(told)} other causes were looked at; each is less than a twentieth of the largest.")
    return sentences


def trait(definition: Definition, value: float | int | None) -> tuple[str, str, str]:
    """Return a trait's name, its value with unit, and what it means."""
    name = SAID.get(definition.field, definition.name.replace("_", " ").capitalize())
    meaning = definition.meaning
    for field, said in SAID.items():  # tables name other columns by their keys
        meaning = meaning.replace(field, said.lower()) if "_" in field else meaning
    if value is None:
        return name, "not known", meaning
    if isinstance(value, int):
        return name, str(value), meaning
    if definition.field in _ML:
        return name, f"{round_digits(value / 1000.0)} ml", meaning
    unit = {"mm2": "mm²", "deg": "degrees"}.get(definition.unit, definition.unit)
    return name, f"{round_digits(value)} {unit}".rstrip(), meaning


def interval(definition: Definition, assessed: Assessment) -> str:
    """Return the 90 % interval of a trait in the unit of `trait`, or why there is none."""
    if assessed.interval is None:
        return assessed.verdict
    low, high = assessed.interval
    if definition.field == "volume_mm3":
        text = interval_ml(low, high)
    elif definition.field == "tips":
        text = f"{low:.0f} to {high:.0f}"
    else:
        text = f"{round_digits(low)} to {round_digits(high)}"
    return text if assessed.verdict == "reliable" else f"not reliable ({text})"


def roots_told(summary: dict[str, Any]) -> list[str]:
    """Return a sentence on length, tips and mean diameter, and one on each reason why some are not to be trusted."""
    told = summary.get("estimates") or []
    if not told:
        return []
    parts = []
    for one in told:
        before, after = _SHORT[one["name"]]
        numbers = [f"{value:.0f}" if one["name"] == "tips" else round_digits(value) for value in (one["value"], *one["interval"])]
        parts.append(f"{before}{numbers[0]}{after} ({numbers[1]} to {numbers[2]}{'' if one['trusted'] else ', not reliable'})")
    verdicts = [one["verdict"] for one in told if not one["trusted"]] if summary["volume_trusted"] else []
    return [", ".join(parts), *verdicts[:1]]


_SHORT = {"total_length_mm": ("length ", " mm"), "tips": ("", " tips"), "mean_diameter_mm": ("mean diameter ", " mm")}
"""What stands before and behind a number on one line."""


def method(summary: dict[str, Any], *, roots: bool) -> str:
    """Return a paragraph on how the numbers were made, with the versions, for a paper."""
    used = sum(view["used"] for view in summary["views"])
    versions = summary.get("versions", {})
    shape = "tubes were fitted to all pictures at once where roots are too thin for it" if roots else "trimmed to what the pictures need"
    by = " by one fit to all pictures" if summary.get("rig") else ", or given"
    text = METHOD.format(pictures=used, by=by, shape=shape)
    made = ", ".join(
        f"{name} {number}" for name, number in versions.items() if name in ("rhizotwin", "python", "numpy", "mitsuba", "drjit")
    )
    edits = summary.get("edits")
    hand = (
        ""
        if not edits
        else f" The result was corrected by hand ({edits['count']} edits, {100.0 * edits['volume_share']:+.1f} % of volume)."
    )
    return f"{text}{hand} Voxels: {summary['voxel_mm']:g} mm. Software: {made}."


def _reach(less_mm3: float, more_mm3: float) -> str:
    """Return how far a volume may be off to both sides."""
    less, more = round_digits(less_mm3 / 1000.0, 2), round_digits(more_mm3 / 1000.0, 2)
    if less_mm3 < LEAST_SHARE * more_mm3:
        return f"{more} ml larger"
    if more_mm3 < LEAST_SHARE * less_mm3:
        return f"{less} ml smaller"
    return f"{less} ml smaller or larger" if less == more else f"{less} ml smaller or {more} ml larger"


def _sentence(text: str | None) -> str:
    """Return text that begins with a capital and ends with a full stop."""
    text = (text or "").strip()
    return "" if not text else text[0].upper() + text[1:] + ("" if text[-1] in ".!?" else ".")
