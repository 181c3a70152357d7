"""Comparison of capture plans in simulation.

The plans differ in number of views, number of rings, camera heights and picture size. Each capture plan is simulated,
reconstructed and scored for a number of random seeds. All plans use the same seeds, so that random differences between
the plans cancel. `rhizotwin.planning.plan_report` formats the table and the figure.
"""

import itertools
import json
import shutil
import statistics
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from rhizotwin.planning import plan_report
from rhizotwin.planning.plans import Row, Variant
from rhizotwin.scenes import files
from rhizotwin.scenes.atomic import write_bytes, write_json, write_text
from rhizotwin.scenes.checks import check_scene
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import contents, lock_folder
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.plan import count_pictures
from rhizotwin.scenes.provenance import versions
from rhizotwin.scenes.terminal import OneBar
from rhizotwin.stored import sources

VIEW_TIME_S = 2.0
"""Time for rotation, settling and exposure of one view on the rig in the documentation, in seconds."""
RING_TIME_S = 10.0
"""Time that the camera needs to move to another ring, in seconds."""
SECOND_RING_MM = 52.0
"""Height of the second ring above the first ring, in mm, if a plan has two rings by default.

In the first ring at -42 mm, the top of a plant appears in front of the dark net pot. The second ring, 10 mm above the
rim, sees the top in front of the backlight.
"""
RUN = "unfinished"
"""Name of the subfolder for the run in progress. After an interruption, its pictures are used again."""
_VERSIONED = ("mitsuba", "drjit", "numpy", "scipy", "scikit-image", "opencv-python-headless")


def run_plans(
    scene: Scene,
    variants: Sequence[Variant],
    folder: Path,
    *,
    profile_name: str,
    seeds: int,
    bar: OneBar,
) -> list[Row]:
    """Simulate, reconstruct and score each capture plan, and reuse scores of an earlier run with the same settings.

    Parameters
    ----------
    scene : Scene
        Scene with the specimen and the simulated imperfections of the profile.
    variants : sequence of Variant
        Capture plans to compare.
    folder : path
        Output folder for ``scores/*.json``, ``plan.csv``, ``plan.json`` and ``plan.png``, and for `RUN` during a run.
    profile_name : str
        Name of the profile, for the output.
    seeds : int
        Number of runs per capture plan, with the random seeds 0, 1, ...
    bar : OneBar
        Progress bar, above which lines are printed; each run is a stage (`stage_of`).

    Returns
    -------
    list of Row
        Scores of the capture plans that could be reconstructed.

    Raises
    ------
    UserError
        If a plan is impossible in the scene, no plan can be reconstructed, or the folder contains other files.
    """
    wanted = [variant.of(scene) for variant in variants]
    for variant, changed in zip(variants, wanted, strict=True):
        check_scene(changed, where=f"the plan {variant.name}")
    settings = {
        "scene": files.scene_to_dict(scene),
        "specimens": sources.specimen_hashes(scene),
        "profile": profile_name,
        "versions": versions(_VERSIONED),
        "code": sources.digest_of_results(("rhizotwin.sim.simulate", "rhizotwin.recon.reconstruct", "rhizotwin.scoring.score")),
    }
    with lock_folder(folder):
        return _run(scene, list(zip(variants, wanted, strict=True)), folder, settings, seeds, bar)


