"""The experiment file: plants, schedule, rig and folders of a time-lapse experiment (TOML, validated)."""

import re
from dataclasses import dataclass, field, replace
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Literal

from rhizotwin.catalogue.identity import strip_for_canister
from rhizotwin.catalogue.records import Plant, Tag
from rhizotwin.catalogue.schema import SUFFIX
from rhizotwin.scenes import files
from rhizotwin.scenes.checks import check_scene
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.limits import bounded
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.schema import Place, from_plain
from rhizotwin.scenes.solution import Solution, check_solution
from rhizotwin.scenes.subject import Subject, check_subject

Changing = Literal["person", "carousel"]
EVERY_H = (0.25, 10000.0)
"""Limits of an interval: datasets are named after the day with two decimals, and 0.01 day is 0.24 h."""
_UNSAFE = re.compile(r"[^\w.-]+")


def _limits(name: str) -> tuple[float, float]:
    """Return the limits of a number of the subject of a dataset."""
    low, high = Subject.__dataclass_fields__[name].metadata["limits"]
    return low, high


@dataclass(frozen=True, kw_only=True)
class Member:
    """A plant of the experiment, or a phantom."""

    name: str
    """Name of the plant, the same on every day."""
    canister: int = bounded(1, 1, 500)
    """Number of its strip: `rhizotwin markers SCENE --labels N` prints the strips 1 to N."""
    species: str = ""
    """Latin name, such as Raphanus sativus."""
    treatment: str = ""
    """Treatment, for example 'low N'."""
    replicate: int | None = field(default=None, metadata={"limits": _limits("replicate")})
    """Which of the plants that were treated alike."""
    sown: str = ""
    """Date of sowing, as 2026-11-26; empty: that of [schedule] start, which is then day 0."""
    notes: str = ""
    """Anything else."""
    scene: str = ""
    """Specimen on the emulated rig: a scene whose specimen is in this canister; empty: that of the experiment."""
    growth: float = bounded(1.0, 0.1, 10.0)
    """On the emulated rig, factor by which the roots grow faster and longer than those of the scene."""
    every_h: float | None = field(default=None, metadata={"limits": EVERY_H})
    """Hours between its scans, for example 168 for a phantom; empty: as in [schedule]."""
    phantom: bool = False
    """Whether it is a phantom of known shape, which is left out of the curves of growth."""
    solution: Solution = field(default_factory=Solution)
    """Nutrient solution."""


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """When the plants are scanned."""

    start: str
    """Date and time of the first round, as 2026-12-01T09:00; local time unless it has an offset such as +01:00."""
    every_h: float = bounded(24.0, *EVERY_H)
    """Hours from round to round."""
    rounds: int = bounded(10, 1, 10000)
    """Number of rounds."""
    late_h: float = bounded(12.0, 0.1, 10000.0)
    """A scan that has not begun so many hours after it was due is recorded as missed."""
    change: Changing = "person"
    """Who puts the canisters on the table: a person, who is asked to, or a carousel."""
    tries: int = bounded(3, 1, 100)
    """Number of times that a scan is tried before it is recorded as missed."""
    pause_min: float = bounded(5.0, 0.0, 1000.0)
    """Minutes between two tries."""


@dataclass(frozen=True, kw_only=True)
class TwinPart:
    """The emulated rig, for rig = "twin"."""

    profile: str = "bench"
    """Errors of the rig: clean, bench, harsh, or a file."""
    seed: int = bounded(0, 0, 2**31)
    fidelity: Literal["render", "sketch"] = "sketch"
    """render: pictures as `rhizotwin simulate` makes them; sketch: strip and panel only, which cannot be
    reconstructed."""


