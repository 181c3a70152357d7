"""Entries of a catalogue as frozen values."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from rhizotwin.scenes.model import MarkerStrip
from rhizotwin.scenes.solution import Solution

State = Literal["due", "scanning", "scanned", "missed"]
"""State of a visit: due (not begun), scanning (begun, perhaps interrupted), scanned, missed."""


@dataclass(frozen=True, kw_only=True)
class Tag:
    """Range of marker numbers that identifies the strip of a pot, and with it the plant."""

    dictionary: str
    """Dictionary of the markers as OpenCV names it."""
    first_id: int
    markers: int
    """Number of markers on the strip; their ids are ``first_id`` to ``first_id + markers - 1``."""

    @classmethod
    def of_strip(cls, strip: MarkerStrip) -> "Tag | None":
        """Return the tag of a strip; None if the scene has no strip."""
        count = strip.rows * strip.columns
        return cls(dictionary=strip.dictionary, first_id=strip.first_id, markers=count) if count else None

    @property
    def last_id(self) -> int:
        """Number of the last marker."""
        return self.first_id + self.markers - 1

    def overlaps(self, other: "Tag") -> bool:
        """Return whether two strips share a marker."""
        same = self.dictionary == other.dictionary
        return same and self.first_id <= other.last_id and other.first_id <= self.last_id

    def __str__(self) -> str:
        """Return dictionary and numbers in words."""
        return f"{self.dictionary} markers {self.first_id} to {self.last_id}"


@dataclass(frozen=True, kw_only=True)
class Plant:
    """A plant of the experiment."""

    name: str
    species: str = ""
    treatment: str = ""
    replicate: int | None = None
    sown: str = ""
    """Date of sowing as 2022-10-06; empty: not known."""
    notes: str = ""
    solution: Solution = field(default_factory=Solution)
    tag: Tag | None = None
    """Tag of the strip on its pot; None: not known."""
    phantom: bool = False
    """Whether it is a phantom of known shape, which is left out of growth and biomass."""


@dataclass(frozen=True, kw_only=True)
class Scan:
    """A dataset of the experiment."""

    path: Path
    """Folder of the dataset."""
    sha256: str
    """SHA-256 of dataset.json, which holds those of the pictures."""
    plants: tuple[str, ...]
    """Plants in the canister; empty: the dataset names none."""
    scene: str
    day: float | None
    """Days since sowing."""
    date: str
    pictures: int
    complete: bool
    """False: an interrupted scan."""
    sketch: bool
    """The pictures are sketches of the emulated rig, which show the strip but no roots."""


@dataclass(frozen=True, kw_only=True)
class StoredResult:
    """A reconstruction of the experiment."""

    path: Path
    """Folder of the result."""
    sha256: str
    """SHA-256 of result.json."""
    scan: Path | None
    """Dataset that it was reconstructed from; None: not in the catalogue."""
    plants: tuple[str, ...]
    day: float | None
    trusted: bool
    """Whether the volume is reliable."""
    verdict: str
    corrected: bool
    """Edited by hand."""
    edits: Path | None
    """Log of corrections; None: there is none."""
    rig_numbers: Mapping[str, float]
    """See `experiment.drift.RIG_NUMBERS`."""


@dataclass(frozen=True, kw_only=True)
class Mass:
    """A weighed mass of a plant."""

    plant: str
    day: float | None
    kind: str
    """Organ and state as in `experiment.masses.KINDS`."""
    grams: float
    source: Path
    """Table that it was read from."""


@dataclass(frozen=True, kw_only=True)
class Visit:
    """A planned scan of a plant in a time-lapse experiment."""

    plant: str
    due_utc: str
    """Time at which it is due, UTC as ISO 8601."""
    state: State
    began_utc: str = ""
    ended_utc: str = ""
    scan: Path | None = None
    note: str = ""
    """Reason why it was missed, or the last interruption."""


@dataclass(frozen=True, kw_only=True)
class Problem:
    """A difference between the catalogue and the files that it lists."""

    path: Path
    kind: Literal["missing", "changed", "damaged", "incomplete", "unlisted"]
    text: str
    """Description for people."""