def _run(
    scene: Scene,
    variants: Sequence[tuple[Variant, Scene]],
    folder: Path,
    settings: dict[str, Any],
    seeds: int,
    bar: OneBar,
) -> list[Row]:
    """Implement `run_plans` in a locked folder."""
    _refuse_strangers(folder)
    scores_of: dict[Variant, list[dict[str, Any]]] = {variant: [] for variant, _ in variants}
    runs = list(itertools.product(range(seeds), variants))
    pictures = {variant: count_pictures(changed) for variant, changed in variants}
    total = seeds * sum(pictures.values())
    bar.say(f"rendering and reconstructing {total} pictures in {len(runs)} runs; after an interruption, repeat the command to continue")
    for seed, (variant, changed) in runs:
        path = folder / "scores" / f"{variant.name}_seed{seed}.json"
        with bar.stage(stage_of(variant, seed)):
            scores_of[variant].append(_scored(changed, path, settings, seed))
    failed = {v.name: score["failed"] for v, scores in scores_of.items() for score in scores if "failed" in score}
    rows = [_row(variant, pictures[variant], scores_of[variant]) for variant, _ in variants if variant.name not in failed]
    for name, reason in failed.items():
        bar.say(f"the plan {name} could not be reconstructed: {reason}")
    if not rows:
        raise UserError("no plan could be reconstructed, for the reasons printed above; try other plans")
    write_bytes(folder / "plan.csv", plan_report.csv_text(rows).encode())
    write_json(folder / "plan.json", {**settings, "seeds": seeds, "failed": failed, "rows": [asdict(row) for row in rows]})
    plan_report.draw(rows, folder / "plan.png", title=f"{scene.name}, {settings['profile']}, {seeds} seed{'s' if seeds > 1 else ''}")
    bar.say(plan_report.table(rows))
    return rows


def stage_of(variant: Variant, seed: int) -> str:
    """Return the name of a run for the progress output.

    It consists of the name of the capture plan and the random seed.
    """
    return f"{variant.name}, seed {seed}"


def shares(variants: Sequence[Variant], seeds: int) -> dict[str, float]:
    """Return the estimated relative duration of each run.

    It is proportional to the number of pictures of the run.
    """
    return {stage_of(variant, seed): float(variant.views * len(variant.heights)) for variant in variants for seed in range(seeds)}


def best(rows: Sequence[Row], *, within: float) -> Row | None:
    """Return the cheapest plan that is accurate enough, or None if there is none.

    A plan is accurate enough if the largest absolute volume error over all seeds is at most ``within``. The cheapest
    plan has the fewest pixels in total. If several plans have the same number, it is the one with the shortest scan.
    """
    good = [row for row in rows if row.volume_error_worst <= within]
    return min(good, key=lambda row: (row.pictures * row.variant.image_wh[0] * row.variant.image_wh[1], row.capture_min), default=None)


def _refuse_strangers(folder: Path) -> None:
    known = {"scores", "plan.csv", "plan.json", "plan.png", RUN}
    if any(name not in known for name in contents(folder)):
        raise UserError(f"{folder} contains files that were not written by an earlier plan; choose another folder with -o")


def _scored(scene: Scene, path: Path, settings: dict[str, Any], seed: int) -> dict[str, Any]:
    """Simulate, reconstruct and score one run, or read its score from the file of an earlier run."""
    from rhizotwin.recon.reconstruct import reconstruct
    from rhizotwin.scoring.score import score
    from rhizotwin.sim.simulate import CannotContinueError, simulate

    made_with = json.loads(json.dumps({**settings, "run": files.scene_to_dict(scene), "seed": seed}))
    if path.is_file():
        try:
            before = json.loads(path.read_text(encoding="utf-8"))
        except (ValueError, RecursionError) as error:
            raise UserError(f"{path} is damaged ({error}); delete the file and run the command again") from error
        if isinstance(before, dict) and before.get("made_with") == made_with:
            return dict(before["score"])
    working = path.parents[1] / RUN
    dataset, result = working / "dataset", working / "result"
    try:
        simulate(scene, dataset, profile_name=settings["profile"], seed=seed)
    except CannotContinueError:  # pictures of another plan, whose run was interrupted
        shutil.rmtree(working)
        simulate(scene, dataset, profile_name=settings["profile"], seed=seed)
    shutil.rmtree(result, ignore_errors=True)
    result.mkdir()
    try:
        reconstruct(dataset).save(result)
        outcome = score(result, dataset).to_dict()
    except UserError as error:  # too few views or an invisible strip are valid outcomes of a plan
        outcome = {"failed": str(error).replace(f"{working}/", "")}
    write_text(path, json.dumps({"made_with": made_with, "score": outcome}, indent=1) + "\n")
    shutil.rmtree(working)
    return outcome


def _row(variant: Variant, pictures: int, scores: Sequence[dict[str, Any]]) -> Row:
    roots = [score.get("roots") for score in scores]
    lines = [line for line in roots if line is not None]
    has_roots = len(lines) == len(scores)
    lengths = [float(line["length_error"]) for line in lines] if has_roots else []

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
