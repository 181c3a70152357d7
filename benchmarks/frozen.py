"""Twelve frozen cases: pictures, result and all intermediate values, with which a changed reconstruction is compared.

    FROZEN/  frozen.json          commit of the reconstruction, versions, and the names of the cases
             CASE/  dataset/      pictures and truth
                    result/       result of the frozen reconstruction
                    stages/       cameras, coverage, hull, roots and solid in open formats (`recon.stages`)
                    score.json    score of the result
                    cost.json     times and memory

The folder contains everything that a comparison needs, so that it can be copied to another computer. It is compared by
meaning, through the result folder, because the fields of the stages change with the code.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import commits, datasets, masks_in_air, reconstructions, worker
from benchmarks.accuracy import percent
from benchmarks.cases import DEFAULT_VOXEL_MM, Case, Pictures
from benchmarks.output import markdown, stored_json, value_at
from benchmarks.run import Say
from rhizotwin.recon.results.parts import Leaves
from rhizotwin.recon.results.result import Result
from rhizotwin.scenes import atomic
from rhizotwin.scenes.errors import UserError
from rhizotwin.scoring.score_roots import compare_roots
from rhizotwin.scoring.score_topology import compare_topology
from rhizotwin.stored.load import load_result

SCHEMA_VERSION = 1
SAME = 1e-6
"""Difference relative to the largest element below which arrays are the same: sums over threads differ by 1e-7
(`docs/decisions/accuracy-ladder.md`)."""
AIR = "masks_in_air"
AIR_VOXEL_MM = 0.4
"""Voxel of the masks in air, as in `benchmarks.commit_comparison`."""
CASES: dict[str, Pictures | None] = {
    "demo": Pictures(scene="printed_8ml"),
    "radish_day05a": Pictures(scene="radish_day05a", rings=2, views=20),
    "radish_day15b_bench": Pictures(scene="radish_day15b", profile="bench"),
    "radish_day30c": Pictures(scene="radish_day30c"),
    "bean": Pictures(scene="bean"),
    "maize": Pictures(scene="maize"),
    "wheat": Pictures(scene="wheat"),
    "carrot": Pictures(scene="carrot"),
    "bulb": Pictures(scene="bulb"),
    "sphere_harsh": Pictures(scene="sphere_20mm", profile="harsh", seed=1, views=12, image_wh=(320, 240)),
    "swaying": Pictures(scene="radish_day15b", sway_mm=0.6),
    AIR: None,
}
"""Cases with their pictures; those of `AIR` are masks of a bean without refraction. The tips of the swaying plant move
by 0.6 mm, at which a third of its roots is missing until the sway is estimated."""


@dataclass(frozen=True, kw_only=True)
class Change:
    """Change of one kind of intermediate values."""

    kind: str
    """Cameras, opacity, hull, tubes, links or terms."""
    text: str
    """Size of the change in words, with units."""
    same: bool
    """Whether nothing changed but rounding."""


def freeze(folder: Path, names: Sequence[str], *, device: str, say: Say) -> list[dict[str, Any]]:
    """Reconstruct cases and keep pictures, intermediate values, result and score of each in a folder.

    Cases that the folder contains already are kept, if they are of the same reconstruction; a stopped run continues.

    Parameters
    ----------
    folder : Path
        New folder, or one of an earlier run.
    names : sequence of str
        Names of the cases, keys of `CASES`.
    device : str
        Computing device.
    say : Say
        Receives the progress.

    Returns
    -------
    list of dict
        Records (name, score and cost) of the cases.

    Raises
    ------
    UserError
        If a name is unknown, or the folder contains something else, or cases of another reconstruction.
    """
    check_names(names, tuple(CASES))
    commit = commits.last_of_reconstruction()
    if folder.is_dir() and any(folder.iterdir()):
        before = read(folder)
        if before["commit"] != commit:
            raise UserError(
                f"{folder} contains cases of commit {before['commit']}, but the reconstruction is now {commit}; choose another folder."
            )
    folder.mkdir(parents=True, exist_ok=True)
    about = {"schema_version": SCHEMA_VERSION, "commit": commit, "cases": [name for name in CASES if (folder / name).is_dir()]}
    atomic.write_json(folder / "frozen.json", about)
    for number, name in enumerate(names, start=1):
        goal = folder / name
        if not (goal / "score.json").is_file():
            shutil.rmtree(goal, ignore_errors=True)
            with tempfile.TemporaryDirectory(prefix=".freezing-", dir=folder) as working:
                _freeze_one(name, Path(working) / name, device=device)
                (Path(working) / name).rename(goal)
        about["cases"] = [one for one in CASES if (folder / one).is_dir()]
        atomic.write_json(folder / "frozen.json", about)
        say(f"[{number}/{len(names)}] {name}: {summary(read_record(goal))}")
    return [read_record(folder / name) for name in names]


def _freeze_one(name: str, goal: Path, *, device: str) -> None:
    goal.mkdir()
    pictures = CASES[name]
    if pictures is None:
        _write_in_air(goal / "dataset")
        worker.start(["reconstruct", str(goal / "dataset"), str(goal), "coverage", f"{AIR_VOXEL_MM}", "none", "--stages"], device=device)
    else:
        kept = reconstructions.make(Case(pictures=pictures), device=device, stages=True)
        for part, source in (("dataset", datasets.place(pictures)), ("result", kept / "result"), ("stages", kept / "stages")):
            shutil.copytree(source, goal / part, copy_function=_link)
        shutil.copy(kept / "cost.json", goal)
    found = worker.start(["score", str(goal / "result"), str(goal / "dataset"), "none"], device=device)
    atomic.write_json(goal / "score.json", found["score"])


def _link(source: str, target: str) -> None:
    """Create a hard link to a file, or copy it if that is not possible. Pictures are replaced, never modified."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def _write_in_air(goal: Path) -> None:
    """Write the dataset of masks in air, with its truth."""
    with tempfile.TemporaryDirectory(prefix="rhizotwin-in-air-") as working:
        words = masks_in_air.write(Path(working), truth=goal.with_name("truth"))
        from benchmarks.commit_comparison import run_once

        run_once(worker.ROOT, [*words, "-o", str(goal)])
    goal.with_name("truth").rename(goal / "truth")


