"""Read the traits of many results together with their plants.

Traits are read from result folders, or from tables written by `rhizotwin traits -o FILE.csv`.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import log
from pathlib import Path
from typing import get_args

from rhizotwin.recon.results import result_traits
from rhizotwin.scenes import assessment, solution, subject, table_file, trait_table
from rhizotwin.scenes.assessment import NO_INTERVAL, Assessment, Verdict
from rhizotwin.scenes.compounds import IONS
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.subject import Subject
from rhizotwin.stored import result_files, stored_traits

IN_90 = 1.6448536269514722
"""Half-width of the 90 % interval of a normal distribution, in standard deviations."""
_MM3 = {"mm3": 1.0, "ml": 1000.0, "cm3": 1000.0, "l": 1e6}
_HEAD = re.compile(r"(\w+)(?: \((\S+)\))?")
_SUFFIX = re.compile(r"(\w+?)(_low|_high|_verdict)?")


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Traits of one plant on one day."""

    name: str
    """Name of the result folder, or file and line of the table."""
    subject: Subject
    """Plant, day, species and treatment."""
    traits: Mapping[str, float]
    """Measured traits, keyed by trait name as in tables. Units are those of `scenes.trait_table`."""
    assessed: Mapping[str, Assessment] = field(default_factory=dict)
    """Assessments of the traits, keyed by trait name as in tables. A trait without an entry has no interval."""
    ions: Mapping[str, float] = field(default_factory=dict)
    """Ion concentrations of the nutrient solution in mmol/l, keyed by ion. The mapping is empty if they are unknown."""
    folder: Path | None = None
    """Result folder. It is None if the traits were read from a table."""

    def assessment(self, trait: str) -> Assessment:
        """Return the assessment of a trait: reliability and 90 % interval."""
        return self.assessed.get(trait, NO_INTERVAL)

    def usable(self, trait: str) -> float | None:
        """Return the value of a trait. It is None if the value is not positive or is marked as not reliable."""
        value = self.traits.get(trait, 0.0)
        return value if value > 0.0 and self.is_trusted(trait) else None

    def is_trusted(self, trait: str) -> bool:
        """Return whether a trait is not marked as not reliable."""
        return self.assessment(trait).verdict != "not reliable"

    def log_sigma(self, trait: str) -> float:
        """Return the standard deviation of a trait's logarithm, computed from its 90 % interval.

        If the interval begins at zero, it is computed from the upper end. It is zero if there is no interval.
        """
        low, high = self.assessment(trait).interval or (0.0, 0.0)
        if not low < high:
            return 0.0
        if low > 0.0:
            return log(high / low) / (2.0 * IN_90)
        return log(max(high / self.traits[trait], 1.0)) / IN_90 if self.traits[trait] > 0.0 else 0.0

    @property
    def who(self) -> str:
        """Plant and day, for messages."""
        day = self.subject.known.get("day") or self.subject.date
        return f"{self.subject.plant or self.name}{f' on day {day}' if day else ''}"


def read_all(sources: Sequence[Path]) -> list[Measured]:
    """Read result folders, folders that contain results, and tables of traits (.csv).

    Raises
    ------
    UserError
        If a source is missing or damaged, or contains no results.
    """
    found = []
    for source in sources:
        if source.suffix.lower() == ".csv":
            found += [_read_row(row) for row in table_file.read_table(source)]
        elif (source / "result.json").is_file():
            found += _read_folder(source)
        else:
            if not source.is_dir():
                raise UserError(f"{source} is not a result folder, a folder of results, or a table of traits (.csv)")
            found += [one for folder in result_files.results_in([source]) for one in _read_folder(folder)]
    return found


def by_plant(found: Sequence[Measured]) -> dict[str, list[Measured]]:
    """Group results by plant and sort them by day.

    Raises
    ------
    UserError
        If a result has no plant or no day, or a plant occurs twice on a day.
    """
    plants: dict[str, list[Measured]] = {}
    for one in found:
        if not one.subject.plant:
            raise UserError(f"{one.name}: the name of the plant is missing; {_how_to_set('plant', one)}")
        if one.subject.day is None:
            raise UserError(f"{one.name}: the day of plant {one.subject.plant} is missing; {_how_to_set('day', one)}")
        plants.setdefault(one.subject.plant, []).append(one)
    for plant, days in plants.items():
        days.sort(key=lambda one: one.subject.day or 0.0)
        for before, after in pairwise(days):
            if before.subject.day == after.subject.day:
                raise UserError(
                    f"plant {plant} occurs twice on day {after.subject.day:g}: {before.name} and {after.name}; remove one of them"
                )
    return plants


def _how_to_set(name: str, one: Measured) -> str:
    if one.folder is None:
        return f"enter it in the column {name!r}"
    return f"set it with --{name} when the dataset is created, or as {name!r} in [subject] of the scene"


def one_species(found: Sequence[Measured]) -> str:
    """Return the species of all results. It is empty if the species is unknown.

    Raises
    ------
    UserError
        If the results contain two species.
    """
    named = {one.subject.species: one for one in found if one.subject.species}
    if len(named) > 1:
        (first, one), (second, other) = list(named.items())[:2]
        raise UserError(
            f"{one.who} is of the species {first}, but {other.who} is of the species {second}; use results of a single species for a model"
        )
    return next(iter(named), "")


