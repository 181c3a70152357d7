"""Many results as numbers with their plants.

Result folders, or tables of traits as `rhizotwin traits -o FILE.csv` writes them.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import log
from pathlib import Path
from typing import get_args

from rhizotwin.experiment import tables
from rhizotwin.recon.results import result_traits
from rhizotwin.scenes import assessment, solution, subject, trait_table
from rhizotwin.scenes.assessment import NOT_ASSESSED, Assessment, Verdict
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.subject import Subject
from rhizotwin.stored import result_files, stored_traits

IN_90 = 1.6448536269514722
"""Standard deviations on each side that hold 90 % of a normal distribution."""
_MM3 = {"mm3": 1.0, "ml": 1000.0, "cm3": 1000.0, "l": 1e6}
_HEAD = re.compile(r"(\w+)(?: \((\S+)\))?")


@dataclass(frozen=True, kw_only=True)
class Measured:
    """The traits of one plant on one day."""

    name: str
    """Of the result's folder, or file and line of a table."""
    subject: Subject
    traits: Mapping[str, float]
    """Those that are known, by their names in tables, in the units of `scenes.trait_table`."""
    assessed: Mapping[str, Assessment] = field(default_factory=dict)
    """By the same names; a trait that is missing is not assessed."""
    ions: Mapping[str, float] = field(default_factory=dict)
    """Concentrations in the nutrient solution in mmol/l; empty where they are not known."""
    folder: Path | None = None
    """The result's; None for a line of a table."""

    def assessment(self, trait: str) -> Assessment:
        """Return the reliability of a trait."""
        return self.assessed.get(trait, NOT_ASSESSED)

    def usable(self, trait: str) -> float | None:
        """Return a trait that tests and fits may use: above zero, and not assessed as not reliable."""
        value = self.traits.get(trait, 0.0)
        return value if value > 0.0 and self.assessment(trait).verdict != "not reliable" else None

    def log_sigma(self, trait: str) -> float:
        """Return the standard deviation of the logarithm of a trait, from its 90 % interval; 0 where it has none."""
        low, high = self.assessment(trait).interval or (0.0, 0.0)
        return log(high / low) / (2.0 * IN_90) if 0.0 < low < high else 0.0

    @property
    def who(self) -> str:
        """Return the plant and its day, for messages."""
        day = self.subject.known.get("day") or self.subject.date
        return f"{self.subject.plant or self.name}{f' on day {day}' if day else ''}"


def read_all(sources: Sequence[Path]) -> list[Measured]:
    """Read result folders, folders of results, and tables of traits (.csv).

    Raises
    ------
    UserError
        Where one is missing or damaged, or nothing is found.
    """
    found = []
    for source in sources:
        if source.suffix.lower() == ".csv":
            found += [_of_row(row) for row in tables.read_table(source)]
        elif (source / "result.json").is_file():
            found += _of_folder(source)
        else:
            if not source.is_dir():
                raise UserError(f"{source}: is no result, no folder of results, and no table (.csv) of traits")
            found += [one for folder in result_files.results_in([source]) for one in _of_folder(folder)]
    return found


def by_plant(found: Sequence[Measured]) -> dict[str, list[Measured]]:
    """Return the results of each plant by day, the youngest first.

    Raises
    ------
    UserError
        For a result without a plant's name, or a plant that has no day, or twice the same.
    """
    plants: dict[str, list[Measured]] = {}
    for one in found:
        if not one.subject.plant:
            raise UserError(f"{one.name}: names no plant; give it when the dataset is made, with --plant, or as plant in its [subject]")
        if one.subject.day is None:
            raise UserError(f"{one.name}: plant {one.subject.plant} has no day; give it with --day, or as day in the scene's [subject]")
        plants.setdefault(one.subject.plant, []).append(one)
    for plant, days in plants.items():
        days.sort(key=lambda one: one.subject.day or 0.0)
        for before, after in pairwise(days):
            if before.subject.day == after.subject.day:
                raise UserError(f"plant {plant} is there twice on day {after.subject.day:g}: {before.name} and {after.name}; leave one out")
    return plants


def one_species(found: Sequence[Measured]) -> str:
    """Return the species of all results; empty where none names one.

    Raises
    ------
    UserError
        For two.
    """
    named = {one.subject.species: one for one in found if one.subject.species}
    if len(named) > 1:
        (first, one), (second, other) = list(named.items())[:2]
        raise UserError(f"{one.who} is of the species {first}, {other.who} of {second}; they cannot share a model")
    return next(iter(named), "")


def _of_folder(folder: Path) -> list[Measured]:
    """Read a result: one, or one a plant where several are in the canister."""
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


def left_out(found: Sequence[Measured], traits: Iterable[str]) -> list[str]:
    """Return a sentence for each trait of which values are left out of tests and fits, as they are not reliable."""
    sentences = []
    for trait in traits:
        known = [one for one in found if one.traits.get(trait, 0.0) > 0.0]
        reasons = [one.assessment(trait).reason or "so the table says" for one in known if one.usable(trait) is None]
        sentences.append(assessment.left_out(trait, reasons, total=len(known)))
    return [sentence for sentence in sentences if sentence]


def _of_row(row: tables.Row) -> Measured:
    known = {d.name for d in (*trait_table.DEFINITIONS, *trait_table.SHOOT, *trait_table.COLOUR)}
    columns = known | {f"{name}_{end}" for name in known for end in ("low", "high")}
    numbers: dict[str, float] = {}
    for column in row.cells:
        match = _HEAD.fullmatch(column)
        if match is None or match[1] not in columns:
            continue
        value = tables.number(row, column)
        if value is None:
            continue
        is_volume = match[1] in ("volume", "volume_low", "volume_high")
        if is_volume and match[2] not in _MM3:
            raise UserError(f"{row.where}: {column} must have its unit behind it, (mm3) or (ml)")
        numbers[match[1]] = value * (_MM3[match[2]] if is_volume else 1.0)
    traits = {name: value for name, value in numbers.items() if name in known}
    return Measured(
        name=row.cells.get("result") or row.where,
        subject=subject.from_cells(row.cells, row.where),
        ions=_ions(row),
        traits=traits,
        assessed={name: _assessment(row, name, numbers) for name in traits},
    )


def _ions(row: tables.Row) -> dict[str, float]:
    """Return the concentrations in a row, mmol/l by ion; empty where it has none."""
    headings = {ion: f"{ion} ({solution.UNIT})" for ion in solution.IONS}
    found = {ion: value for ion, heading in headings.items() if (value := tables.number(row, heading)) is not None}
    if low := [ion for ion, value in found.items() if value < 0.0]:
        raise UserError(f"{row.where}: {headings[low[0]]} is {found[low[0]]:g}, but must be 0 or more")
    return found


def _assessment(row: tables.Row, name: str, numbers: Mapping[str, float]) -> Assessment:
    """Read interval and verdict of a trait; a column ``trusted`` (yes or no) is the verdict on the volume."""
    word = row.cells.get(f"{name}_verdict", "")
    if name == "volume" and not word:
        word = {"yes": "reliable", "no": "not reliable"}.get(row.cells.get("trusted", ""), "")
    verdicts: dict[str, Verdict] = {one: one for one in get_args(Verdict)}
    if word and word not in verdicts:
        raise UserError(f"{row.where}: {name}_verdict is {word!r}, but must be one of {', '.join(verdicts)}")
    ends = [numbers.get(f"{name}_{end}") for end in ("low", "high")]
    interval = None if ends[0] is None or ends[1] is None else (ends[0], ends[1])
    return Assessment(verdict=verdicts.get(word, "not assessed"), interval=interval)
