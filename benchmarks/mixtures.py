"""Validation of trust: small scans of random plants with random disturbances, and the coverage of trusted intervals.

Every fifth scan has the unchanged profile `camera`, every fifth `real`; the others have pictures of `camera`, and a
random half of the disturbances of `real`, each with a random magnitude. The plants are random too, so that no setting
was ever chosen on one of them.
"""

import json
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks import cache, datasets
from rhizotwin import sources
from rhizotwin.scenes import atomic
from rhizotwin.scenes.files import load_profile, load_scene
from rhizotwin.scenes.model import Disturbances, Scene
from rhizotwin.scenes.provenance import versions
from rhizotwin.scenes.specimens import GrownSpecimen, RootOrder

COUNT = 50
IMAGE_WH = (400, 300)
VIEWS = 20, 24
DOSE = 0.25, 1.5
"""Range of magnitudes relative to `real`: from almost none to 1.5 times as much."""
TROUBLES: dict[str, tuple[str, ...]] = {
    "tube": ("canister_radius_error_mm", "canister_out_of_round_mm", "wall_error", "n_wall_error"),
    "seam": ("seam_opacity",),
    "dust": ("dust_specks", "scratches"),
    "highlight": ("highlight",),
    "glass": ("root_mu_per_mm",),
    "hairs": ("root_hair_mu_per_mm",),
    "sway": ("sway_mm",),
    "seat": ("strip_offset_mm", "strip_tilt_deg", "focal_error"),
    "algae": ("algae_patches", "algae_opacity"),
    "turbidity": ("turbidity_per_mm",),
    "floating": ("felt_fibres", "bubbles"),
}
"""Fields of `Disturbances` that are selected together; their magnitudes are drawn separately."""
SIGNED = ("canister_radius_error_mm", "wall_error", "n_wall_error", "focal_error")
"""Fields with random signs."""
WITH: dict[str, tuple[str, ...]] = {"glass": ("root_n",), "hairs": ("root_hair_mm",)}
"""Fields used with their values in the profile."""
_DRAW = 19
_VERSIONED = ("mitsuba", "drjit", "numpy", "scipy", "scikit-image", "opencv-python-headless", "trimesh", "manifold3d")

Record = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Mixture:
    """Pictures of one random scan."""

    number: int

    @property
    def seed(self) -> int:
        """Random seed of the rendering."""
        return self.number

    @property
    def profile(self) -> str:
        """Profile of the rig's errors."""
        return ("camera", "real", "mixture", "mixture", "mixture")[self.number % 5]

    @property
    def name(self) -> str:
        """Short name for keys and messages."""
        return f"{self.profile}/{self.number}"

    def troubles(self) -> tuple[str, ...]:
        """Return the names of the selected disturbances."""
        rng = np.random.default_rng([_DRAW, self.number])
        chosen = tuple(name for name in TROUBLES if rng.random() < 0.5)
        return {"camera": (), "real": tuple(TROUBLES)}.get(self.profile, chosen)

    def scene_to_render(self) -> Scene:
        """Return the scene with plant, plan and disturbances."""
        rng = np.random.default_rng([_DRAW, self.number, 1])
        scene = load_scene("printed_8ml")
        plan = replace(scene.plan, rings=tuple(replace(ring, views=int(rng.integers(VIEWS[0], VIEWS[1] + 1))) for ring in scene.plan.rings))
        plant = draw_plant(rng)
        wrong = self._disturbances(rng)
        camera = scene.camera.resized(IMAGE_WH)
        return replace(scene, name=f"mixture_{self.number}", description="", camera=camera, plan=plan, specimen=plant, disturbances=wrong)

    def _disturbances(self, rng: np.random.Generator) -> Disturbances:
        wrong, real = load_profile("camera"), load_profile("real")
        if self.profile != "mixture":
            return real if self.profile == "real" else wrong
        for trouble in self.troubles():
            changes: dict[str, Any] = {field: getattr(real, field) for field in WITH.get(trouble, ())}
            for field in TROUBLES[trouble]:
                value = getattr(real, field)
                dosed = value * float(rng.uniform(*DOSE)) * (rng.choice((-1.0, 1.0)) if field in SIGNED else 1.0)
                changes[field] = round(dosed) if isinstance(value, int) else dosed
            wrong = replace(wrong, **changes)
        return wrong


