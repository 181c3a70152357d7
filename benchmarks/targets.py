"""Targets by metric."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Target:
    """Limit of one number."""

    limit: float
    text: str
    """Limit as text."""
    at_least: bool = False
    """Whether the number must be at least the limit; otherwise its magnitude must be at most the limit."""

    def reached(self, value: float) -> bool:
        """Return whether a number reaches the target; False for NaN."""
        return value >= self.limit if self.at_least else abs(value) <= self.limit


def _percent(limit: float) -> Target:
    return Target(limit, f"{100.0 * limit:g} %")


def _share(limit: float) -> Target:
    return Target(limit, f"at least {limit:g}", at_least=True)


def _volume(group: str, profile: str, median: float, worst: float) -> dict[str, Target]:
    key = f"ladder/{group}/{profile}/volume"
    return {f"{key}_median": _percent(median), f"{key}_worst": _percent(worst)}


def _ladder() -> dict[str, Target]:
    """Return the targets by the keys of `benchmarks.table`."""
    targets: dict[str, Target] = {}
    for profile, limit in (("clean", 0.01), ("bench", 0.02), ("harsh", 0.05)):
        targets[f"ladder/printed_8ml/{profile}/volume_worst"] = _percent(limit)
    for profile, median, worst in (("clean", 0.03, 0.08), ("bench", 0.05, 0.12), ("harsh", 0.10, 0.25)):
        targets |= _volume("radish_day05-15", profile, median, worst)
    for profile, median, worst in (("clean", 0.05, 0.12), ("bench", 0.08, 0.18)):
        targets |= _volume("radish_day20-30", profile, median, worst)
    targets["ladder/radish_day20-30/harsh/interval_holds"] = _share(1.0)
    for profile, limit in (("clean", 0.08), ("bench", 0.12)):
        targets[f"ladder/fallen_plant/{profile}/volume_worst"] = _percent(limit)
    for group, clean, bench in (("thin_families", (0.02, 0.05), (0.03, 0.07)), ("thick_families", (0.015, 0.03), (0.02, 0.05))):
        targets |= _volume(group, "clean", *clean) | _volume(group, "bench", *bench)
        targets[f"ladder/{group}/clean/length_mean"] = _percent(0.02)
        targets |= {f"ladder/{group}/clean/{quantity}": _share(0.93) for quantity in ("tip_precision", "tip_recall")}
    for profile, limit in (("clean", 0.03), ("bench", 0.05), ("harsh", 0.10)):
        targets[f"ladder/plants/{profile}/length_mean"] = _percent(limit)
    for profile, limit in (("clean", 0.95), ("bench", 0.90)):
        for quantity in ("tip_precision", "tip_recall"):
            targets[f"ladder/plants/{profile}/{quantity}"] = _share(limit)
    for profile in ("clean", "bench", "harsh"):
        targets[f"ladder/all/{profile}/interval_holds"] = _share(0.85)
        targets[f"ladder/radish_day30/{profile}/wall_worst"] = Target(180.0, "3 min")
        targets[f"ladder/radish_day30/{profile}/memory_worst"] = Target(6144.0, "6 GiB")
    return targets


TARGETS: dict[str, Target] = {
    "projection/max_px": Target(1e-3, "1e-3 px"),
    "projection/lost": Target(0.0, "none"),
    "projection/visibility_disagreement": Target(0.0, "none"),
    "projection/kernel_max_px": Target(1e-3, "1e-3 px"),
    "projection/kernel_seen_wrongly": Target(0.0, "none"),
    "sphere_20mm/clean/40x800x600/0.27/coverage/volume_error": Target(0.01, "within 1 %"),
    "printed_8ml/clean/40x800x600/0.27/coverage/extents_error_max": Target(0.01, "within 1 %"),
    "printed_8ml/clean/40x800x600/0.27/coverage/pose_median_mm": Target(0.05, "0.05 mm"),
    "printed_8ml/clean/40x800x600/0.27/coverage/pose_median_deg": Target(0.02, "0.02 deg"),
    "printed_8ml/bench/40x800x600/0.27/coverage/pose_median_mm": Target(0.3, "0.3 mm"),
    "printed_8ml/bench/40x800x600/0.27/coverage/pose_median_deg": Target(0.1, "0.1 deg"),
    "rig/inverse/closed_form_error": Target(1e-9, "1e-9"),
    "rig/inverse/newton_failed": Target(0.001, "0.1 %"),
    "rig/faults/problems": Target(0.0, "none"),
    "rig/overhead/per_view": Target(0.05, "50 ms"),
    "rig/calibrate/clean/focal_error": Target(0.001, "0.1 %"),
    "rig/calibrate/bench/focal_error": Target(0.001, "0.1 %"),
    "rig/calibrate/clean/rms": Target(0.2, "0.2 px"),
    "rig/calibrate/bench/rms": Target(0.2, "0.2 px"),
    "rig/scan/volume_error": Target(0.04, "within 4 %"),
    **_ladder(),
}
