"""Growth from reconstructions: identities of roots over days, elongation rates, and detection of treatment effects.

There are three measurements. One plant is rendered and reconstructed on several days, its roots are linked by
`rhizotwin growth`, and checked against the labels of the simulator. Sets of plants under two treatments, equal or not,
are compared by their true total lengths with the error of a scan. Sets of plants in solutions of several concentrations
are used to fit a dose response. The last two render nothing.
"""

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks import cache, datasets
from benchmarks.run import Say
from rhizotwin.experiment.compare import Observation, differences
from rhizotwin.experiment.doses import fit_responses
from rhizotwin.experiment.matching import Day, TrackedPlant, track_roots
from rhizotwin.scenes import polyline, rsml, series
from rhizotwin.scenes.files import load_profile, load_scene, scene_to_dict
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.provenance import versions
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.rsml_reader import read_rsml
from rhizotwin.scenes.solution import Solution
from rhizotwin.stored import sources

Array = NDArray[np.float64]

SCENE, DAYS = "radish_day15b", (5.0, 7.0, 9.0, 11.0, 13.0, 15.0)
IMAGE_WH = (600, 450)
NEAR_MM = 0.5
"""Maximum distance of a reconstructed from a true line, as in the score of roots."""
STEP_MM = 0.2
LEAST_RATE = 0.05
"""Minimum elongation rate in mm per day; slower roots have stopped, and their relative error is undefined."""
TREATED, PLANTS, LENGTH_ERROR = 0.85, 3, 0.03
"""Growth factor of the treated plants, number of plants per treatment, and standard error of a scan's total length (the
worst group of the ladder, docs/accuracy.md, has 4 %, clean and bench ones 1 %)."""
TREATMENT_DAYS = (5.0, 8.0, 11.0, 14.0, 17.0, 20.0)
DOSED, POTASSIUM, RESPONSE = 24, (0.25, 0.5, 1.0, 2.0), 0.02
"""Number of plants of a dose response, factors of potassium, and change of the growth's logarithm per mmol/l."""
_SEEDS_APART = 7919
"""Difference of seeds between sets of plants, which have no plant in common."""


@dataclass(frozen=True, kw_only=True)
class Links:
    """Correctness of links between the roots of successive days."""

    roots: tuple[int, ...]
    """Number of reconstructed roots on each day."""
    roots_true: tuple[int, ...]
    """Number of true roots on each day."""
    linked: int
    """Number of links between reconstructed roots."""
    right: int
    """Number of links between roots with the same true root."""
    both_found: int
    """Number of true roots reconstructed on both days, which is the number of possible links."""
    both_there: int
    """Number of true roots present on both days."""
    rate_errors: tuple[float, ...]
    """Absolute error of the elongation rate relative to the true rate, for each link."""

    @property
    def precision(self) -> float:
        """Fraction of the links that are correct."""
        return self.right / max(1, self.linked)

    @property
    def recall(self) -> float:
        """Fraction of the roots reconstructed on both days that are linked."""
        return self.right / max(1, self.both_found)

    @property
    def recall_of_all(self) -> float:
        """Fraction of the roots present on both days that are linked."""
        return self.right / max(1, self.both_there)

    def plain(self) -> dict[str, Any]:
        """Return all numbers as a JSON object."""
        median = statistics.median(self.rate_errors) if self.rate_errors else None
        shares = {"precision": self.precision, "recall": self.recall, "recall_of_all": self.recall_of_all}
        return asdict(self) | shares | {"rate_error_median": median}


def scene_on_day(day: float, profile: str) -> Scene:
    """Return the plant's scene on a day."""
    from rhizotwin.sim.growth import grow

    scene = load_scene(SCENE)
    scene = replace(scene, camera=scene.camera.resized(IMAGE_WH), disturbances=load_profile(profile))
    scene = replace(scene, subject=replace(scene.subject, plant="P1", species="Raphanus sativus"))
    return replace(series.at_day(scene, day, grow=grow, like=series.require_grown(scene)), name=f"day{day:04.1f}")


