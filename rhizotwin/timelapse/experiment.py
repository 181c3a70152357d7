"""Experiment file (TOML) with the plants, schedule, rig and folders of a time-lapse experiment."""

import re
from dataclasses import dataclass, field, replace
from datetime import UTC, date, datetime, timedelta, tzinfo
from math import ceil
from pathlib import Path
from typing import Literal

from rhizotwin.catalogue.identity import strip_for_canister
from rhizotwin.catalogue.records import Plant, Tag
from rhizotwin.catalogue.schema import SUFFIX
from rhizotwin.scenes import files
from rhizotwin.scenes.checks import check_scene
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.limits import bounded
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.schema import Place, from_plain
from rhizotwin.scenes.solution import Solution, check_solution
from rhizotwin.scenes.subject import Subject, check_subject

Changing = Literal["person", "carousel"]
EVERY_H = (0.25, 10000.0)
"""Minimum and maximum interval between two scans of a plant, in hours. The names of datasets contain the day with two
decimals. Below 0.24 h, two scans could have the same name."""
SHORT = "_tips"
"""End of the names of short scans, which are only used for the motion of root tips."""
MOST_DELAY = timedelta(hours=12)
"""Delay from which a scan has the age at its start instead of that at its planned time, unless half an interval is
shorter."""
_UNSAFE = re.compile(r"[^\w.-]+")


def _limits(name: str) -> tuple[float, float]:
    """Return the minimum and maximum of a numeric field of `Subject`."""
    low, high = Subject.__dataclass_fields__[name].metadata["limits"]
    return low, high