@dataclass(frozen=True, kw_only=True)
class Reconstruction:
    """What is done with a finished scan."""

    run: bool = True
    """Whether scans are reconstructed and the curves of growth updated."""
    voxel_mm: float | None = field(default=None, metadata={"limits": (0.01, 10.0)})
    """Edge of the smallest voxels; empty: the default of `rhizotwin reconstruct`."""


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """A time-lapse experiment."""

    name: str
    rig: str
    """Rig file, or "twin": the emulated rig, which runs in virtual time."""
    scene: str
    """Scene of the rig, with its canister, strip, calibrated camera and plan."""
    plants: tuple[Member, ...]
    schedule: Schedule
    catalogue: str = ""
    """Catalogue file; empty: the name of the experiment file with the ending .rhizotwin."""
    scans: str = "scans"
    """Folder of the datasets."""
    results: str = "results"
    """Folder of the results, with the curves of growth in ``growth``."""
    twin: TwinPart = TwinPart()
    reconstruction: Reconstruction = Reconstruction()
    file: str = field(default="", compare=False)
    """The experiment file; set by `load_experiment`. Other paths are relative to its folder."""

    @property
    def folder(self) -> Path:
        """Folder of the experiment file."""
        return Path(self.file).parent

    @property
    def catalogue_path(self) -> Path:
        """The catalogue file."""
        return self.folder / self.catalogue if self.catalogue else Path(self.file).with_suffix(SUFFIX)

    @property
    def scans_folder(self) -> Path:
        """Folder of the datasets."""
        return self.folder / self.scans

    @property
    def results_folder(self) -> Path:
        """Folder of the results."""
        return self.folder / self.results

    @property
    def start_utc(self) -> datetime:
        """Time of the first round."""
        return datetime.fromisoformat(self.schedule.start).astimezone(UTC)

    @property
    def is_emulated(self) -> bool:
        """Whether the emulated rig is used."""
        return self.rig == "twin"

    def member(self, name: str) -> Member:
        """Return a plant by its name.

        Raises
        ------
        UserError
            If the experiment has none of this name.
        """
        for one in self.plants:
            if one.name == name:
                return one
        raise UserError(f"{self.file}: has no plant {name!r}, but the catalogue plans a scan of it; restore it in [[plants]]")

    def base_scene(self) -> Scene:
        """Return the scene of the rig."""
        path = self.folder / self.scene
        return files.load_scene(str(path) if path.suffix == ".toml" else self.scene)

    def plant(self, member: Member) -> Plant:
        """Return the entry of a plant for the catalogue."""
        return Plant(
            name=member.name,
            species=member.species,
            treatment=member.treatment,
            replicate=member.replicate,
            sown=self.sown(member).isoformat(),
            notes=member.notes,
            solution=member.solution,
            phantom=member.phantom,
            tag=Tag.of_strip(strip_for_canister(self.base_scene().strip, member.canister)),
        )

    def sown(self, member: Member) -> date:
        """Return the date of sowing."""
        return date.fromisoformat(member.sown) if member.sown else datetime.fromisoformat(self.schedule.start).date()

    def visits(self) -> list[tuple[str, str]]:
        """Return plant and due time (UTC, ISO 8601) of every scan, in the order in which they are due."""
        length_h = self.schedule.every_h * self.schedule.rounds
        found: list[tuple[datetime, int, str]] = []
        for number, one in enumerate(self.plants):
            every_h = one.every_h or self.schedule.every_h
            count = max(1, round(length_h / every_h))
            found += [(self.start_utc + timedelta(hours=every_h * k), number, one.name) for k in range(count)]
        return [(name, due.isoformat(timespec="seconds")) for due, _, name in sorted(found)]

    def day(self, member: Member, due_utc: str) -> float:
        """Return the days since sowing at which a scan is due; whole numbers at the time of day of the first round."""
        first = datetime.fromisoformat(self.schedule.start).date()
        days = (datetime.fromisoformat(due_utc) - self.start_utc) / timedelta(days=1)
        return round((first - self.sown(member)).days + days, 4)

    def scan_folder(self, member: Member, due_utc: str) -> Path:
        """Return the folder of a scan's dataset, the same in every run."""
        return self.scans_folder / f"{_UNSAFE.sub('_', member.name)}_day_{self.day(member, due_utc):06.2f}"

    def known_scene(self, member: Member, due_utc: str) -> Scene:
        """Return the scene of a scan as a laboratory knows it: strip, subject and nutrient solution of the plant."""
        base = self.base_scene()
        when = datetime.fromisoformat(due_utc).astimezone(datetime.fromisoformat(self.schedule.start).tzinfo)
        whose = Subject(
            plant=member.name,
            species=member.species,
            treatment=member.treatment,
            day=self.day(member, due_utc),
            date=when.date().isoformat(),
            replicate=member.replicate,
            notes=member.notes,
        )
        solution = member.solution if member.solution.known else base.solution
        return replace(base, subject=whose, solution=solution, strip=strip_for_canister(base.strip, member.canister))