def place(profile: str) -> Path:
    """Return the folder of the plant's pictures and results in the cache, another one for other scenes or sources."""
    scenes = [scene_to_dict(scene_on_day(day, profile)) for day in DAYS]
    settings = {"scenes": scenes, "profile": profile, "mitsuba": versions(("mitsuba",))["mitsuba"]}
    return cache.folder() / "growth" / cache.key(settings, sources=sources.digest(datasets.PICTURES))


def measure(profile: str, *, say: Say) -> Links:
    """Render and reconstruct the plant on its days (reusing finished ones), and check the links between its roots."""
    from rhizotwin.batches import collect
    from rhizotwin.batches.run import run
    from rhizotwin.sim.simulate import simulate

    folder = place(profile)
    for seed, day in enumerate(DAYS):  # each day has its own seed, as a rig never repeats exactly
        scan = folder / "scans" / f"day{day:04.1f}"
        if not (scan / "dataset.json").is_file():
            say(f"rendering {scan.name}")
            simulate(scene_on_day(day, profile), scan, profile_name=profile, seed=seed)
    jobs = collect.reconstructions([str(folder / "scans")], str(folder / "results"), voxel_mm=None, settings=None, device="auto")
    run(jobs, str(folder / "results"))
    return links(folder / "scans", folder / "results")


def links(scans: Path, results: Path) -> Links:
    """Link the roots of results by day, and check the links by the truth of the scans with the same names."""
    names = [f"day{day:04.1f}" for day in DAYS]
    found = [read_rsml(results / name / "roots.rsml") for name in names]
    true = [{root.label: root for root in read_rsml(scans / name / "truth" / "skeleton.rsml")} for name in names]
    followed = track_roots([Day(day=day, roots=roots) for day, roots in zip(DAYS, found, strict=True)])
    labels = [match_labels(roots, of) for roots, of in zip(found, true, strict=True)]
    return _check_links(followed, labels, true)


def _check_links(followed: TrackedPlant, labels: Sequence[Sequence[str]], true: Sequence[Mapping[str, Root]]) -> Links:
    linked = right = both_found = both_there = 0
    errors: list[float] = []
    for k in range(1, len(DAYS)):
        before = dict(zip(followed.names[k - 1], range(len(labels[k - 1])), strict=True))
        both_found += len(set(labels[k - 1]) & set(labels[k]) - {""})
        both_there += len(set(true[k - 1]) & set(true[k]))
        for now, name in enumerate(followed.names[k]):
            if name not in before:
                continue
            linked += 1
            label = labels[k][now]
            if label and label == labels[k - 1][before[name]]:
                right += 1
                days = DAYS[k] - DAYS[k - 1]
                rate = (rsml.length_mm([true[k][label]]) - rsml.length_mm([true[k - 1][label]])) / days
                found = followed.days[k].roots[now], followed.days[k - 1].roots[before[name]]
                grown = rsml.length_mm(found[:1]) - rsml.length_mm(found[1:])
                errors += [abs(grown / days / rate - 1.0)] if rate > LEAST_RATE else []
    return Links(
        roots=tuple(len(day) for day in labels),
        roots_true=tuple(len(day) for day in true),
        linked=linked,
        right=right,
        both_found=both_found,
        both_there=both_there,
        rate_errors=tuple(errors),
    )


def match_labels(found: Sequence[Root], true: Mapping[str, Root]) -> list[str]:
    """Return the label of the true root of each reconstructed root; empty if there is none.

    It is the one with most of the reconstructed line, if that is at least half. Of several pieces of one true root, the
    one with the largest part of it gets its label, and the others none.
    """
    labels = list(true)
    points = [_dense(root) for root in true.values()]
    owner = np.repeat(np.arange(len(points)), [len(one) for one in points])
    tree = cKDTree(np.concatenate(points))
    best: dict[int, tuple[int, int]] = {}
    for number, root in enumerate(found):
        away, nearest = tree.query(_dense(root))
        on = np.bincount(owner[nearest[away < NEAR_MM]], minlength=len(labels))
        most = int(np.argmax(on))
        if on[most] >= 0.5 * len(away) and on[most] > best.get(most, (0, 0))[0]:
            best[most] = (int(on[most]), number)
    told = {number: labels[most] for most, (_, number) in best.items()}
    return [told.get(number, "") for number in range(len(found))]