@dataclass(frozen=True, kw_only=True)
class Member:
    """Plant or phantom of the experiment."""

    name: str
    """Name of the plant."""
    canister: int = bounded(1, 1, 500)
    """Number of the canister, and of its marker strip. The strips 1 to N are printed by `rhizotwin markers SCENE
    --labels N`."""
    species: str = ""
    """Latin name, such as Raphanus sativus."""
    treatment: str = ""
    """Treatment of the plant, such as 'low N'."""
    replicate: int | None = field(default=None, metadata={"limits": _limits("replicate")})
    """Number of the replicate within the treatment."""
    sown: str = ""
    """Date of sowing, such as 2026-11-26. If it is empty, it is the date of `start` in [schedule]."""
    notes: str = ""
    """Free text."""
    scene: str = ""
    """Scene that contains the specimen in this canister, for the emulated rig. If it is empty, the scene of the
    experiment is used."""
    growth: float = bounded(1.0, 0.1, 10.0)
    """Growth of a simulated plant relative to the scene, for the emulated rig. With a larger factor, roots grow faster
    and become longer."""
    every_h: float | None = field(default=None, metadata={"limits": EVERY_H})
    """Interval between the scans of this plant in hours, such as 168 for a phantom. If it is empty, the interval in
    [schedule] is used."""
    phantom: bool = False
    """Whether the canister contains a phantom of known shape, which is excluded from the growth curves."""
    solution: Solution = field(default_factory=Solution)
    """Nutrient solution."""


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Times at which the plants are scanned, and what is done after delays and failures."""

    start: str
    """Date and time of the first round of scans, such as 2026-12-01T09:00. The time is local, unless an offset such as
    +01:00 is appended."""
    every_h: float = bounded(24.0, *EVERY_H)
    """Interval between two rounds, in hours."""
    rounds: int = bounded(10, 1, 10000)
    """Number of rounds, in each of which all plants are scanned."""
    tips_every_min: float | None = field(default=None, metadata={"limits": (2.0, 1440.0)})
    """Interval between the short scans after each scan of a plant, in minutes, from which the motion of its root tips
    is measured. If it is empty, there are none."""
    tips_views: int = bounded(8, 4, 1000)
    """Number of pictures of a short scan, in the first ring of the scene."""
    late_h: float = bounded(12.0, 0.1, 10000.0)
    """Maximum delay of a scan, in hours. A scan that has not started by then is recorded as missed."""
    change: Changing = "person"
    """Way in which canisters are placed on the turntable: by a person, who is prompted, or by a carousel."""
    tries: int = bounded(3, 1, 100)
    """Maximum number of attempts before a scan is recorded as missed."""
    pause_min: float = bounded(5.0, 0.0, 1000.0)
    """Pause between two attempts, in minutes."""


@dataclass(frozen=True, kw_only=True)
class TwinPart:
    """Options of the emulated rig, used with rig = "twin"."""

    profile: str = "bench"
    """Simulated imperfections of the rig: clean, bench, camera, harsh, real, or a file."""
    seed: int = bounded(0, 0, 2**31)
    """Random seed for all simulated errors and noise."""
    fidelity: Literal["render", "sketch"] = "sketch"
    """Pictures: render (realistic, as by `rhizotwin simulate`) or sketch (fast, of panel and marker strip but not of
    the plant, so that they cannot be reconstructed)."""


@dataclass(frozen=True, kw_only=True)
class Reconstruction:
    """Options for the reconstruction of finished scans."""

    run: bool = True
    """Whether finished scans are reconstructed and the growth curves updated."""
    voxel_mm: float | None = field(default=None, metadata={"limits": (0.01, 10.0)})
    """Edge length of the smallest voxels, in mm. If it is empty, the default of `rhizotwin reconstruct` is used."""


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """Time-lapse experiment, as described in an experiment file."""

    name: str
    """Name of the experiment."""
    rig: str
    """Rig file, or "twin" for the emulated rig, which runs in virtual time."""
    scene: str
    """Name or file of the rig's scene, with canister, marker strip, calibrated camera and capture plan."""
    plants: tuple[Member, ...]
    """Plants and phantoms."""
    schedule: Schedule
    catalogue: str = ""
    """Catalogue file. If it is empty, it has the name of the experiment file with the suffix .rhizotwin."""
    scans: str = "scans"
    """Folder of the datasets."""
    results: str = "results"
    """Folder of the results, with the growth curves in the subfolder ``growth``."""
    twin: TwinPart = TwinPart()
    reconstruction: Reconstruction = Reconstruction()
    file: str = field(default="", compare=False)
    """Path of the experiment file, which is set by `load_experiment`. Relative paths in the file are relative to its
    folder."""

    @property
    def folder(self) -> Path:
        """Folder of the experiment file."""
        return Path(self.file).parent

    @property
    def catalogue_path(self) -> Path:
        """Path of the catalogue file."""
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
        """Time of the first round of scans, in UTC."""
        return datetime.fromisoformat(self.schedule.start).astimezone(UTC)

    @property
    def zone(self) -> tzinfo | None:
        """Offset from UTC at the first round of scans, in which all dates of the experiment are given."""
        start = datetime.fromisoformat(self.schedule.start)
        return start.tzinfo or start.astimezone().tzinfo

    @property
    def is_emulated(self) -> bool:
        """Whether the emulated rig is used."""
        return self.rig == "twin"

    def member(self, name: str) -> Member:
        """Return the plant with the given name.

        Raises
        ------
        UserError
            If the experiment file has no plant with this name.
        """
        for one in self.plants:
            if one.name == name:
                return one
        raise UserError(
            f"{self.file}: the plant {name!r} is missing, although the catalogue has a planned scan of this plant; restore it in [[plants]]"
        )

    def base_scene(self) -> Scene:
        """Return the scene of the rig."""
        return files.load_scene(self._resolve(self.scene))

    def specimen_scene(self, member: Member) -> Scene:
        """Return the scene with the specimen of a plant, for the emulated rig."""
        return files.load_scene(self._resolve(member.scene or self.scene))

    def disturbances(self) -> Disturbances:
        """Return the simulated imperfections of the emulated rig."""
        return files.load_profile(self._resolve(self.twin.profile))

    def _resolve(self, name: str) -> str:
        """Return the path of a file, which is relative to the folder of the experiment file, or the unchanged name."""
        return str(self.folder / name) if name.endswith(".toml") else name

    def plant(self, member: Member) -> Plant:
        """Return the catalogue entry of a plant."""
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
        """Return the sowing date of a plant."""
        return date.fromisoformat(member.sown) if member.sown else datetime.fromisoformat(self.schedule.start).date()

    def visits(self) -> list[tuple[str, str]]:
        """Return the plant and the planned time (UTC, ISO 8601) of each scan, sorted by time."""
        length_h = self.schedule.every_h * self.schedule.rounds
        found: list[tuple[datetime, int, str]] = []
        for number, one in enumerate(self.plants):
            every_h, short_h = self._every_h(one), self._short_h(one)
            count = ceil(round(length_h / every_h, 6))  # rounded, because 168 / 0.7 is slightly above 240
            between = ceil(round(every_h / short_h, 6))
            hours = [every_h * k + short_h * j for k in range(count) for j in range(between)]
            found += [(self.start_utc + timedelta(hours=after), number, one.name) for after in hours]
        return [(name, due.isoformat(timespec="seconds")) for due, _, name in sorted(found)]

    def _every_h(self, member: Member) -> float:
        """Return the interval between the scans of a plant, hours."""
        return member.every_h or self.schedule.every_h

    def _short_h(self, member: Member) -> float:
        """Return the interval between all scans of a plant, including short ones, hours."""
        every_min = None if member.phantom else self.schedule.tips_every_min
        return self._every_h(member) if every_min is None else min(every_min / 60.0, self._every_h(member))

    def is_short(self, member: Member, due_utc: str) -> bool:
        """Return whether a planned scan is a short one, which is only used for the motion of root tips."""
        rounds = (datetime.fromisoformat(due_utc) - self.start_utc) / timedelta(hours=self._every_h(member))
        return abs(rounds - round(rounds)) * 3600.0 * self._every_h(member) > 1.5  # planned times are rounded to seconds

    def most_late(self, plant: str, due_utc: str) -> timedelta:
        """Return the delay after which a planned scan is missed. Short scans are missed when the next one is due."""
        short = [self._short_h(one) for one in self.plants if one.name == plant and self.is_short(one, due_utc)]
        return timedelta(hours=min([self.schedule.late_h, *short]))

    def day(self, member: Member, when: datetime) -> float:
        """Return the age of a plant at a given time, in days since sowing.

        The age is a whole number of days at the time of day of the first round.
        """
        first = datetime.fromisoformat(self.schedule.start).date()
        return round((first - self.sown(member)).days + (when - self.start_utc) / timedelta(days=1), 4)

    def scan_folder(self, member: Member, due_utc: str) -> Path:
        """Return the folder for the dataset of a planned scan.

        Its name depends only on the plant and the planned time.
        """
        day = self.day(member, datetime.fromisoformat(due_utc))
        name = f"{day:08.4f}{SHORT}" if self.is_short(member, due_utc) else f"{day:06.2f}"
        return self.scans_folder / f"{_UNSAFE.sub('_', member.name)}_day_{name}"

    def known_scene(self, member: Member, due_utc: str, begin: datetime | None = None) -> Scene:
        """Return the scene of a planned scan with nominal values.

        The age is that at the planned time, so that all plants of a round have the same age in the growth curves. From
        a delay of half an interval or `MOST_DELAY`, whichever is shorter, it is the age at the start of the scan. That
        of short scans always is, because tips move in minutes.

        Parameters
        ----------
        member : Member
            Plant to be scanned.
        due_utc : str
            Planned time of the scan, UTC (ISO 8601).
        begin : datetime or None
            Time at which the scan begins; None: at the planned time.
        """
        due = datetime.fromisoformat(due_utc)
        begin = begin or due
        most = timedelta(0) if self.is_short(member, due_utc) else min(timedelta(hours=self._every_h(member)) / 2, MOST_DELAY)
        day = self.day(member, due if begin - due < most else begin)
        date = begin.astimezone(self.zone).date().isoformat()
        return self.scene_at(member, day=day, date=date, is_short=self.is_short(member, due_utc))

    def scene_at(self, member: Member, *, day: float | None, date: str, is_short: bool = False) -> Scene:
        """Return the nominal scene of a plant at a given age and date.

        It contains the marker strip, the subject and the nutrient solution of the plant.

        Parameters
        ----------
        member : Member
            Plant in the canister.
        day : float or None
            Age of the plant, days.
        date : str
            Date of the scan (ISO 8601).
        is_short : bool
            Whether the scene is that of a short scan, with few pictures.
        """
        base = self.base_scene()
        if is_short:
            ring = next(ring for ring in base.plan.rings if ring.kind == "root")
            base = replace(base, plan=replace(base.plan, rings=(replace(ring, views=min(ring.views, self.schedule.tips_views)),)))
        whose = Subject(
            plant=member.name,
            species=member.species,
            treatment=member.treatment,
            day=day,
            date=date,
            replicate=member.replicate,
            notes=member.notes,
        )
        solution = member.solution if member.solution.known else base.solution
        return replace(base, subject=whose, solution=solution, strip=strip_for_canister(base.strip, member.canister))


