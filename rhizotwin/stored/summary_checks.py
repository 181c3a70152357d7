"""Validate the types of the values in ``result.json``."""

import math
from collections.abc import Callable
from dataclasses import fields
from typing import Any, TypeAlias, get_args

from rhizotwin.recon.passes import Pass
from rhizotwin.recon.results.parts import Json
from rhizotwin.recon.uncertainty.checks import Check, Estimate
from rhizotwin.scenes import trait_table

Fits: TypeAlias = Callable[[Any], bool]
"""Type of a validator: a function that returns whether a value is valid."""
_TWICE = {"total_length_mm": "length_mm", "volume_mm3": "volume_mm3", "tips": "tips"}
"""Traits that ``result.json`` contains twice, and the keys of their other values."""
LARGEST = 1e15
"""Limit for the absolute value of every number in ``result.json``, in any unit. Larger numbers are regarded as
invalid."""


def find_fault(summary: Json) -> str:
    """Return a description of the first error in ``result.json``. It is empty if the content is valid."""
    missing = [key for key in _REQUIRED if key not in summary]
    if missing:
        return f"contains no value of {missing[0]!r}"
    unfit = [key for key, fits in (_REQUIRED | _OPTIONAL).items() if key in summary and not fits(summary[key])]
    if unfit:
        return f"contains an invalid value of {unfit[0]!r}"
    apart = [f"traits.{key}" for key, other in _TWICE.items() if not _agree(summary.get("traits", {}).get(key), summary.get(other))]
    return f"contains a value of {apart[0]!r} that is not the one of {_TWICE[apart[0].removeprefix('traits.')]!r}" if apart else ""


def _agree(value: Any, other: Any) -> bool:
    return None in (value, other) or math.isclose(value, other, rel_tol=1e-6)


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST  # false for NaN


def _positive(value: Any) -> bool:
    return _number(value) and value > 0.0


def _measured(value: Any) -> bool:
    """Return whether a value is that of a trait: none is negative, and distributions are lists."""
    return value is None or (all(map(_measured, value)) if isinstance(value, list) else _number(value) and value >= 0.0)


def _text(value: Any) -> bool:
    return isinstance(value, str)


def _truth(value: Any) -> bool:
    return isinstance(value, bool)


def _or_none(fits: Fits) -> Fits:
    return lambda value: value is None or fits(value)


def _list(fits: Fits, count: int | None = None) -> Fits:
    return lambda value: isinstance(value, list) and count in (None, len(value)) and all(fits(item) for item in value)


def _with(there: dict[str, Fits], maybe: dict[str, Fits] | None = None) -> Fits:
    """Return a validator for an object with the required keys ``there`` and the optional keys ``maybe``."""

    def fits(value: Any) -> bool:
        if not isinstance(value, dict) or any(key not in value for key in there):
            return False
        return all(right(value[key]) for key, right in (there | (maybe or {})).items() if key in value)

    return fits


def _only(fits: Fits, names: set[str]) -> Fits:
    return lambda value: fits(value) and set(value) == names


def _numbers(count: int) -> Fits:
    return _list(_number, count)


def _is_complete(rig: Json) -> bool:
    """Return whether a refractive index that was found has its given and used values and its uncertainty."""
    return rig.get("n_water_found") is None or {"n_water", "n_water_given", "n_water_sigma"} <= rig.keys()