def _dense(root: Root) -> Array:
    way = polyline.arc_length_mm(root.points_mm)
    return polyline.interpolate(root.points_mm, way, polyline.middles(way, STEP_MM))


def treatments(sets: int, *, effect: float, say: Say) -> list[bool]:
    """Return for each set of plants (two treatments) whether their total lengths differ significantly.

    Parameters
    ----------
    sets : int
        Number of sets, each with its own plants.
    effect : float
        Factor of elongation rate and length of the roots of the second treatment; 1 for no effect.

    Returns
    -------
    list of bool
    """
    from rhizotwin.sim.growth import grow

    scene, apart = load_scene(SCENE), []
    for number in range(sets):
        rng, seen = np.random.default_rng([number, round(1000 * effect)]), []
        for place, (name, growth) in enumerate((("control", 1.0), ("treated", effect))):
            for k in range(PLANTS):
                plant = series.replicate(
                    series.apply_treatment(scene, name, growth), k, seed=1 + _SEEDS_APART * number + PLANTS * place + k
                )
                for day in TREATMENT_DAYS:
                    length = rsml.length_mm(grow(replace(series.require_grown(plant), age_days=day))) * np.exp(
                        rng.normal(0.0, LENGTH_ERROR)
                    )
                    seen.append(Observation(plant=f"{name} {k}", treatment=name, day=day, value=float(length)))
        apart.append(differences(seen)[0].is_significant)
        say(f"[{number + 1}/{sets}] growth {effect:g}: {'distinguished' if apart[-1] else 'not distinguished'}")
    return apart


def responses(sets: int, *, say: Say) -> tuple[float, list[tuple[float, float]]]:
    """Return the true slope of total length against potassium, and the 90 % interval of each set.

    Every set has `DOSED` plants in solutions of `POTASSIUM` times the thesis's potassium, whose roots grow faster by
    `RESPONSE` per mmol/l. The true slope is that of the plants of all sets together, without the error of scans: for 20
    sets its own error is less than a quarter of that of one set.

    Parameters
    ----------
    sets : int
        Number of sets, each with its own plants.
    """
    from rhizotwin.sim.growth import grow

    scene = replace(load_scene(SCENE), solution=Solution(recipe="kliman_2022"))
    middle = scene.solution.ions_mmol_per_l["K"]
    intervals: list[tuple[float, float]] = []
    exact: list[Observation] = []
    doses: dict[str, Mapping[str, float]] = {}
    for number in range(sets):
        rng, seen = np.random.default_rng([number, DOSED]), []
        for k in range(DOSED):
            factor = POTASSIUM[k % len(POTASSIUM)]
            growth = float(np.exp(RESPONSE * middle * (factor - 1.0)))
            plant = series.replicate(series.apply_treatment(scene, "", growth, {"K": factor}), k, seed=1 + _SEEDS_APART * (number + 1) + k)
            name = f"{number}-{k}"
            doses[name] = plant.solution.ions_mmol_per_l
            for day in TREATMENT_DAYS:
                length = rsml.length_mm(grow(replace(series.require_grown(plant), age_days=day)))
                exact.append(Observation(plant=name, treatment="", day=day, value=length))
                seen.append(replace(exact[-1], value=length * float(np.exp(rng.normal(0.0, LENGTH_ERROR)))))
        intervals.append(fit_responses(seen, doses)[0].slope_interval)
        say(f"[{number + 1}/{sets}] slope {intervals[-1][0]:.4f} to {intervals[-1][1]:.4f} l/mmol")
    return fit_responses(exact, doses)[0].slope, intervals