def _read_folder(folder: Path) -> list[Measured]:
    """Read a result folder and return one entry per plant."""
    summary = result_files.read_summary(folder)
    above = trait_table.shoot_numbers(stored_traits.of_shoot(summary))
    dissolved = solution.from_summary(summary, str(folder / "result.json")).ions_mmol_per_l
    return [
        Measured(
            name=folder.resolve().name,
            subject=own.subject,
            traits={d.name: float(value) for d in trait_table.DEFINITIONS if (value := getattr(own.traits, d.field)) is not None}
            | {name: float(value) for name, value in above.items() if value is not None},
            assessed={d.name: own.assessed[d.field] for d in trait_table.DEFINITIONS},
            ions=dissolved,
            folder=folder,
        )
        for own in result_traits.traits_by_plant(str(folder / "result.json"), summary, stored_traits.read(folder))
    ]


def exclusion_notes(found: Sequence[Measured], traits: Iterable[str]) -> list[str]:
    """Return a sentence for each trait that has unreliable values.

    It states the number of excluded values and the reasons.
    """
    sentences = []
    for trait in traits:
        known = [one for one in found if one.traits.get(trait, 0.0) > 0.0]
        reasons = [
            one.assessment(trait).reason or "the table marks the value as not reliable" for one in known if one.usable(trait) is None
        ]
        sentences.append(assessment.left_out(trait, reasons, total=len(known)))
    return [sentence for sentence in sentences if sentence]


def _read_row(row: table_file.Row) -> Measured:
    """Read a row of a table of traits. Column names of earlier versions, such as ``volume (mm3)``, are accepted."""
    definitions = trait_table.definitions_by_column()
    numbers: dict[str, float] = {}
    for column in row.cells:
        match = _HEAD.fullmatch(column)
        stem, end = ("", "") if match is None else _split(match[1])
        if match is None or end == "_verdict" or stem not in definitions:
            continue
        value = table_file.number(row, column)
        if value is None:
            continue
        own = definitions[stem]
        factor = 1.0
        if stem == "volume":
            if match[2] not in _MM3:
                raise UserError(f"{row.where}: the column {column} has no known unit; the unit must be (mm3), (cm3), (ml) or (l)")
            factor = _MM3[match[2]]
        elif match[2] not in (None, own.unit):
            raise UserError(
                f"{row.where}: the column {column} has another unit than {own.column}; convert the values and rename the column"
            )
        if value < 0.0 and not end and own not in trait_table.COLOUR:
            raise UserError(f"{row.where}: {column} is {value:g}, but must be at least 0; correct it, or leave the cell empty")
        numbers[own.name + end] = value * factor
    traits = {name: value for name, value in numbers.items() if _split(name)[1] == ""}
    return Measured(
        name=row.cells.get("result") or row.where,
        subject=subject.from_cells(row.cells, row.where),
        ions=_ions(row),
        traits=traits,
        assessed={name: _assessment(row, name, numbers) for name in traits},
    )


def _split(column: str) -> tuple[str, str]:
    """Split a column name into the trait's name and the suffix ``_low``, ``_high``, ``_verdict`` or an empty string."""
    match = _SUFFIX.fullmatch(column)
    return (column, "") if match is None else (match[1], match[2] or "")


def _ions(row: table_file.Row) -> dict[str, float]:
    """Return the ion concentrations in a row of a table in mmol/l, keyed by ion.

    The dictionary is empty if there are none.
    """
    headings = {ion: f"{ion} ({solution.UNIT})" for ion in IONS}
    found = {ion: value for ion, heading in headings.items() if (value := table_file.number(row, heading)) is not None}
    if low := [ion for ion, value in found.items() if value < 0.0]:
        raise UserError(f"{row.where}: {headings[low[0]]} is {found[low[0]]:g}, but must be at least 0")
    return found


def _assessment(row: table_file.Row, name: str, numbers: Mapping[str, float]) -> Assessment:
    """Read the interval and the verdict of a trait.

    In tables of earlier versions, the verdict on the volume is the column ``trusted`` (yes or no), and
    ``not assessed`` is the verdict on a trait without an interval.
    """
    columns = [f"{column}_verdict" for column, own in trait_table.definitions_by_column().items() if own.name == name]
    word = next((row.cells[column] for column in columns if row.cells.get(column)), "")
    if name == "volume" and not word:
        word = {"yes": "reliable", "no": "not reliable"}.get(row.cells.get("trusted", ""), "")
    verdicts: dict[str, Verdict] = {one: one for one in get_args(Verdict)} | {"not assessed": "no interval"}
    if word and word not in verdicts:
        raise UserError(f"{row.where}: the verdict on {name} is {word!r}; a verdict must be one of: {', '.join(verdicts)}")
    ends = [numbers.get(f"{name}_{end}") for end in ("low", "high")]
    interval = None if ends[0] is None or ends[1] is None else (max(ends[0], 0.0), ends[1])
    if interval is not None and interval[0] > interval[1]:
        raise UserError(f"{row.where}: the interval of {name} begins at {interval[0]:g}, but ends at {interval[1]:g}; correct the columns")
    return Assessment(verdict=verdicts.get(word, "no interval"), interval=interval)