def compare(folder: Path, names: Sequence[str] | None, *, device: str, say: Say) -> list[dict[str, Any]]:
    """Reconstruct frozen pictures with the present code, and compare intermediate values and scores.

    Parameters
    ----------
    folder : Path
        Folder made by `freeze`.
    names : sequence of str or None
        Names of the cases; None for all in the folder.
    device : str
        Computing device.
    say : Say
        Receives the comparison of each case.

    Returns
    -------
    list of dict
        Changes, scores and costs before and after, by case. A case that crashed has ``crashed`` with its error instead.

    Raises
    ------
    UserError
        If the folder was not made by `freeze` or is damaged, or a name is unknown.
    """
    known = read(folder)["cases"]
    check_names(names or (), known)
    rows: list[dict[str, Any]] = []
    for name in names or known:
        before = read_record(folder / name)
        voxel_mm = AIR_VOXEL_MM if name == AIR else DEFAULT_VOXEL_MM
        with tempfile.TemporaryDirectory(prefix="rhizotwin-against-") as working:
            goal, dataset = Path(working) / "now", folder / name / "dataset"
            try:
                worker.start(["reconstruct", str(dataset), str(goal), "coverage", f"{voxel_mm}", "none", "--stages"], device=device)
                score = worker.start(["score", str(goal / "result"), str(dataset), "none"], device=device)["score"]
            except RuntimeError as error:
                rows.append({"name": name, "crashed": str(error)})
                say(f"{name}: CRASHED\n{error}")
                continue
            cost = reconstructions.read_cost(goal) or {}
            changes = describe(load_result(folder / name / "result"), load_result(goal / "result"))
            changes.append(_compare_stages(folder / name / "stages", goal / "stages"))
        rows.append({"name": name, "changes": changes, "before": before, "after": {"name": name, "score": score, "cost": cost}})
        say(f"{name}:\n" + "\n".join(f"  {one.kind:<9} {one.text}" for one in changes))
    return rows


def describe(before: Result, after: Result) -> list[Change]:
    """Compare the intermediate values of two results of the same pictures, in the order of the stages."""
    return [_cameras(before, after), _opacity(before, after), _hull(before, after), *_tree(before, after), _terms(before, after)]


def _cameras(before: Result, after: Result) -> Change:
    pairs = [(old, new) for old, new in zip(before.cameras, after.cameras, strict=True) if old.used and new.used]
    poses = [[np.asarray(camera.cam_from_canister, np.float64) for camera in pair] for pair in pairs]
    moved = [float(np.linalg.norm(np.linalg.inv(old)[:3, 3] - np.linalg.inv(new)[:3, 3])) for old, new in poses]
    differ = sum(old.used != new.used for old, new in zip(before.cameras, after.cameras, strict=True))
    largest = max(moved, default=0.0)
    return Change(kind="cameras", text=f"at most {largest:.2g} mm apart; {differ} used in one only", same=largest < SAME and not differ)


