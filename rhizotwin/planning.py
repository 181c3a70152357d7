"""What a lab asks before it builds: how many views, odd or even, how many rings at which heights, how many pixels - answered by the twin.

Every capture plan is simulated, reconstructed from its pictures alone and scored, as often as there are seeds; the same seeds for each, so
that plans are compared and not chance.
"""

import csv
import io
import itertools
import json
import math
import statistics
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from scenes import files
from scenes.atomic import write_bytes, write_json, write_text
from scenes.checks import check_scene
from scenes.errors import UserError
from scenes.model import CapturePlan, Ring, Scene
from scenes.provenance import versions

VIEW_TIME_S = 2.0
"""Turning by a view, rest and exposure on the rig of the documentation: what a plan costs at the bench."""
RING_TIME_S = 10.0
"""Placing the camera for another ring."""
_VERSIONED = ("mitsuba", "drjit", "numpy", "scipy", "scikit-image", "opencv-python-headless")


@dataclass(frozen=True, kw_only=True)
class Variant:
    """A capture plan to try."""

    heights_mm: tuple[float, ...]
    """Of the camera, one a ring, in the rig frame (0 is the canister's rim)."""
    views: int
    """In each ring."""
    image_wh: tuple[int, int]

    @property
    def name(self) -> str:
        """Short name, also of its file."""
        heights = "_".join(f"{height:g}" for height in self.heights_mm)
        return f"{self.views}x{self.image_wh[0]}x{self.image_wh[1]}_at_{heights}"

    def of(self, scene: Scene) -> Scene:
        """Return the scene with this plan: every ring at the distance of the scene's first one, looking at what that one looks at."""
        first = scene.plan.rings[0]
        aim_mm = first.height_mm - first.distance_mm * math.tan(math.radians(first.tilt_deg))
        rings = tuple(
            Ring(
                views=self.views,
                height_mm=height,
                distance_mm=first.distance_mm,
                tilt_deg=math.degrees(math.atan2(height - aim_mm, first.distance_mm)),
                first_deg=first.first_deg + k * 180.0 / self.views,
            )
            for k, height in enumerate(self.heights_mm)
        )
        return replace(scene, plan=CapturePlan(rings=rings), camera=scene.camera.resized(self.image_wh))


@dataclass(frozen=True, kw_only=True)
class Row:
    """How well a plan does: medians over the seeds."""

    variant: Variant
    pictures: int
    volume_error: float
    """Median of found / true - 1."""
    volume_error_worst: float
    """The largest without its sign."""
    interval_width: float
    """Of the stated interval, over the true volume."""
    interval_holds: float
    """Share of the runs whose interval holds the truth."""
    recall: float
    precision: float
    capture_min: float
    """At the bench."""
    compute_s: float
    """Reconstruction."""


def run_plans(
    scene: Scene,
    variants: Sequence[Variant],
    folder: Path,
    *,
    profile_name: str,
    seeds: int,
    say: Callable[[str], None],
    progress: bool = True,
) -> list[Row]:
    """Simulate, reconstruct and score every variant; what an earlier run with the same settings scored is taken over.

    Parameters
    ----------
    scene : with its specimen and the profile's disturbances.
    folder : gets ``scores/*.json``, ``plan.csv``, ``plan.json``, ``plan.png``.
    seeds : runs of each variant, seeds 0, 1, ...

    Raises
    ------
    UserError
        For a plan that the scene does not allow, plans of which none can be reconstructed, or a folder of something else.
    """
    wanted = [replace(variant.of(scene)) for variant in variants]
    for variant, changed in zip(variants, wanted, strict=True):
        check_scene(changed, where=f"the plan {variant.name}")
    settings = {"scene": files.scene_to_dict(scene), "profile": profile_name, "versions": versions(_VERSIONED)}
    _refuse_strangers(folder)
    found: dict[Variant, list[dict[str, Any]]] = {variant: [] for variant in variants}
    runs = list(itertools.product(range(seeds), zip(variants, wanted, strict=True)))
    for seed, (variant, changed) in tqdm(runs, desc="plans", unit="run", disable=not progress, dynamic_ncols=True):
        found[variant].append(_scored(changed, folder / "scores" / f"{variant.name}_seed{seed}.json", settings, profile_name, seed))
    failed = {v.name: score["failed"] for v, scores in found.items() for score in scores if "failed" in score}
    rows = [_row(variant, found[variant]) for variant in variants if variant.name not in failed]
    for name, reason in failed.items():
        say(f"{name} cannot be reconstructed: {reason}")
    if not rows:
        raise UserError("none of these plans can be reconstructed; see the reasons above and give others")
    write_bytes(folder / "plan.csv", _csv(rows).encode())
    write_json(folder / "plan.json", {**settings, "seeds": seeds, "failed": failed, "rows": [asdict(row) for row in rows]})
    _draw(rows, folder / "plan.png", title=f"{scene.name}, {profile_name}, {seeds} seed{'s' if seeds > 1 else ''}")
    say(table(rows))
    return rows


def best(rows: Sequence[Row], *, within: float) -> Row | None:
    """Return the plan with the fewest pictures whose worst volume error stays within a fraction; None when no plan does."""
    good = [row for row in rows if row.volume_error_worst <= within]
    return min(good, key=lambda row: (row.pictures * row.variant.image_wh[0] * row.variant.image_wh[1], row.capture_min), default=None)


