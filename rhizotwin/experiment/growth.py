"""Growth of plants over several days: growth curves, growth rates, tracked roots and comparison of treatments."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path

from rhizotwin.experiment import falls
from rhizotwin.experiment.compare import Difference, Observation, Point, differences, means, reason_not_comparable, relative_rates
from rhizotwin.experiment.doses import Response, fit_responses, group_ions, read_doses, reason_not_fitted
from rhizotwin.experiment.drift import Chart, chart_of, rig_numbers
from rhizotwin.experiment.matching import Day, TrackedPlant, track_roots
from rhizotwin.experiment.measured import Measured, by_plant, exclusion_notes
from rhizotwin.scenes import atomic, neighbours, rsml, solution
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.rsml_reader import read_rsml
from rhizotwin.scenes.trait_table import COLOUR, DEFINITIONS, SHOOT, csv_text, format_exact
from rhizotwin.stored import result_files

CURVES = ("total_length", "volume", "depth", "tips", "leaves", "leaf_area", "ndvi")
"""Traits for which growth curves and comparisons are computed. Those of the shoot are known if pictures show it, and
the mean greenness of its leaves (NDVI) if they have bands."""
SIZES = ("total_length", "volume")
"""Traits that do not fall as long as a plant lives. The depth can, because roots bend, and tips hide each other."""
_COLUMNS = {d.name: d.column for d in (*DEFINITIONS, *SHOOT, *COLOUR)}


@dataclass(frozen=True, kw_only=True)
class Growth:
    """Growth of a set of plants over several days."""

    plants: Mapping[str, Sequence[Measured]]
    """Results of each plant, sorted by day and keyed by plant name."""
    tracked: Mapping[str, TrackedPlant]
    """Tracked roots, keyed by plant name. Plants whose roots were found on fewer than two days are omitted."""
    seen: Mapping[str, Sequence[Observation]]
    """Reliable values, keyed by trait name."""
    curves: Mapping[str, Sequence[Point]]
    """Mean of each treatment on each day, keyed by trait name."""
    compared: Mapping[str, Sequence[Difference]]
    """Differences between treatments, keyed by trait name."""
    doses: Mapping[str, Mapping[str, float]]
    """Ion concentrations in mmol/l, keyed by plant name. Plants with an unknown nutrient solution are omitted."""
    responses: Mapping[str, Sequence[Response]]
    """Dose responses, keyed by trait name. They are fitted for the ions whose concentrations differ between plants."""
    notes: tuple[str, ...]
    """Sentences about excluded values and plants."""
    suspects: tuple[str, ...] = ()
    """Plants whose size falls by more than its error, or that were exchanged with such a plant."""
    compared_without: Mapping[str, Sequence[Difference]] = field(default_factory=dict)
    """Differences between treatments without the plants in ``suspects``, keyed by trait name."""
    responses_without: Mapping[str, Sequence[Response]] = field(default_factory=dict)
    """Dose responses without the plants in ``suspects``, keyed by trait name."""
    drift: Mapping[str, Chart] = field(default_factory=dict)
    """Control charts of the rig during the experiment, keyed by the names in `drift.RIG_NUMBERS`."""


def measure(found: Sequence[Measured]) -> Growth:
    """Measure the growth of the plants in a set of results.

    Values that are not reliable are excluded from curves and comparisons. Their number and the reasons are noted.

    Raises
    ------
    UserError
        If a result has no plant or day, a plant occurs twice on a day or in two treatments, scans of a plant were made
        with different marker strips, or no value is reliable.
    """
    plants = by_plant(found)
    for plant, days in plants.items():
        named = sorted({one.subject.treatment for one in days})
        if len(named) > 1:
            raise UserError(f"plant {plant} has two treatments, {named[0]!r} and {named[1]!r}; correct the treatment of one of its scans")
        _check_strips(plant, days)
    notes = exclusion_notes(found, CURVES)
    tracked = {plant: one for plant, days in plants.items() if (one := _track(days)) is not None}
    if lost := [plant for plant in plants if plant not in tracked]:
        notes.append(
            f"the roots of these plants were not tracked, because centre lines are available for fewer than two days: {', '.join(lost)}"
        )
    seen = {trait: values for trait in CURVES if (values := [one for one in _trusted(plants, trait) if one.value > 0.0])}
    if not seen and not tracked:
        raise UserError("; ".join(exclusion_notes(found, CURVES)) or f"the results contain none of the traits {', '.join(CURVES)}")
    unassessed = [trait for trait in seen if any(one.assessment(trait).verdict == "no interval" for one in found)]
    notes += [f"the errors of these traits are unknown, because they have no intervals: {', '.join(unassessed)}"] if unassessed else []
    fallen = {_COLUMNS[trait]: falls.find_falls(_trusted(plants, trait)) for trait in SIZES}
    suspects = falls.suspects(fallen)
    doses = read_doses(plants)
    compared, responses, why_not = _compare(seen, doses)
    notes = [*falls.sentences(fallen), *notes, *why_not]
    compared_without, responses_without, why_not = _compare_without(seen, doses, suspects)
    notes += [f"without {', '.join(suspects)}: {why}" for why in why_not]
    if doses and len(doses) < len(plants):
        notes.append(
            f"{len(plants) - len(doses)} of {len(plants)} plants have no known nutrient solution and are excluded from the dose response"
        )
    return Growth(
        plants=plants,
        tracked=tracked,
        seen=seen,
        curves={trait: means(values) for trait, values in seen.items()},
        compared=compared,
        doses=doses,
        responses=responses,
        notes=tuple(notes),
        suspects=tuple(suspects),
        compared_without=compared_without,
        responses_without=responses_without,
        drift=_drift(found),
    )


def _compare_without(
    seen: Mapping[str, Sequence[Observation]], doses: Mapping[str, Mapping[str, float]], suspects: Sequence[str]
) -> tuple[dict[str, list[Difference]], dict[str, list[Response]], list[str]]:
    """Compare as `_compare` does without some plants. Nothing is compared if there are none."""
    if not suspects:
        return {}, {}, []
    others = {trait: [one for one in values if one.plant not in suspects] for trait, values in seen.items()}
    known = {plant: own for plant, own in doses.items() if plant not in suspects}
    return _compare({trait: values for trait, values in others.items() if values}, known)


def _compare(
    seen: Mapping[str, Sequence[Observation]], doses: Mapping[str, Mapping[str, float]]
) -> tuple[dict[str, list[Difference]], dict[str, list[Response]], list[str]]:
    """Compare treatments and fit dose responses for each trait. Return sentences on what could not be done, too."""
    uncompared = {trait: reason_not_comparable(values) for trait, values in seen.items()}
    unfitted = {trait: reason_not_fitted(values, doses) for trait, values in seen.items()}
    notes = [f"{trait}: the treatments were not compared, because {why}" for trait, why in uncompared.items() if why]
    if group_ions(doses):
        notes += [f"{trait}: the dose response could not be fitted, because {why}" for trait, why in unfitted.items() if why]
    compared = {trait: differences(values) for trait, values in seen.items() if not uncompared[trait]}
    return compared, {trait: fit_responses(values, doses) for trait, values in seen.items() if not unfitted[trait]}, notes


def _drift(found: Sequence[Measured]) -> dict[str, Chart]:
    """Return the control charts of the rig.

    The time of a point is the date of its scan, or the day of the plant if any scan has no date.
    """
    scans = {one.folder: one.subject for one in found if one.folder is not None}
    dated = all(whose.date for whose in scans.values())
    points: dict[str, list[tuple[float, float]]] = {}
    for folder, whose in scans.items():
        day = float(date.fromisoformat(whose.date).toordinal()) if dated else whose.day or 0.0
        for name, value in rig_numbers(result_files.read_summary(folder)).items():
            points.setdefault(name, []).append((day, value))
    return {name: chart_of(*zip(*own, strict=True)) for name, own in points.items()}


def _trusted(plants: Mapping[str, Sequence[Measured]], trait: str) -> list[Observation]:
    """Return the values of a trait that are not marked as not reliable, with ascending days of each plant."""
    return [
        Observation(
            plant=plant,
            treatment=one.subject.treatment,
            day=one.subject.day or 0.0,
            value=one.traits[trait],
            log_sigma=one.log_sigma(trait),
        )
        for plant, days in plants.items()
        for one in days
        if trait in one.traits and one.is_trusted(trait)
    ]


def _check_strips(plant: str, days: Sequence[Measured]) -> None:
    """Raise an error if scans of a plant were made with different marker strips.

    The frames of different strips are unrelated.
    """
    strips = []
    for one in days:
        if one.folder is not None:
            strip = result_files.read_strip(one.folder, result_files.read_summary(one.folder))
            strips += [] if strip is None else [(one, strip)]
    for one, strip in strips[1:]:
        if strip != strips[0][1]:
            raise UserError(
                f"plant {plant}: {strips[0][0].name} and {one.name} were scanned with different marker strips and cannot be aligned; "
                "omit the scans with one of the strips"
            )


def _track(days: Sequence[Measured]) -> TrackedPlant | None:
    """Track the roots of a plant over time. Return None if roots were found on fewer than two days."""
    known = []
    for one in days:
        file = None if one.folder is None else one.folder / "roots.rsml"
        if file is not None and file.is_file():
            roots = read_rsml(file)
            if any(root.plant for root in roots):  # other plants in the canister may be the only ones whose roots were found
                roots = rsml.plant_roots(roots, one.subject.plant)
            if roots:
                known.append(Day(day=one.subject.day or 0.0, roots=roots))
    return track_roots(known) if len(known) > 1 else None


def neighbours_csv(growth: Growth) -> str:
    """Return a CSV table of the distances and overlaps between plants in the same canister on each day.

    Only scans with reliable lengths are included, and the table is empty if there are none.
    """
    scans: dict[Path, list[Measured]] = {}
    for one in (one for own in growth.plants.values() for one in own):
        if one.folder is not None:
            scans.setdefault(one.folder, []).append(one)
    days = {folder: own[0].subject.day for folder, own in scans.items() if all(one.usable("total_length") for one in own)}
    rows = [[format_exact(day), *row] for folder, day in days.items() for row in neighbours.rows(result_files.read_neighbours(folder))]
    return csv_text([["day", *neighbours.HEAD], *rows]) if rows else ""


def write(growth: Growth, folder: Path) -> None:
    """Write the tables of growth to a folder, and write the roots of each day to RSML files."""
    for name, text in (("traits", traits_csv(growth)), ("roots", roots_csv(growth)), ("treatments", treatments_csv(growth))):
        atomic.write_text(folder / f"{name}.csv", text)
    if growth.responses:
        atomic.write_text(folder / "doses.csv", doses_csv(growth))
    if growth.tracked:
        (folder / "rsml").mkdir()
        write_rsml(growth, folder / "rsml")


def traits_csv(growth: Growth) -> str:
    """Return a CSV table with one row per plant, day and trait.

    It contains the value, its 90 % interval, its verdict, and the relative growth rate since the preceding day with a
    reliable value.
    """
    dissolved = solution.headings(list(growth.doses.values()))
    head = ["plant", "treatment", "day", "trait", "value", "low", "high", "verdict", "reasons", "relative_growth_rate_per_day"]
    rows: list[Sequence[str]] = [[*head, *dissolved.values()]]
    for trait in CURVES:
        rates = {(plant, end): rate for plant, _, end, rate in relative_rates(growth.seen.get(trait, ()))}
        for plant, one in ((plant, one) for plant, days in growth.plants.items() for one in days if trait in one.traits):
            assessed = one.assessment(trait)
            day = one.subject.day or 0.0
            low, high = assessed.interval or (None, None)
            numbers = [format_exact(value) for value in (one.traits[trait], low, high)]
            doses = [format_exact(growth.doses.get(plant, {}).get(ion)) for ion in dissolved]
            rows.append(
                [
                    *(plant, one.subject.treatment, f"{day:g}", _COLUMNS[trait], *numbers),
                    *(assessed.verdict, ";".join(assessed.codes), format_exact(rates.get((plant, day))), *doses),
                ]
            )
    return csv_text(rows)


def roots_csv(growth: Growth) -> str:
    """Return a CSV table of root tracks with one row per root and day.

    Columns are name, parent, order, day of emergence, length, elongation rate since the preceding observation,
    diameter, and the verdict on the total length of the scan. The day of emergence and the rates are computed from the
    days whose total length is not marked as not reliable. They are empty if they cannot be computed.
    """
    head = ["plant", "root", "parent", "order", "emergence_day", "day", "length_mm", "elongation_mm_per_day", "diameter_mm", "verdict"]
    rows: list[Sequence[str]] = [head]
    for plant, tracked in growth.tracked.items():
        verdicts = {one.subject.day: one.assessment("total_length").verdict for one in growth.plants[plant]}
        usable = [day.day for day in tracked.days if verdicts[day.day] != "not reliable"]
        for track in tracked.tracks:
            known = track.limit_to(usable)
            rates = {} if known is None else {end: rate for _, end, rate in known.rates_mm_per_day}
            emergence = "" if known is None else f"{known.emergence_day:.2f}"
            for state in track.states:
                numbers = [format_exact(value) for value in (state.length_mm, rates.get(state.day), state.diameter_mm)]
                whose = [plant, track.name, track.parent, str(track.order), emergence, f"{state.day:g}"]
                rows.append([*whose, *numbers, verdicts[state.day]])
    return csv_text(rows)


def treatments_csv(growth: Growth) -> str:
    """Return a CSV table of the differences between each treatment and the reference treatment.

    It has one row per trait and treatment, and another one without the plants whose size falls, if there are such.
    """
    head = ["trait", "treatment", "against", "size", "low", "high", "size_p", "rate_per_day", "rate_p", "plants", "significant", "without"]
    rows: list[Sequence[str]] = [head]
    for compared, without in ((growth.compared, ""), (growth.compared_without, " ".join(growth.suspects))):
        for trait, one in ((trait, one) for trait, own in compared.items() for one in own):
            numbers = (one.size, *one.size_interval, one.size_p, one.rate_per_day, one.rate_p)
            cells = [*(format_exact(value) for value in numbers), str(one.plants), "yes" if one.is_significant else "no", without]
            rows.append([_COLUMNS[trait], one.treatment, one.against, *cells])
    return csv_text(rows)


def doses_csv(growth: Growth) -> str:
    """Return a CSV table of dose responses with one row per trait and group of ions."""
    head = ["trait", "ion", "together_with", f"from ({solution.UNIT})", f"to ({solution.UNIT})", "slope (l/mmol)", "low", "high", "p"]
    rows: list[Sequence[str]] = [[*head, "rate (l/mmol/day)", "rate_p", "curvature_p", "levels", "plants"]]
    for trait, responses in growth.responses.items():
        for one in responses:
            numbers = (*one.range_mmol, one.slope, *one.slope_interval, one.slope_p, one.rate, one.rate_p, one.curvature_p)
            rows.append(
                [
                    _COLUMNS[trait],
                    one.ion,
                    " ".join(one.with_ions),
                    *(format_exact(value) for value in numbers),
                    str(one.levels),
                    str(one.plants),
                ]
            )
    return csv_text(rows)


def write_rsml(growth: Growth, folder: Path) -> list[Path]:
    """Write the roots of each plant and day to an RSML file that contains the day, and return the paths of the files.

    A root has the same id on all days. Coordinates are in the canister frame of the first day.
    """
    files = []
    for number, (plant, tracked) in enumerate(growth.tracked.items(), start=1):
        for day, names in zip(tracked.days, tracked.names, strict=True):
            path = folder / f"plant_{number:03d}_day_{day.day:g}.rsml"
            roots = [replace(root, label=name) for root, name in zip(day.roots, names, strict=True)]
            rsml.write_rsml(path, roots, moment=rsml.Moment(sequence=plant, index=round(day.day)))
            files.append(path)
    return files
