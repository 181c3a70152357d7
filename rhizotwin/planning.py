"""What a lab asks before it builds.

How many views, odd or even, how many rings at which heights, how many pixels - answered by the twin.

Every capture plan is simulated, reconstructed from its pictures alone and scored, as often as there are seeds; the same
seeds for each, so that plans are compared and not chance. The table and the figure are in `rhizotwin.plan_report`.
"""

import itertools
import json
import shutil
import statistics
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from rhizotwin import plan_report, sources
from rhizotwin.plans import Row, Variant
from rhizotwin.scenes import files
from rhizotwin.scenes.atomic import write_bytes, write_json, write_text
from rhizotwin.scenes.checks import check_scene
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import contents, lock_folder
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.provenance import versions

VIEW_TIME_S = 2.0
"""Turning by a view, rest and exposure on the rig of the documentation: what a plan costs at the bench."""
RING_TIME_S = 10.0
"""Placing the camera for another ring."""
SECOND_RING_MM = 52.0
"""A second ring that is tried unasked stands this much above the first: from 10 mm above the rim a plant's top, which
from -42 mm is seen before the dark net pot, stands before the backlight."""
RUN = "unfinished"
"""Folder of the run under way; its pictures are taken up when it was stopped."""
_VERSIONED = ("mitsuba", "drjit", "numpy", "scipy", "scikit-image", "opencv-python-headless")


def run_plans(
    scene: Scene,
    variants: Sequence[Variant],
    folder: Path,
    *,
    profile_name: str,
    seeds: int,
    say: Callable[[str], None],
    monitor: Monitor | None = None,
) -> list[Row]:
    """Simulate, reconstruct and score every variant; what an earlier run with the same settings scored is taken over.

    Parameters
    ----------
    scene : Scene
        With its specimen and the profile's disturbances.
    folder : path
        Gets ``scores/*.json``, ``plan.csv``, ``plan.json``, ``plan.png``; `RUN` while a run is under way.
    seeds : int
        Runs of each variant, seeds 0, 1, ...
    monitor : Monitor or None
        Hears of each run as a stage (`stage_of`).

    Raises
    ------
    UserError
        For a plan that the scene does not allow, plans of which none can be reconstructed, or a folder of something
        else.
    """
    wanted = [variant.of(scene) for variant in variants]
    for variant, changed in zip(variants, wanted, strict=True):
        check_scene(changed, where=f"the plan {variant.name}")
    settings = {
        "scene": files.scene_to_dict(scene),
        "profile": profile_name,
        "versions": versions(_VERSIONED),
        "code": sources.digest(("rhizotwin.sim.simulate", "rhizotwin.recon.reconstruct", "rhizotwin.scoring.score")),
    }
    with lock_folder(folder):
        return _run(scene, list(zip(variants, wanted, strict=True)), folder, settings, profile_name, seeds, say, monitor or Monitor())


def _run(
    scene: Scene,
    variants: Sequence[tuple[Variant, Scene]],
    folder: Path,
    settings: dict[str, Any],
    profile_name: str,
    seeds: int,
    say: Callable[[str], None],
    monitor: Monitor,
) -> list[Row]:
    """Do what `run_plans` says in a folder that nobody else works in."""
    _refuse_strangers(folder)
    found: dict[Variant, list[dict[str, Any]]] = {variant: [] for variant, _ in variants}
    runs = list(itertools.product(range(seeds), variants))
    pictures = sum(variant.views * len(variant.heights) for variant, _ in variants) * seeds
    say(f"{len(runs)} runs, {pictures} pictures to render and reconstruct; a stopped run is taken up by the same command")
    for seed, (variant, changed) in runs:
        path = folder / "scores" / f"{variant.name}_seed{seed}.json"
        with monitor.stage(stage_of(variant, seed)):
            found[variant].append(_scored(changed, path, settings, profile_name, seed))
    failed = {v.name: score["failed"] for v, scores in found.items() for score in scores if "failed" in score}
    rows = [_row(variant, found[variant]) for variant, _ in variants if variant.name not in failed]
    for name, reason in failed.items():
        say(f"{name} cannot be reconstructed: {reason}")
    if not rows:
        raise UserError("none of these plans can be reconstructed; see the reasons above and give others")
    write_bytes(folder / "plan.csv", plan_report.csv_text(rows).encode())
    write_json(folder / "plan.json", {**settings, "seeds": seeds, "failed": failed, "rows": [asdict(row) for row in rows]})
    plan_report.draw(rows, folder / "plan.png", title=f"{scene.name}, {profile_name}, {seeds} seed{'s' if seeds > 1 else ''}")
    say(plan_report.table(rows))
    return rows