def load_experiment(path: Path | str) -> Experiment:
    """Read and validate an experiment file.

    Raises
    ------
    UserError
        If a key is unknown or a value is invalid. The message states the line.
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
    """Raise UserError for invalid dates, plants, canisters or paths."""
    for name in ("name", "rig", "scene", "catalogue", "scans", "results"):
        if not getattr(experiment, name).isprintable():
            raise place.at(name).error("must be one line of printable characters", ascii(getattr(experiment, name)))
    start = place.at("schedule", "start")
    try:
        end_utc = experiment.start_utc + timedelta(hours=experiment.schedule.every_h * experiment.schedule.rounds)
    except ValueError:
        raise start.error("must be a date and time such as 2026-12-01T09:00", experiment.schedule.start) from None
    except OverflowError:
        raise start.error("must be such that all scans are between the years 1 and 9999", experiment.schedule.start) from None
    if not experiment.plants:
        raise place.at("plants").error("must contain at least one plant; add a table [[plants]]")
    if experiment.catalogue and not experiment.catalogue.endswith(SUFFIX):
        raise place.at("catalogue").error(f"must end with {SUFFIX}", experiment.catalogue)
    scene = experiment.base_scene()
    if scene.plants:
        raise place.at("scene").error("must be a scene with one plant in the canister, not several", experiment.scene)
    names: dict[str, str] = {}
    canisters: dict[int, str] = {}
    for number, one in enumerate(experiment.plants):
        here = place.at("plants", number)
        check_subject(Subject(plant=one.name, species=one.species, treatment=one.treatment, date=one.sown, notes=one.notes), here)
        check_solution(one.solution, here.at("solution"))
        safe = _UNSAFE.sub("_", one.name)
        if not one.name or safe in names:
            other = f"is too similar to the name {names[safe]!r}" if one.name else "must not be empty"
            raise here.at("name").error(
                f"{other}; the folders of scans are named after the plants, so each plant needs a name of its own", one.name
            )
        if one.canister in canisters:
            raise here.at("canister").error(f"is already the canister of plant {canisters[one.canister]}; use another number", one.canister)
        names[safe], canisters[one.canister] = one.name, one.name
        try:
            check_scene(replace(scene, strip=strip_for_canister(scene.strip, one.canister)), where=str(here.where))
        except UserError as error:
            raise here.at("canister").error(str(error), one.canister) from None
        if experiment.day(one, experiment.start_utc) < 0.0:
            raise here.at("sown").error("must not be later than the first scan", one.sown)
        if experiment.day(one, end_utc) > (most := _limits("day")[1]):
            raise here.at("sown").error(f"must not be more than {most:g} days before the last scan", one.sown)