def _opacity(before: Result, after: Result) -> Change:
    old, new = before.silhouettes, after.silhouettes
    both = [name for name in old if name in new]
    area = sum(float(old[name].coverage.sum(dtype=np.float64)) for name in both)
    apart = sum(float(np.abs(old[name].coverage - new[name].coverage).sum(dtype=np.float64)) for name in both)
    share = apart / area if area else 0.0
    return Change(
        kind="opacity", text=f"{100.0 * share:.3g} % of the covered area", same=share < SAME and len(both) == len(old) == len(new)
    )


def _hull(before: Result, after: Result) -> Change:
    old, new = before.solid.hull, after.solid.hull
    old_mm3, new_mm3 = (_volume_mm3(leaves) for leaves in (old, new))
    change = new_mm3 / old_mm3 - 1.0
    same = old.low.shape == new.low.shape and np.array_equal(old.low, new.low) and np.allclose(old.occupancy, new.occupancy, atol=SAME)
    return Change(kind="hull", text=f"{old_mm3:.1f} -> {new_mm3:.1f} mm3 ({percent(change)})", same=bool(same))


def _volume_mm3(leaves: Leaves) -> float:
    return float((leaves.size.astype(np.float64) ** 3 * leaves.occupancy).sum()) * leaves.voxel_mm**3


def _tree(before: Result, after: Result) -> list[Change]:
    old, new = before.solid.roots, after.solid.roots
    if not old or not new:
        same = not old and not new
        return [Change(kind=kind, text=f"{len(old)} -> {len(new)} roots", same=same) for kind in ("tubes", "links")]
    lines, tree = compare_roots(new, old), compare_topology(new, old)
    tubes = (
        f"length {lines.length_true_mm:.1f} -> {lines.length_mm:.1f} mm, {tree.ghosts_mm + tree.doubled_mm:.1f} mm added, "
        f"{tree.missing_mm:.1f} mm removed, radii {percent(lines.radius_error_median)}"
    )
    links = f"identity {tree.identity:.4f}, same parent {tree.parents:.3f}, same order {100.0 * tree.order_length:.1f} % of the length"
    moved = abs(lines.length_error) + tree.ghosts_mm + tree.missing_mm
    return [
        Change(kind="tubes", text=tubes, same=moved < SAME and abs(lines.radius_error_median) < SAME),
        Change(kind="links", text=links, same=tree.identity > 1.0 - SAME and tree.parents == tree.order_length == 1.0),
    ]


def _terms(before: Result, after: Result) -> Change:
    old, new = ({term.name: term.less_mm3 + term.more_mm3 for term in result.solid.volume.terms} for result in (before, after))
    apart = {name: abs(new.get(name, 0.0) - old.get(name, 0.0)) for name in old | new}
    name = max(apart, key=lambda one: apart[one], default="")
    text = f"{len(new)} terms; largest change: {name}, width {old.get(name, 0.0):.3g} -> {new.get(name, 0.0):.3g} mm3" if name else "none"
    return Change(kind="terms", text=text, same=not name or apart[name] <= SAME * before.solid.volume.mm3)


def _compare_stages(before: Path, after: Path) -> Change:
    """Compare the arrays of the stages by name: the first stage with a difference is where to look."""
    differing: list[str] = []
    for path in sorted(before.glob("*.npz"), key=lambda one: one.stat().st_mtime_ns):
        other = after / path.name
        with np.load(path, allow_pickle=False) as old:
            if not other.is_file():
                differing.append(f"{path.stem} (missing)")
                continue
            with np.load(other, allow_pickle=False) as new:
                unlike = [
                    key for key in sorted({*old.files, *new.files}) if key not in old or key not in new or not _alike(old[key], new[key])
                ]
        if unlike:
            differing.append(f"{path.stem} ({len(unlike)} arrays, first {unlike[0]})")
    return Change(kind="stages", text="differ: " + "; ".join(differing) if differing else "the same arrays", same=not differing)


def _alike(old: NDArray[Any], new: NDArray[Any]) -> bool:
    if old.shape != new.shape or old.dtype.kind != "f":
        return np.array_equal(old, new)
    size = float(np.nanmax(np.abs(old), initial=0.0, where=np.isfinite(old)))
    return np.allclose(old, new, rtol=0.0, atol=SAME * size, equal_nan=True)