def table(rows: Sequence[Row]) -> str:
    """Return the rows as lines of text for the terminal."""
    head = (
        f"{'heights (mm)':<14}{'views':>6}{'picture':>11}{'volume':>9}{'worst':>8}{'interval':>10}{'holds':>7}"
        f"{'recall':>8}{'prec.':>7}{'capture':>9}{'compute':>9}"
    )
    lines = [head, "-" * len(head)]
    for row in rows:
        v = row.variant
        heights = ", ".join(f"{height:g}" for height in v.heights_mm)
        size = f"{v.image_wh[0]}x{v.image_wh[1]}"
        lines.append(
            f"{heights:<14}{v.views:>6}{size:>11}{100 * row.volume_error:>+8.1f}%{100 * row.volume_error_worst:>7.1f}%"
            f"{100 * row.interval_width:>9.0f}%{100 * row.interval_holds:>6.0f}%{row.recall:>8.3f}{row.precision:>7.3f}"
            f"{row.capture_min:>5.1f} min{row.compute_s:>7.0f} s"
        )
    return "\n".join(lines)


def _refuse_strangers(folder: Path) -> None:
    known = {"scores", "plan.csv", "plan.json", "plan.png"}
    if folder.is_file() or (folder.is_dir() and any(path.name not in known for path in folder.iterdir() if not path.name.startswith("."))):
        raise UserError(f"{folder} holds something that is no earlier plan; choose another folder with -o")


def _scored(scene: Scene, path: Path, settings: dict[str, Any], profile_name: str, seed: int) -> dict[str, Any]:
    """Return the score of one run, from its file when the same run was made before."""
    from recon.pipeline import reconstruct
    from recon.score import score
    from sim.simulate import simulate

    made_with = json.loads(json.dumps({**settings, "run": files.scene_to_dict(scene), "seed": seed}))
    if path.is_file():
        try:
            before = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise UserError(f"{path} is damaged ({error}); delete it and run again") from error
        if isinstance(before, dict) and before.get("made_with") == made_with:
            return dict(before["score"])
    with tempfile.TemporaryDirectory(prefix="rhizotwin-plan-") as working:
        dataset, result = Path(working) / "dataset", Path(working) / "result"
        simulate(scene, dataset, profile_name=profile_name, seed=seed, progress=False)
        result.mkdir()
        try:
            reconstruct(dataset, result, progress=False)
            found = score(result, dataset).to_dict()
        except UserError as error:  # too few views, a strip out of sight: that is what is to be found out
            found = {"failed": str(error).replace(f"{working}/", "")}
    write_text(path, json.dumps({"made_with": made_with, "score": found}, indent=1) + "\n")
    return found


def _row(variant: Variant, scores: Sequence[dict[str, Any]]) -> Row:
    pictures = variant.views * len(variant.heights_mm)

    def median(key: str) -> float:
        return float(statistics.median(score[key] for score in scores))

    return Row(
        variant=variant,
        pictures=pictures,
        volume_error=median("volume_error"),
        volume_error_worst=max(abs(score["volume_error"]) for score in scores),
        interval_width=float(statistics.median(float(np.ptp(s["volume_interval_mm3"])) / s["volume_true_mm3"] for s in scores)),
        interval_holds=sum(bool(score["interval_holds_truth"]) for score in scores) / len(scores),
        recall=median("recall"),
        precision=median("precision"),
        capture_min=(pictures * VIEW_TIME_S + len(variant.heights_mm) * RING_TIME_S) / 60.0,
        compute_s=float(statistics.median(sum(score["timings_s"].values()) for score in scores)),
    )


def _csv(rows: Sequence[Row]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [name for name in asdict(rows[0]) if name != "variant"]
    writer.writerow(["heights_mm", "views_per_ring", "image_wh", *names])
    for row in rows:
        v = row.variant
        heights = " ".join(f"{height:g}" for height in v.heights_mm)
        writer.writerow([heights, v.views, f"{v.image_wh[0]}x{v.image_wh[1]}", *(getattr(row, name) for name in names)])
    return text.getvalue()


def _draw(rows: Sequence[Row], path: Path, *, title: str) -> None:
    """Draw error and recall against the number of views, a line for each set of rings and picture size."""
    from recon.pictures import figure

    drawn = figure(10.0, 4.6)
    left, right = drawn.subplots(1, 2)
    kinds = list(dict.fromkeys((row.variant.heights_mm, row.variant.image_wh) for row in rows))
    for heights_mm, image_wh in kinds:
        line = sorted(
            (row for row in rows if (row.variant.heights_mm, row.variant.image_wh) == (heights_mm, image_wh)),
            key=lambda row: row.variant.views,
        )
        label = f"{', '.join(f'{height:g}' for height in heights_mm)} mm, {image_wh[0]}x{image_wh[1]}"
        views = [row.variant.views for row in line]
        left.errorbar(
            views,
            [100.0 * row.volume_error for row in line],
            yerr=[100.0 * (row.volume_error_worst - abs(row.volume_error)) for row in line],
            marker="o",
            capsize=3,
            label=label,
        )
        right.plot(views, [row.recall for row in line], marker="o", label=f"recall, {label}")
        right.plot(views, [row.precision for row in line], marker="s", linestyle="--", color=right.lines[-1].get_color())
    left.axhline(0.0, color="0.6", linewidth=0.8)
    left.set_xlabel("views in a ring")
    left.set_ylabel("volume error (%), bars to the worst seed")
    left.legend(fontsize=8, title="camera heights, picture", title_fontsize=8)
    right.set_xlabel("views in a ring")
    right.set_ylabel("voxel recall (line), precision (dashed)")
    drawn.suptitle(title, fontsize=10)
    buffer = io.BytesIO()
    drawn.savefig(buffer, format="png", dpi=130)
    write_bytes(path, buffer.getvalue())
