"""Growth: one plant at several ages laid on itself, roots with identities, rates, treatments, and the command over result folders."""

import csv
import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation
from scipy.stats import linregress, ttest_ind
from scipy.stats import t as student

from rhizotwin.experiment.alignment import align
from rhizotwin.experiment.compare import Observation, differences, means, reason_not_comparable, relative_rates
from rhizotwin.experiment.growth import measure, treatments_csv
from rhizotwin.experiment.matching import Day, TrackedPlant, track_roots
from rhizotwin.experiment.measured import Measured
from rhizotwin.scenes import files, rsml, series
from rhizotwin.scenes.assessment import Assessment
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.subject import Subject
from rhizotwin.sim.growth import grow
from tests.command import Command

DAYS = (5.0, 8.0, 11.0, 14.0)
JITTER_MM, LOST, CUT = 0.15, 0.05, 0.1
"""What a reconstruction gets wrong: its lines by so much over 2 mm, laterals that it misses, and laterals of which it misses the end."""


def length(root: Root) -> float:
    return float(np.linalg.norm(np.diff(root.points_mm, axis=0), axis=1).sum())


def wobble(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return smooth errors of a line, whose spread after smoothing is `JITTER_MM`."""
    return gaussian_filter1d(rng.normal(0.0, JITTER_MM / 0.38, (count, 3)), 2.0, axis=0, mode="nearest")


def seen_wrongly(roots: list[Root], rng: np.random.Generator) -> tuple[Root, ...]:
    """Return a plant as a scan might show it: in a frame of its own, with roots missing, cut and wobbling; labels are kept."""
    turn = Rotation.from_rotvec(np.deg2rad(rng.normal(0.0, 0.5, 3))).as_matrix()
    shift, place, shown = rng.normal(0.0, 0.3, 3), {-1: -1}, []
    for index, root in enumerate(roots):
        missed = root.order > 0 and (length(root) < 2.0 or rng.random() < LOST)
        if root.parent not in place or missed:
            continue
        end = len(root.points_mm)
        if root.order > 0 and end > 6 and rng.random() < CUT:
            end = int(end * rng.uniform(0.6, 1.0))
        points = root.points_mm[:end]
        moved = (points + wobble(rng, len(points))) @ turn.T + shift
        place[index] = len(shown)
        shown.append(replace(root, points_mm=moved, diameters_mm=root.diameters_mm[:end], parent=place[root.parent]))
    return tuple(shown)


@pytest.fixture(scope="module")
def plant() -> dict[float, list[Root]]:
    """Return a plant at its ages."""
    scene = files.load_scene("radish_day15b")
    specimen = series.require_grown(scene)
    return {day: grow(replace(specimen, age_days=day)) for day in DAYS}


def links(tracked: TrackedPlant, shown: dict[float, tuple[Root, ...]]) -> tuple[float, float]:
    """Return precision and recall of the links between neighbouring days, by the labels that the simulator gave."""
    right = wrong = missed = 0
    labels = [dict(zip(names, (root.label for root in own), strict=True)) for names, own in zip(tracked.names, shown.values(), strict=True)]
    for before, after in pairwise(labels):
        linked = [before[name] == label for name, label in after.items() if name in before]
        right, wrong = right + sum(linked), wrong + len(linked) - sum(linked)
        missed += len(set(before.values()) & set(after.values())) - sum(linked)
    return right / (right + wrong), right / (right + missed)


def test_a_moved_plant_is_brought_back(plant: dict[float, list[Root]]) -> None:
    turn, shift = Rotation.from_euler("zx", [4.0, 1.0], degrees=True).as_matrix(), np.array([1.0, -0.5, 0.3])
    moved = [replace(root, points_mm=root.points_mm @ turn.T + shift) for root in plant[11.0]]
    found = align(plant[8.0], moved)
    away = np.concatenate([found.of(root.points_mm) - original.points_mm for root, original in zip(moved, plant[11.0], strict=True)])
    assert np.median(np.linalg.norm(away, axis=1)) < 0.05


def test_a_plant_with_a_single_root_is_not_rotated_about_it() -> None:
    """The errors of the centre lines alone gave rotations of up to 50 degrees, and laterals of later days followed them."""
    rng, z = np.random.default_rng(0), np.linspace(0.0, 1.0, 200)

    def straight(length_mm: float) -> list[Root]:
        points = np.stack([0.0 * z, 0.0 * z, -length_mm * z], axis=1) + wobble(rng, 200)
        return [Root(points_mm=points, diameters_mm=1.0 + z, order=0, parent=-1)]

    turns = [align(straight(30.0), straight(60.0)).younger_from_older[:3, :3] for _ in range(5)]
    assert np.rad2deg(Rotation.from_matrix(turns).magnitude()).max() < 2.0


def test_roots_keep_their_identity_through_noise_cuts_and_gaps(plant: dict[float, list[Root]]) -> None:
    rng = np.random.default_rng(8)
    shown = {day: seen_wrongly(roots, rng) for day, roots in plant.items()}
    tracked = track_roots([Day(day=day, roots=roots) for day, roots in shown.items()])
    precision, recall = links(tracked, shown)
    assert precision >= 0.95
    assert recall >= 0.9
    true = {day: {root.label: length(root) for root in roots} for day, roots in plant.items()}
    label = {name: root.label for k, day in enumerate(shown) for name, root in zip(tracked.names[k], shown[day], strict=True)}
    errors = []
    for track in tracked.tracks:
        of = label[track.name]
        for begin, end, rate in track.rates_mm_per_day:
            expected = (true[end][of] - true[begin][of]) / (end - begin) if of in true[begin] else 0.0
            errors += [abs(rate / expected - 1.0)] if expected > 0.05 else []
    assert len(errors) > 20
    assert np.median(errors) < 0.10


def test_without_errors_rates_and_days_of_emergence_are_true(plant: dict[float, list[Root]]) -> None:
    tracked = track_roots([Day(day=day, roots=tuple(roots)) for day, roots in plant.items()])
    assert links(tracked, {day: tuple(roots) for day, roots in plant.items()}) == (1.0, 1.0)
    taproot = tracked.tracks[0]
    assert taproot.rates_mm_per_day[0][2] == pytest.approx((length(plant[8.0][0]) - length(plant[5.0][0])) / 3.0)
    assert all(track.absent_day <= track.emergence_day <= track.states[0].day for track in tracked.tracks)


def scanned(seed: int, days: dict[str, tuple[float, ...]], *, plants: int, again: bool = True, effect: float = 1.0) -> list[Observation]:
    """Return plants that grow by 0.2 per day and vary by 8 %; without ``again``, each scan is of another plant."""
    rng, seen = np.random.default_rng(seed), []
    for treatment, own in days.items():
        for k in range(plants):
            size = float(np.exp(rng.normal(0.0, 0.08))) * (effect if treatment == "B" else 1.0)
            for day in own:
                error = float(np.exp(rng.normal(0.0, 0.03 if again else 0.08)))
                name = f"{treatment}{k}" if again else f"{treatment}{k} of day {day:g}"
                value = (size if again else 1.0) * error * 100.0 * float(np.exp(0.2 * day))
                seen.append(Observation(plant=name, treatment=treatment, day=day, value=value))
    return seen


@pytest.mark.parametrize("effect", [1.0, 1.1])
def test_of_complete_data_the_size_is_a_t_test_of_means(effect: float) -> None:
    pytest.importorskip("statsmodels")
    days = (5.0, 10.0, 15.0, 20.0, 25.0, 30.0)
    seen = scanned(0, {"A": days, "B": days}, plants=3, effect=effect)
    groups = [[np.mean([np.log(one.value) for one in seen if one.plant == f"{group}{k}"]) for k in range(3)] for group in "BA"]
    test, found = ttest_ind(*groups), differences(seen)[0]
    assert found.size == pytest.approx(np.exp(np.mean(groups[0]) - np.mean(groups[1])), rel=1e-3)
    assert found.size_p == pytest.approx(test.pvalue, rel=0.05)
    assert np.log(found.size_interval) == pytest.approx([*test.confidence_interval(0.9)], abs=0.005)


def test_levels_of_days_need_common_days_and_degrees_of_freedom() -> None:
    """One plant per harvest is compared as a line through the differences of the days, with one degree of freedom."""
    pytest.importorskip("statsmodels")
    seen = scanned(1, {"A": (1.0, 3.0, 5.0), "B": (1.0, 3.0, 6.0), "C": (1.0, 4.0, 6.0)}, plants=4)
    why = "the treatments 'A' and 'C' share too few days; scan all treatments on the same days"
    assert reason_not_comparable(seen) == why
    with pytest.raises(UserError, match="share too few days"):
        differences(seen)
    assert reason_not_comparable([one for one in seen if one.treatment != "C"]) == ""
    seen = scanned(1, {"A": (1.0, 2.0, 3.0), "B": (1.0, 2.0, 3.0)}, plants=1, again=False)
    size = {(one.treatment, one.day): np.log(one.value) for one in seen}
    line = linregress((-1.0, 0.0, 1.0), [size["B", day] - size["A", day] for day in (1.0, 2.0, 3.0)])
    expected = 2.0 * student.sf(abs(line.intercept / line.intercept_stderr), 1)
    assert differences(seen)[0].size_p == pytest.approx(expected, rel=1e-6)
    two = scanned(1, {"A": (1.0, 2.0), "B": (1.0, 2.0)}, plants=1, again=False)
    assert reason_not_comparable(two).startswith("the treatments 'A' and 'B' have 4 scans, too few to estimate an uncertainty")


def test_means_have_intervals_and_rates_are_of_logarithms() -> None:
    seen = [Observation(plant=p, treatment="a", day=day, value=v * day) for p, v in (("x", 1.0), ("y", 3.0)) for day in (1.0, 2.0)]
    first = means(seen)[0]
    assert (first.mean, first.plants) == (2.0, 2)
    reach = 6.3138 * (2.0**0.5 / 2.0**0.5) / 2.0  # Student's t of one degree of freedom, relative standard error
    assert (first.low, first.high) == pytest.approx((2.0 * np.exp(-reach), 2.0 * np.exp(reach)), rel=1e-4)
    assert 0.0 < means(seen, most=10.0)[0].low < means(seen, most=10.0)[0].high < 10.0
    assert [rate for *_, rate in relative_rates(seen)] == pytest.approx([np.log(2.0)] * 2)


FALLS = {
    "dies": ((0.1, 1.0), "it may have died or been replaced"),
    "nothing left": ((0.0, 1.0), "it may have died or been replaced"),
    "exchanged": ((1.6, 1.0 / 1.6), "it may have been exchanged with plant B0"),
    "within the error": ((0.7, 1.0), None),
}


@pytest.mark.parametrize(("factors", "cause"), FALLS.values(), ids=FALLS.keys())
def test_a_plant_whose_size_falls_is_named_and_left_out(factors: tuple[float, float], cause: str | None) -> None:
    pytest.importorskip("statsmodels")
    rng, start, found = np.random.default_rng(2), {"A": 200.0, "B": 125.0}, []
    for name, day in product(("A0", "A1", "A2", "B0", "B1", "B2"), (1.0, 2.0, 3.0)):
        value = start[name[0]] * 1.3**day * np.exp(rng.normal(0.0, 0.03))
        value *= dict(zip(("B0", "A0"), factors, strict=True)).get(name, 1.0) if day == 3.0 else 1.0
        known = Assessment(verdict="reliable", interval=(0.9 * value, 1.1 * value))
        whose = Subject(plant=name, treatment=name[0], day=day)
        found.append(Measured(name=name, subject=whose, traits={"volume": value}, assessed={"volume": known}))
    grown = measure(found)
    told = [sentence for sentence in grown.notes if "fell" in sentence]
    assert len(told) == (cause is not None)
    assert len(list(csv.DictReader(treatments_csv(grown).splitlines()))) == 1 + len(told)
    if cause:
        named = "A0" if factors[0] > 1.0 else "B0"
        assert told[0].startswith(f"plant {named}, day 3: volume_mm3 fell from")
        assert told[0].endswith(f"since day 2, by more than the error; {cause}")
        assert grown.compared_without["volume"][0].size == pytest.approx(125.0 / 200.0, rel=0.05)


def test_the_command_writes_curves_roots_and_rsml_with_time(
    ball_result: Callable[..., Path], plant: dict[float, list[Root]], command: Command, tmp_path: Path
) -> None:
    """Results are of four plants, two treatments and three days."""
    pytest.importorskip("statsmodels")
    rng, out = np.random.default_rng(3), tmp_path / "growth"
    for number, treatment in enumerate(("control", "control", "low N", "low N")):
        for day, error in zip(DAYS[:3], rng.normal(1.0, 0.03, 3), strict=True):
            who = {"plant": f"P{number}", "treatment": treatment, "day": day, "species": "Raphanus sativus"}
            folder = ball_result(f"results/P{number}_{day:g}", subject=who, volume_mm3=100.0 * day * (1.0 + 0.03 * number) * error)
            rsml.write_rsml(folder / "roots.rsml", [root for root in plant[day] if root.order < 2])
    told = command.works("growth", tmp_path / "results", "-o", out).out
    assert "volume: 'low N' does not differ significantly from 'control'" in told
    rows = list(csv.DictReader((out / "roots.csv").read_text(encoding="utf-8").splitlines()))
    taproot = [row for row in rows if (row["plant"], row["root"]) == ("P0", "1")]
    assert [float(row["day"]) for row in taproot] == list(DAYS[:3])
    written = sorted((out / "rsml").glob("*.rsml"))
    assert len(written) == 12
    text = written[0].read_text(encoding="utf-8")
    assert "<unified>true</unified>" in text


def test_roots_of_another_plant_in_the_canister_are_not_tracked(ball_result: Callable[..., Path]) -> None:
    """On day 1 only the roots of B were found, and on day 2 those of neither A nor D."""
    found, z = [], np.linspace(0.0, 1.0, 9)
    for day, plants in ((1.0, "B"), (2.0, "BC"), (3.0, "ABC"), (4.0, "ABC")):
        folder = ball_result(f"day{day:g}", subject={"plant": "", "day": day})
        lines = [np.stack([20.0 * k + z**2, z**3, -9.0 * day * z], axis=1) for k in range(len(plants))]
        roots = [
            Root(points_mm=line, diameters_mm=z + 1.0, order=0, parent=-1, plant=name) for line, name in zip(lines, plants, strict=True)
        ]
        rsml.write_rsml(folder / "roots.rsml", roots)
        found += [Measured(name=f"{day:g}", subject=Subject(plant=name, day=day), traits={"tips": 1.0}, folder=folder) for name in "AB"]
    tracked = measure(found).tracked
    assert {plant: [day.day for day in own.days] for plant, own in tracked.items()} == {"A": [3.0, 4.0], "B": [1.0, 2.0, 3.0, 4.0]}


def test_mistakes_are_one_sentence(ball_result: Callable[..., Path], tmp_path: Path, command: Command) -> None:
    pytest.importorskip("statsmodels")

    def result(name: str, plant: str, treatment: str, day: float, *, columns: int = 31) -> Path:
        whose = {"plant": plant, "treatment": treatment, "day": day}
        return ball_result(f"results/{name}", subject=whose, strip={"columns": columns})

    for k, treatment in enumerate(("control", "control", "low N", "low N")):
        result(f"P{k}", f"P{k}", treatment, 8.0)
    for treatment, day, columns, named in (
        ("control", 8.0, 31, "plant P0 occurs twice on day 8"),
        ("low N", 20.0, 31, "plant P0 has two treatments"),
        ("control", 20.0, 29, "P0 and more were scanned with different marker strips"),
    ):
        added = result("more", "P0", treatment, day, columns=columns)
        command.fails("growth", tmp_path / "results", "-o", tmp_path / "growth", named=[named])
    shutil.rmtree(added)
    formula = r"$\frac$"
    for day in (20.0, 24.0):
        result(f"P9_{day:g}", "P9", formula, day)
    told = command.works("growth", tmp_path / "results", "-o", tmp_path / "growth")
    assert f"treatment {formula!r} has 1 plant" in told.out + told.err