_POSE = _list(_numbers(4), 4)
"""Validator for a pose, which is a 4x4 matrix."""
_TERM = _with({"why": _text, "less_mm3": _number, "more_mm3": _number})
"""Validator for one entry of the list of causes of uncertainty."""
_VIEW = _with(
    {"file": _text, "used": _truth},
    {
        **dict.fromkeys(("cam_from_canister", "cam_from_tank"), _or_none(_POSE)),
        "sway": _numbers(3),
        **dict.fromkeys(
            ("table_deg", "reprojection_px", "markers", "fill", "position_sigma_mm", "rotation_sigma_deg", "ring"), _or_none(_number)
        ),
    },
)
"""Validator for one entry of the list of views."""
_RING = _with(
    {
        "ring": _number,
        "cam_from_rig": _POSE,
        "covariance": _list(_numbers(6), 6),
        "own_movement_mm": _number,
        "own_movement_deg": _number,
    },
    {"placement": _or_none(_number)},
)
"""Validator for the pose of the camera of one ring."""
_EDGES = _with(
    {"before_mm": _number, "after_mm": _number}, dict.fromkeys(("count", "radius_excess_mm", "oval_mm", "oval_deg"), _or_none(_number))
)
"""Validator for the results of the calibration from the edges of the canister."""
_ROOTS = _with({"nodes": _number, "before_px": _number, "after_px": _number})
"""Validator for the results of the calibration from the roots."""
_RIG = _with(
    {},
    {
        **dict.fromkeys(("focal_scale", "focal_scale_markers", "mm_per_px"), _positive),
        "rings": _or_none(_list(_RING)),
        "canister_edges": _or_none(_EDGES),
        "roots": _or_none(_ROOTS),
        **dict.fromkeys(("canister_from_strip", "table_from_canister"), _or_none(_POSE)),
        **dict.fromkeys(("canister_from_strip_sigma", "table_from_canister_sigma"), _or_none(_numbers(4))),
        **dict.fromkeys(("n_water", "n_water_given"), _positive),
        **dict.fromkeys(
            (
                *("focal_scale_found", "focal_scale_sigma", "n_water_found", "n_water_sigma", "marker_inset_px"),
                *("reprojection_before_px", "reprojection_after_px", "table_correction_deg", "sway_mm"),
            ),
            _or_none(_number),
        ),
    },
)
"""Validator for the results of the self-calibration (see `recon.results.calibration_summary`)."""
_CHECK = _only(
    _with(
        {"name": _text, "state": _text, "unit": _text, "found": _text, "advice": _text},
        dict.fromkeys(("value", "fair", "bad"), _or_none(_number)),
    ),
    {field.name for field in fields(Check)},
)
"""Validator for one entry of the list of scan quality checks."""
_ESTIMATE = _only(
    _with({"name": _text, "value": _number, "interval": _numbers(2), "trusted": _truth, "verdict": _text}),
    {field.name for field in fields(Estimate)},
)
"""Validator for one entry of the list of estimates, each with its interval."""
_SHOOT = _with(
    {"hull_mm3": _number, "pot_top_mm": _number, "hidden_share": _number},
    {
        **dict.fromkeys(("stalks_mm3", "surface_area_mm2", "projected_mean_mm2", "leaves", "enclosed_share"), _number),
        **dict.fromkeys(("leaf_area_mm2", "leaf_thickness_mm", "volume_mm3"), _or_none(_number)),
        **dict.fromkeys(trait_table.COLOURS, _number),
        "blades_mm2": _list(_number),
        "leaf_colours": _list(_only(_with({}, dict.fromkeys(trait_table.COLOURS, _number)), set(trait_table.COLOURS))),
    },
)
"""Validator for the shoot. Colours are those of all blades, or of none."""
_REQUIRED: dict[str, Fits] = {
    "scene": _text,
    "dataset_sha256": _text,
    "voxel_mm": _number,
    "volume_mm3": _number,
    "volume_interval_mm3": _numbers(2),
    "volume_bounds_mm3": _numbers(2),
    "volume_trusted": _truth,
    "volume_verdict": _text,
    "volume_budget": _list(_TERM),
    "extents_min_mm": _numbers(3),
    "extents_max_mm": _numbers(3),
    "hull_mm3": _number,
    "untrimmed_mm3": _number,
    "blind_mm3": _number,
    "views": _list(_VIEW),
    "warnings": _list(_text),
    "timings_s": lambda value: isinstance(value, dict) and all(_number(item) for item in value.values()),
}
"""Validators for the values of the required keys."""
_OPTIONAL: dict[str, Fits] = {
    "hidden_height_mm": lambda value: _number(value) and value >= 0.0,
    "rig": _or_none(lambda value: _RIG(value) and _is_complete(value)),
    "plants": _or_none(_list(_with({}))),
    "settings": _with({}, {"finest_mm": _positive}),
    "versions": _with({}),
    "traits": lambda value: isinstance(value, dict) and all(map(_measured, value.values())),
    "bands": lambda value: isinstance(value, dict) and all(_number(item) for item in value.values()),
    "checks": _list(_CHECK),
    "estimates": _list(_ESTIMATE),
    "calibration": _with(
        {
            "regime": _or_none(_text),
            "factors": lambda value: isinstance(value, dict) and all(_number(factor) and factor > 0.0 for factor in value.values()),
        }
    ),
    "edits": _or_none(
        _with(
            {"count": _number, "who": _list(_text), "volume_share": _number},
            {"last": _or_none(_text), "volume_before_mm3": _number, "base_mm": _or_none(_numbers(3))},
        )
    ),
    "shoot": _or_none(lambda value: _SHOOT(value) and len(value.get("leaf_colours", ())) in (0, len(value.get("blades_mm2", ())))),
    **dict.fromkeys(get_args(Pass), _number),
    "mass_g": _or_none(_positive),
    **dict.fromkeys(("root_mu_per_mm", "root_mu_sigma_per_mm", "peak_memory_mib"), _or_none(_number)),
}
"""Validators for the values of the optional keys."""