def read(folder: Path) -> dict[str, Any]:
    """Return the description of a frozen folder; raise UserError if it is none, or damaged."""
    path = folder / "frozen.json"
    if not path.is_file():
        raise UserError(
            f"{folder} is not a folder of frozen cases: it contains no frozen.json; make one with `./run bench freeze -o {folder}`."
        )
    with stored_json(path, SCHEMA_VERSION, "freeze the cases again") as stored:
        found: dict[str, Any] = {"commit": str(stored["commit"]), "cases": [str(name) for name in stored["cases"]]}
    check_names(found["cases"], tuple(CASES))
    return found


def read_record(case_folder: Path) -> dict[str, Any]:
    """Return name, score and cost of a frozen case; raise UserError if a file is missing or damaged."""
    found: dict[str, Any] = {"name": case_folder.name}
    for name, needed in (("score", ("volume_error", "interval_holds_truth", "volume_trusted")), ("cost", ("cpu_s", "peak_memory_mib"))):
        try:
            found[name] = dict(json.loads((case_folder / f"{name}.json").read_text(encoding="utf-8")))
            lacking = [key for key in needed if key not in found[name]]
            if lacking:
                raise ValueError(f"{lacking[0]} is missing")
        except (OSError, ValueError, TypeError) as error:
            raise UserError(f"{case_folder / f'{name}.json'} cannot be read ({error}); freeze the case again.") from None
    return found


def check_names(names: Sequence[str], known: Sequence[str]) -> None:
    """Raise UserError if a name is not among the known ones."""
    unknown = [name for name in names if name not in known]
    if unknown:
        raise UserError(f"there is no frozen case {unknown[0]!r}; the cases are {', '.join(known)}.")


def summary(record: dict[str, Any]) -> str:
    """Return one line about a frozen case."""
    score, cost = record["score"], record["cost"]
    return f"volume {percent(score['volume_error'])}, processor {cost['cpu_s']:.0f} s"


_NUMBERS: tuple[tuple[str, str, float, str], ...] = (
    ("volume %", "volume_error", 100.0, "+.1f"),
    ("length %", "roots.length_error", 100.0, "+.1f"),
    ("diameter %", "traits.mean_diameter.error", 100.0, "+.1f"),
    ("tips p", "roots.tip_precision", 1.0, ".2f"),
    ("tips r", "roots.tip_recall", 1.0, ".2f"),
    ("identity", "topology.identity", 1.0, ".3f"),
    ("order %", "topology.order_length", 100.0, ".1f"),
    ("main %", "topology.main_length", 100.0, ".1f"),
    ("branch p", "topology.branch_precision", 1.0, ".2f"),
    ("branch r", "topology.branch_recall", 1.0, ".2f"),
    ("ghosts mm", "topology.ghosts_mm", 1.0, ".0f"),
    ("doubled mm", "topology.doubled_mm", 1.0, ".0f"),
    ("missing mm", "topology.missing_mm", 1.0, ".0f"),
)
"""Columns of the table: title, path in the score, factor and format."""


def compared_table(rows: Sequence[dict[str, Any]]) -> str:
    """Return the measures of all cases as a Markdown table; those that changed have two values."""
    titles = ["case", *(title for title, *_ in _NUMBERS), "interval", "trusted", "cpu s"]
    lines = []
    for row in rows:
        if "crashed" in row:
            lines.append([row["name"], "CRASHED", *([""] * (len(titles) - 2))])
            continue
        pairs = zip(*(_cells(row[one]) for one in ("before", "after")), strict=True)
        lines.append([row["name"], *(old if old == new else f"{old} -> {new}" for old, new in pairs)])
    return markdown(" | ".join(titles), lines)


def _cells(record: Mapping[str, Any]) -> list[str]:
    """Return the measures of a case as text."""
    score = record["score"]
    cells = [_cell(score, path, factor, form) for _, path, factor, form in _NUMBERS]
    cells.append("holds" if score["interval_holds_truth"] else "misses")
    cells.append("yes" if score["volume_trusted"] else "no")
    return [*cells, f"{record['cost']['cpu_s']:.0f}"]


def _cell(score: Mapping[str, Any], path: str, factor: float, form: str) -> str:
    value = value_at(score, path)
    return "-" if value is None else format(factor * value, form)