def load_experiment(path: Path | str) -> Experiment:
    """Read and check an experiment file.

    Raises
    ------
    UserError
        With the line, for an unknown key or a value that cannot be.
    """
    path = Path(path)
    table, text = files.read_toml(path)
    place = Place(str(path), text)
    experiment = replace(from_plain(Experiment, table, place), file=str(path))
    if table.get("file"):
        raise place.at("file").error("unknown key")
    _check(experiment, place)
    return experiment


def _check(experiment: Experiment, place: Place) -> None:
    """Reject dates, plants, canisters and folders that cannot be."""
    for name in ("name", "rig", "scene", "catalogue", "scans", "results"):
        if not getattr(experiment, name).isprintable():
            raise place.at(name).error("must be one line of printable characters", ascii(getattr(experiment, name)))
    start = place.at("schedule", "start")
    try:
        end_utc = (experiment.start_utc + timedelta(hours=experiment.schedule.every_h * experiment.schedule.rounds)).isoformat()
    except ValueError:
        raise start.error("must be a date and time as 2026-12-01T09:00", experiment.schedule.start) from None
    except OverflowError:
        raise start.error("must place all scans between the years 1 and 9999", experiment.schedule.start) from None
    if not experiment.plants:
        raise place.at("plants").error("has no plants; add [[plants]]")
    if experiment.catalogue and not experiment.catalogue.endswith(SUFFIX):
        raise place.at("catalogue").error(f"must end in {SUFFIX}", experiment.catalogue)
    scene = experiment.base_scene()
    if scene.plants:
        raise place.at("scene").error("has several plants in one canister, which a time-lapse experiment does not plan", experiment.scene)
    names: dict[str, str] = {}
    canisters: dict[int, str] = {}
    for number, one in enumerate(experiment.plants):
        here = place.at("plants", number)
        check_subject(Subject(plant=one.name, species=one.species, treatment=one.treatment, date=one.sown, notes=one.notes), here)
        check_solution(one.solution, here.at("solution"))
        safe = _UNSAFE.sub("_", one.name)
        if not one.name or safe in names:
            other = f"is too much like the name {names[safe]!r}" if one.name else "is empty"
            raise here.at("name").error(f"{other}; folders are named after the plants, so that each needs a name of its own", one.name)
        if one.canister in canisters:
            raise here.at("canister").error(f"is the canister of plant {canisters[one.canister]}; each plant has its own", one.canister)
        names[safe], canisters[one.canister] = one.name, one.name
        try:
            check_scene(replace(scene, strip=strip_for_canister(scene.strip, one.canister)), where=str(here.where))
        except UserError as error:
            raise here.at("canister").error(str(error), one.canister) from None
        if experiment.day(one, experiment.start_utc.isoformat()) < 0.0:
            raise here.at("sown").error("must not be later than the first scan", one.sown)
        if experiment.day(one, end_utc) > (most := _limits("day")[1]):
            raise here.at("sown").error(f"must not be more than {most:g} days before the last scan", one.sown)