def draw_plant(rng: np.random.Generator) -> GrownSpecimen:
    """Draw a taproot with laterals of 1.5 to 5 pixels, and some of the second order.

    Thinner roots have no measurable volume in such pictures.
    """
    tap_mm, lateral_mm = rng.uniform(2.0, 6.0), rng.uniform(0.8, 2.2)
    length_mm = rng.uniform(50.0, 95.0)
    tap = RootOrder(
        diameter_mm=tap_mm,
        taper=rng.uniform(0.25, 0.6),
        elongation_mm_per_day=10.0,
        max_length_mm=length_mm,
        interlateral_mm=rng.uniform(3.0, 12.0),
        base_mm=6.0,
        apex_mm=10.0,
        gravitropism_per_mm=0.02,
        wobble_deg=rng.uniform(1.0, 4.0),
    )
    lateral = RootOrder(
        diameter_mm=lateral_mm,
        taper=rng.uniform(0.5, 0.8),
        elongation_mm_per_day=6.0,
        max_length_mm=rng.uniform(20.0, 55.0),
        interlateral_mm=rng.uniform(10.0, 40.0),
        insertion_deg=rng.uniform(40.0, 80.0),
        gravitropism_per_mm=rng.uniform(0.0, 0.02),
        wobble_deg=rng.uniform(2.0, 5.0),
    )
    fine = replace(lateral, diameter_mm=0.7 * lateral_mm, max_length_mm=15.0)
    # A cylinder for the taproot and about ten laterals of 20 mm; all radii are scaled to this volume, so that it is
    # only approximate.
    volume_mm3 = np.pi / 4.0 * (length_mm * (0.7 * tap_mm) ** 2 + 10.0 * 20.0 * (0.8 * lateral_mm) ** 2)
    return GrownSpecimen(
        seed=int(rng.integers(2**31)),
        age_days=float(rng.uniform(10.0, 20.0)),
        volume_ml=float(volume_mm3 / 1000.0),
        orders=(tap, lateral, fine),
        origin_mm=(0.0, 0.0, -17.5),
        floor_margin_mm=34.0,
    )


def measure(numbers: Sequence[int], *, device: str, say: Callable[[str], None]) -> list[Record]:
    """Render, reconstruct and score mixtures, each in processes of its own.

    Earlier measurements with this code are reused.

    Parameters
    ----------
    numbers : sequence of int
        Numbers of the mixtures, from which each is drawn.
    device : str
        Computing device.
    say : callable
        Receives the result of every mixture.

    Returns
    -------
    list of dict
        One record per mixture; a crashed one has ``crashed`` instead of its score.
    """
    records = []
    for place, number in enumerate(numbers, start=1):
        mixture = Mixture(number=number)
        path = _load_kept(mixture, device)
        record = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None
        if record is None:
            try:
                record = _measure_one(mixture, device)
            except RuntimeError as error:
                record = {"number": number, "profile": mixture.profile, "troubles": mixture.troubles(), "crashed": str(error)}
            else:
                atomic.write_json(path, record)
        records.append(record)
        say(f"[{place}/{len(numbers)}] {line(record)}")
    return records


def _load_kept(mixture: Mixture, device: str) -> Any:
    settings = {"dataset": datasets.place(mixture).name, "device": device, "versions": versions(_VERSIONED)}
    code = sources.digest(("rhizotwin.recon.reconstruct", "rhizotwin.scoring.score"))
    return cache.folder() / "mixtures" / f"{cache.key(settings, sources=code)}.json"


