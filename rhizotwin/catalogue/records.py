"""Entries of a catalogue as frozen dataclasses."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal

from rhizotwin.scenes.markers import MOST_COMMON, ids_text, marker_ids
from rhizotwin.scenes.model import MarkerStrip
from rhizotwin.scenes.solution import Solution

State = Literal["due", "scanning", "scanned", "missed"]
"""State of a planned scan. It is due (not started), scanning (started, and perhaps interrupted), scanned, or missed."""


@dataclass(frozen=True, kw_only=True)
class Tag:
    """Markers that identify the marker strip of a net pot, and thus its plant."""

    dictionary: str
    """OpenCV's name of the marker dictionary."""
    first_id: int
    """`MarkerStrip.first_id`."""
    markers: int
    """Number of markers on the strip."""

    @classmethod
    def of_strip(cls, strip: MarkerStrip) -> "Tag | None":
        """Return the tag of a marker strip, or None if the strip has no markers."""
        count = strip.rows * strip.columns
        return cls(dictionary=strip.dictionary, first_id=strip.first_id, markers=count) if count else None

    @cached_property
    def ids(self) -> frozenset[int]:
        """Ids of the markers on the strip (`marker_ids`)."""
        return frozenset(marker_ids(self.dictionary, self.first_id, self.markers).tolist())

    def overlaps(self, other: "Tag") -> bool:
        """Return whether two tags have so many common markers that they could be confused."""
        return self.dictionary == other.dictionary and len(self.ids & other.ids) > MOST_COMMON

    def __str__(self) -> str:
        """Return the dictionary and the ids of the markers as text."""
        return f"{self.dictionary} markers {ids_text(self.dictionary, self.first_id, self.markers)}"


@dataclass(frozen=True, kw_only=True)
class Plant:
    """Plant of the experiment."""

    name: str
    species: str = ""
    treatment: str = ""
    replicate: int | None = None
    sown: str = ""
    """Date of sowing, such as 2022-10-06. It is empty if the date is unknown."""
    notes: str = ""
    solution: Solution = field(default_factory=Solution)
    tag: Tag | None = None
    """Tag of the plant's marker strip. It is None if the strip is unknown."""
    phantom: bool = False
    """Whether the entry is a phantom of known shape, which is excluded from growth curves and biomass."""


@dataclass(frozen=True, kw_only=True)
class Scan:
    """Scan of the experiment, stored as a dataset."""

    path: Path
    """Folder of the dataset."""
    sha256: str
    """SHA-256 of dataset.json, which contains the SHA-256 of each picture."""
    plants: tuple[str, ...]
    """Names of the plants in the canister, or an empty tuple if the dataset does not contain them."""
    scene: str
    """Name of the scene."""
    day: float | None
    """Age of the plant at the scan, in days since sowing."""
    date: str
    """Date of the scan."""
    pictures: int
    """Number of pictures."""
    complete: bool
    """Whether the scan is complete. It is False if the scan was interrupted."""
    sketch: bool
    """Whether the pictures are sketches of the emulated rig, which do not show the plant."""


@dataclass(frozen=True, kw_only=True)
class StoredResult:
    """Reconstruction of a scan of the experiment."""

    path: Path
    """Folder of the result."""
    sha256: str
    """SHA-256 of result.json."""
    scan: Path | None
    """Folder of the dataset from which the result was reconstructed. It is None if this dataset is not in the
    catalogue."""
    plants: tuple[str, ...]
    day: float | None
    trusted: bool
    """Whether the volume is reliable."""
    verdict: str
    corrected: bool
    """Whether the result was corrected manually."""
    edits: Path | None
    """File with the log of corrections in the folder of the result. It is None if there is no such file."""
    rig_numbers: Mapping[str, float]
    """Rig parameters that were measured in the reconstruction. The keys are listed in
    `experiment.drift.RIG_NUMBERS`."""


@dataclass(frozen=True, kw_only=True)
class Mass:
    """Weighed mass of a plant."""

    plant: str
    day: float | None
    kind: str
    """Kind of mass (organ, and fresh or dry), as defined in `experiment.masses.KINDS`."""
    grams: float
    source: Path
    """Table from which the mass was read."""


@dataclass(frozen=True, kw_only=True)
class Visit:
    """Planned scan of a plant in a time-lapse experiment."""

    plant: str
    due_utc: str
    """Planned time of the scan, UTC (ISO 8601)."""
    state: State
    began_utc: str = ""
    ended_utc: str = ""
    scan: Path | None = None
    note: str = ""
    """Reason why the scan was missed, or error message of the last attempt."""


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Difference between the catalogue and a file that it lists."""

    path: Path
    kind: Literal["missing", "changed", "damaged", "incomplete", "unlisted"]
    text: str
    """Description of the difference, for the user."""
