"""Growth of many plants: curves, rates, roots with identities, and treatments compared.

It begins with results of several days.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path

from rhizotwin.experiment.compare import Difference, Point, Seen, differences, means, relative_rates, too_few
from rhizotwin.experiment.doses import Response, fit_responses, group_ions, read_doses
from rhizotwin.experiment.drift import Chart, chart_of, rig_numbers
from rhizotwin.experiment.matching import Day, Followed, follow
from rhizotwin.experiment.measured import Measured, by_plant, left_out
from rhizotwin.scenes import atomic, neighbours, rsml, solution
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.trait_table import csv_text, written
from rhizotwin.stored import result_files

CURVES = ("total_length", "volume", "depth", "tips")
"""Traits whose growth is shown and compared."""


@dataclass(frozen=True, kw_only=True)
class Growth:
    """What many results tell of growth."""

    plants: Mapping[str, Sequence[Measured]]
    """By name, each by day."""
    followed: Mapping[str, Followed]
    """Of the plants whose roots were found on two days or more."""
    seen: Mapping[str, Sequence[Seen]]
    """By trait."""
    curves: Mapping[str, Sequence[Point]]
    compared: Mapping[str, Sequence[Difference]]
    doses: Mapping[str, Mapping[str, float]]
    """Concentrations of ions in mmol/l, by plant whose solution is known."""
    responses: Mapping[str, Sequence[Response]]
    """By trait; of those whose concentrations differ between plants."""
    notes: tuple[str, ...]
    drift: Mapping[str, Chart] = field(default_factory=dict)
    """Control charts of the rig over the experiment, by the names of `drift.RIG_NUMBERS`."""


def measure(found: Sequence[Measured]) -> Growth:
    """Measure growth.

    Values that are not reliable are left out of curves and comparisons, and a note says how many and why.

    Raises
    ------
    UserError
        For a result without plant or day, a plant that is there twice on a day or in two treatments, scans of
        different strips, or where nothing is known of any plant that is reliable.
    """
    plants = by_plant(found)
    for plant, days in plants.items():
        named = sorted({one.subject.treatment for one in days})
        if len(named) > 1:
            raise UserError(f"plant {plant} is in two treatments, {named[0]!r} and {named[1]!r}; a plant has one")
        _refuse_strips(plant, days)
    notes = left_out(found, CURVES)
    followed = {plant: one for plant, days in plants.items() if (one := _followed(days)) is not None}
    if lost := [plant for plant in plants if plant not in followed]:
        notes.append(f"roots cannot be followed, because fewer than two days have some: {', '.join(lost)}")
    seen = {trait: values for trait in CURVES if (values := _seen(plants, trait))}
    if not seen and not followed:
        raise UserError("; ".join(left_out(found, CURVES)) or f"the results have none of the traits {', '.join(CURVES)}")
    unassessed = [trait for trait in seen if any(one.assessment(trait).verdict == "not assessed" for one in found)]
    notes += [f"not assessed, so that their errors are not known: {', '.join(unassessed)}"] if unassessed else []
    notes += [f"{trait}: treatments are not compared: {why}" for trait, values in seen.items() if (why := too_few(values))]
    doses = read_doses(plants)
    responses = {trait: fitted for trait, values in seen.items() if (fitted := fit_responses(values, doses))}
    if group_ions(doses):
        why = f"{len(doses)} plants are too few, or their ions depend on each other"
        notes += [f"{trait}: no dose response: {why}" for trait in seen if trait not in responses]
    if doses and len(doses) < len(plants):
        notes.append(
            f"{len(plants) - len(doses)} of {len(plants)} plants have no known nutrient solution and are left out of the dose response"
        )
    return Growth(
        plants=plants,
        followed=followed,
        seen=seen,
        curves={trait: means(values) for trait, values in seen.items()},
        compared={trait: differences(values) for trait, values in seen.items() if not too_few(values)},
        doses=doses,
        responses=responses,
        notes=tuple(notes),
        drift=_drift(found),
    )


def _drift(found: Sequence[Measured]) -> dict[str, Chart]:
    """Return the control charts of the rig over the dates of the scans, or the days of the plants if some have none."""
    scans = {one.folder: one.subject for one in found if one.folder is not None}
    dated = all(whose.date for whose in scans.values())
    points: dict[str, list[tuple[float, float]]] = {}
    for folder, whose in scans.items():
        day = float(date.fromisoformat(whose.date).toordinal()) if dated else whose.day or 0.0
        for name, value in rig_numbers(result_files.read_summary(folder)).items():
            points.setdefault(name, []).append((day, value))
    return {name: chart_of(*zip(*sorted(own), strict=True)) for name, own in points.items()}


def _seen(plants: Mapping[str, Sequence[Measured]], trait: str) -> list[Seen]:
    return [
        Seen(plant=plant, treatment=one.subject.treatment, day=one.subject.day or 0.0, value=value)
        for plant, days in plants.items()
        for one in days
        if (value := one.usable(trait)) is not None
    ]


def _refuse_strips(plant: str, days: Sequence[Measured]) -> None:
    """Refuse scans of one plant by different strips: their frames have nothing to do with each other."""
    strips = []
    for one in days:
        if one.folder is not None:
            strip = result_files.read_strip(one.folder, result_files.read_summary(one.folder))
            strips += [] if strip is None else [(one, strip)]
    for one, strip in strips[1:]:
        if strip != strips[0][1]:
            raise UserError(f"plant {plant}: {strips[0][0].name} and {one.name} were scanned with different marker strips; use one strip")


def _followed(days: Sequence[Measured]) -> Followed | None:
    """Follow the roots of a plant; None where they were found on fewer than two days."""
    known = []
    for one in days:
        file = None if one.folder is None else one.folder / "roots.rsml"
        if file is not None and file.is_file():
            roots = rsml.read_rsml(file)
            if len({root.plant for root in roots}) > 1:
                roots = rsml.of_plant(roots, one.subject.plant)
            known.append(Day(day=one.subject.day or 0.0, roots=roots))
    return follow(known) if len(known) > 1 else None


def neighbours_csv(growth: Growth) -> str:
    """Return how plants that share a canister lie to each other, day by day, where the length of all is reliable.

    Empty where none do.
    """
    scans: dict[Path, list[Measured]] = {}
    for one in (one for own in growth.plants.values() for one in own):
        if one.folder is not None:
            scans.setdefault(one.folder, []).append(one)
    days = {folder: own[0].subject.day for folder, own in scans.items() if all(one.usable("total_length") for one in own)}
    rows = [[written(day), *row] for folder, day in days.items() for row in neighbours.rows(result_files.read_neighbours(folder))]
    return csv_text([["day", *neighbours.HEAD], *rows]) if rows else ""


def write(growth: Growth, folder: Path) -> None:
    """Write the tables of growth, and roots as RSML with time, into a folder."""
    for name, text in (("traits", traits_csv(growth)), ("roots", roots_csv(growth)), ("treatments", treatments_csv(growth))):
        atomic.write_text(folder / f"{name}.csv", text)
    if growth.responses:
        atomic.write_text(folder / "doses.csv", doses_csv(growth))
    if growth.followed:
        (folder / "rsml").mkdir()
        write_rsml(growth, folder / "rsml")


def traits_csv(growth: Growth) -> str:
    """Return a row a plant, day and trait: value, 90 % interval, verdict, and relative growth rate.

    The rate is that since the day before, of values that are not called not reliable.
    """
    dissolved = solution.headings(list(growth.doses.values()))
    head = ["plant", "treatment", "day", "trait", "value", "low", "high", "verdict", "relative_growth_rate (1/day)"]
    rows: list[Sequence[str]] = [[*head, *dissolved.values()]]
    for trait in CURVES:
        rates = {(plant, end): rate for plant, _, end, rate in relative_rates(growth.seen.get(trait, ()))}
        for plant, one in ((plant, one) for plant, days in growth.plants.items() for one in days if trait in one.traits):
            assessed, day = one.assessment(trait), one.subject.day or 0.0
            low, high = assessed.interval or (None, None)
            numbers = [written(value) for value in (one.traits[trait], low, high)]
            doses = [written(growth.doses.get(plant, {}).get(ion)) for ion in dissolved]
            rows.append(
                [plant, one.subject.treatment, f"{day:g}", trait, *numbers, assessed.verdict, written(rates.get((plant, day))), *doses]
            )
    return csv_text(rows)


def roots_csv(growth: Growth) -> str:
    """Return a row a root and day.

    Its identity, when it came, its length, its rate since it was last seen, its diameter, and the verdict on the total
    length of its scan.
    """
    head = ["plant", "root", "parent", "order", "emergence_day", "day", "length (mm)", "elongation (mm/day)", "diameter (mm)", "verdict"]
    rows: list[Sequence[str]] = [head]
    for plant, followed in growth.followed.items():
        verdicts = {one.subject.day: one.assessment("total_length").verdict for one in growth.plants[plant]}
        for track in followed.tracks:
            rates = {end: rate for _, end, rate in track.rates_mm_per_day}
            for sight in track.sights:
                numbers = [written(value) for value in (sight.length_mm, rates.get(sight.day), sight.diameter_mm)]
                whose = [plant, track.name, track.parent, str(track.order), f"{track.emergence_day:.2f}", f"{sight.day:g}"]
                rows.append([*whose, *numbers, verdicts[sight.day]])
    return csv_text(rows)


def treatments_csv(growth: Growth) -> str:
    """Return a row a trait and treatment: by what it differs from the first one, and how sure that is."""
    head = ["trait", "treatment", "against", "size", "low", "high", "size_p", "rate (1/day)", "rate_p", "plants", "told_apart"]
    rows: list[Sequence[str]] = [head]
    for trait, compared in growth.compared.items():
        for one in compared:
            numbers = (one.size, *one.size_interval, one.size_p, one.rate_per_day, one.rate_p)
            apart = "yes" if one.told_apart else "no"
            rows.append([trait, one.treatment, one.against, *(written(value) for value in numbers), str(one.plants), apart])
    return csv_text(rows)


def doses_csv(growth: Growth) -> str:
    """Return a row a trait and group of ions: how the trait's logarithm follows the concentration."""
    head = ["trait", "ion", "together_with", f"from ({solution.UNIT})", f"to ({solution.UNIT})", "slope (l/mmol)", "low", "high", "p"]
    rows: list[Sequence[str]] = [[*head, "rate (l/mmol/day)", "rate_p", "curvature_p", "levels", "plants"]]
    for trait, responses in growth.responses.items():
        for one in responses:
            numbers = (*one.range_mmol, one.slope, *one.slope_interval, one.slope_p, one.rate, one.rate_p, one.curvature_p)
            rows.append([trait, one.ion, " ".join(one.with_ions), *(written(value) for value in numbers), str(one.levels), str(one.plants)])
    return csv_text(rows)


def write_rsml(growth: Growth, folder: Path) -> list[Path]:
    """Write the roots of every plant and day as RSML with time.

    A root has one id on all days, in the frame of the first.
    """
    files = []
    for number, (plant, followed) in enumerate(growth.followed.items(), start=1):
        for day, names in zip(followed.days, followed.names, strict=True):
            path = folder / f"plant_{number:03d}_day_{day.day:g}.rsml"
            roots = [replace(root, label=name) for root, name in zip(day.roots, names, strict=True)]
            rsml.write_rsml(path, roots, moment=rsml.Moment(sequence=plant, index=round(day.day)))
            files.append(path)
    return files