def stage_of(variant: Variant, seed: int) -> str:
    """Return what a run is called while it lasts."""
    return f"{variant.name}, seed {seed}"


def shares(variants: Sequence[Variant], seeds: int) -> dict[str, float]:
    """Return about how much of the time each run takes: a plan of twice as many pictures takes about twice as long."""
    return {stage_of(variant, seed): float(variant.views * len(variant.heights)) for variant in variants for seed in range(seeds)}


def best(rows: Sequence[Row], *, within: float) -> Row | None:
    """Return the plan with the fewest pixels whose worst volume error stays within a fraction.

    Of equals that with the shortest capture.

    None when no plan does.
    """
    good = [row for row in rows if row.volume_error_worst <= within]
    return min(good, key=lambda row: (row.pictures * row.variant.image_wh[0] * row.variant.image_wh[1], row.capture_min), default=None)


def _refuse_strangers(folder: Path) -> None:
    known = {"scores", "plan.csv", "plan.json", "plan.png", RUN}
    if any(name not in known for name in contents(folder)):
        raise UserError(f"{folder} holds something that is no earlier plan; choose another folder with -o")


def _scored(scene: Scene, path: Path, settings: dict[str, Any], profile_name: str, seed: int) -> dict[str, Any]:
    """Return the score of one run, from its file when the same run was made before."""
    from rhizotwin.recon.reconstruct import reconstruct
    from rhizotwin.scoring.score import score
    from rhizotwin.sim.simulate import CannotContinueError, simulate

    made_with = json.loads(json.dumps({**settings, "run": files.scene_to_dict(scene), "seed": seed}))
    if path.is_file():
        try:
            before = json.loads(path.read_text(encoding="utf-8"))
        except (ValueError, RecursionError) as error:
            raise UserError(f"{path} is damaged ({error}); delete it and run again") from error
        if isinstance(before, dict) and before.get("made_with") == made_with:
            return dict(before["score"])
    working = path.parents[1] / RUN
    dataset, result = working / "dataset", working / "result"
    try:
        simulate(scene, dataset, profile_name=profile_name, seed=seed)
    except CannotContinueError:  # pictures of another plan, whose run was stopped
        shutil.rmtree(working)
        simulate(scene, dataset, profile_name=profile_name, seed=seed)
    shutil.rmtree(result, ignore_errors=True)
    result.mkdir()
    try:
        reconstruct(dataset).save(result)
        found = score(result, dataset).to_dict()
    except UserError as error:  # too few views, a strip out of sight: that is what is to be found out
        found = {"failed": str(error).replace(f"{working}/", "")}
    write_text(path, json.dumps({"made_with": made_with, "score": found}, indent=1) + "\n")
    shutil.rmtree(working)
    return found


def _row(variant: Variant, scores: Sequence[dict[str, Any]]) -> Row:
    pictures = variant.views * len(variant.heights)
    roots = [score.get("roots") for score in scores]
    lines = [found for found in roots if found is not None]
    has_roots = len(lines) == len(scores)
    lengths = [float(found["length_error"]) for found in lines] if has_roots else []

    def median(key: str) -> float:
        return float(statistics.median(score[key] for score in (lines if has_roots else scores)))

    return Row(
        variant=variant,
        pictures=pictures,
        volume_error=float(statistics.median(score["volume_error"] for score in scores)),
        volume_error_worst=max(abs(score["volume_error"]) for score in scores),
        volume_errors=tuple(score["volume_error"] for score in scores),
        interval_width=float(statistics.median(float(np.ptp(s["volume_interval_mm3"])) / s["volume_true_mm3"] for s in scores)),
        interval_holds=sum(bool(score["interval_holds_truth"]) for score in scores) / len(scores),
        length_error=statistics.median(lengths) if lengths else None,
        length_error_worst=max(map(abs, lengths)) if lengths else None,
        length_errors=tuple(lengths),
        recall=median("recall"),
        precision=median("precision"),
        capture_min=(pictures * VIEW_TIME_S + len(variant.heights) * RING_TIME_S) / 60.0,
        compute_s=float(statistics.median(sum(score["timings_s"].values()) for score in scores)),
    )