def _measure_one(mixture: Mixture, device: str) -> Record:
    from benchmarks import worker  # imported here, as that module imports this one

    if not datasets.is_ready(mixture):
        worker.start(["dataset", json.dumps({"mixture": mixture.number})], device=device)
    found = worker.start(["score", str(datasets.place(mixture)), "coverage", "0.27", "none"], device=device)
    score = found["score"]
    roots = score["roots"] or {}
    return {
        "number": mixture.number,
        "profile": mixture.profile,
        "troubles": mixture.troubles(),
        "volume_true_mm3": score["volume_true_mm3"],
        "volume_error": score["volume_error"],
        "interval_mm3": score["volume_interval_mm3"],
        "holds": score["interval_holds_truth"],
        "trusted": score["volume_trusted"],
        "verdict": score["volume_verdict"],
        "length_error": roots.get("length_error"),
        "checks": found["checks"],
        "cpu_s": found["cpu_s"],
    }


def line(record: Record) -> str:
    """Return one line about a mixture."""
    head = f"{record['profile']}/{record['number']} ({', '.join(record['troubles']) or 'nothing more'})"
    if "crashed" in record:
        return f"{head}: CRASHED\n{record['crashed']}"
    trusted, holds = "trusted" if record["trusted"] else "not trusted", "holds" if record["holds"] else "misses"
    length = "" if record["length_error"] is None else f", length {100.0 * record['length_error']:+.1f} %"
    return f"{head}: volume {100.0 * record['volume_error']:+.1f} %, interval {holds}, {trusted}{length}"


def summary(records: Sequence[Record]) -> dict[str, Any]:
    """Return the summary of the mixtures: fractions and errors, in total and by profile."""
    found: dict[str, Any] = {}
    for profile in ("all", "camera", "real", "mixture"):
        some = [record for record in records if profile in ("all", record["profile"]) and "crashed" not in record]
        trusted = [record for record in some if record["trusted"]]
        errors = [abs(record["volume_error"]) for record in trusted]
        found[profile] = {
            "scans": len(some),
            "crashed": sum("crashed" in record for record in records if profile in ("all", record["profile"])),
            "trusted": len(trusted),
            "intervals_that_hold": sum(record["holds"] for record in trusted),
            "median_error": statistics.median(errors) if errors else None,
            "worst_error": max(errors, default=None),
        }
    return found


def table(records: Sequence[Record]) -> str:
    """Return the summary and every scan as a Markdown page."""
    lines = [
        "| scans | number | trusted | interval holds, of trusted | median error, of trusted | worst error, of trusted |",
        "|---|---|---|---|---|---|",
    ]
    for profile, row in summary(records).items():
        held = f"{row['intervals_that_hold']} of {row['trusted']}"
        errors = " | ".join("" if row[name] is None else f"{100.0 * row[name]:.1f} %" for name in ("median_error", "worst_error"))
        lines.append(f"| {profile} | {row['scans']} | {row['trusted']} | {held} | {errors} |")
    lines += [
        "",
        "| scan | troubles beside `camera`'s | volume | interval | trusted | length | motion mm | sight | canister | dirt |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for record in records:
        if "crashed" in record:
            lines.append(f"| {record['number']} | {', '.join(record['troubles'])} | crashed | | | | | | | |")
            continue
        checks = {check["name"]: check["value"] for check in record["checks"]}
        values = " | ".join("" if checks.get(name) is None else f"{checks[name]:.3f}" for name in ("motion", "sight", "canister", "dirt"))
        length = "" if record["length_error"] is None else f"{100.0 * record['length_error']:+.1f} %"
        lines.append(
            f"| {record['number']} | {record['profile'] if record['profile'] != 'mixture' else ', '.join(record['troubles'])} | "
            f"{100.0 * record['volume_error']:+.1f} % | {'holds' if record['holds'] else 'misses'} | "
            f"{'yes' if record['trusted'] else 'no'} | {length} | {values} |"
        )
    return "\n".join(lines) + "\n"
