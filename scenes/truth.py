"""What the simulator knows and the reconstruction must not.

Nothing that finds the shape opens a dataset's ``truth`` folder.

`score` compares a result with it, and once a result is written, the command line draws the true solid beside the shape.

truth/  truth.json      this module's `Truth`
        specimen.ply    watertight solid, canister frame, mm
        shoot.ply       the same of what grows above the net pot, where something does
        skeleton.rsml   roots with diameters (grown and RSML specimens)
        masks/NAME.png  16 bit: fraction of the pixel whose refracted primary ray meets the specimen; NAME as in images/
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rhizotwin.scenes.atomic import write_json
from rhizotwin.scenes.dataset import check_rigid, read_versioned_json
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.schema import Place, from_plain, to_plain

SCHEMA_VERSION = 1


@dataclass(frozen=True, kw_only=True)
class TrueView:
    """The camera that really took a frame."""

    file: str
    cam_from_canister: tuple[tuple[float, ...], ...]
    table_deg: float
    """True table angle, before the canister's offset and tilt."""


@dataclass(frozen=True, kw_only=True)
class Truth:
    """Ground truth of a simulated dataset."""

    volume_mm3: float
    extents_min_mm: tuple[float, float, float]
    extents_max_mm: tuple[float, float, float]
    n_water: float
    canister_from_strip: tuple[tuple[float, ...], ...]
    views: tuple[TrueView, ...]
    traits: dict[str, Any] = field(default_factory=dict)
    """Fields of `scenes.traits.Traits`; None where they need centre lines and the specimen has none."""
    plants: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Of several plants in the canister, by name: ``volume_mm3`` of each alone (where two touch, their sum is above the
    whole) and its ``traits``; empty: there is one."""
    shoot: dict[str, float] = field(default_factory=dict)
    """Volume, one-sided leaf area, number of leaves, height and widths of what grows above the net pot, and where the
    camera has bands its reflectances and vegetation indices; empty: nothing does."""
    drawn: dict[str, Any] = field(default_factory=dict)
    """Every other random draw that went into the pictures, the specimen's description and the notes on it."""


def load_truth(folder: Path | str) -> Truth:
    """Load ``truth/truth.json`` of a dataset.

    Parameters
    ----------
    folder : path
        The dataset's folder (not its ``truth``).

    Raises
    ------
    UserError
        When there is none (only simulated datasets have it), or it is damaged or of another version.
    """
    path = Path(folder) / "truth" / "truth.json"
    if not path.is_file():
        raise UserError(f"{folder}: has no truth/truth.json; only what the twin rendered (`rhizotwin simulate` or `scan`) can be scored")
    mapping = read_versioned_json(path, SCHEMA_VERSION)
    place = Place(str(path))
    truth = from_plain(Truth, {key: value for key, value in mapping.items() if key != "schema_version"}, place)
    check_rigid(truth.canister_from_strip, place.at("canister_from_strip"))
    for i, view in enumerate(truth.views):
        check_rigid(view.cam_from_canister, place.at("views", i, "cam_from_canister"))
    return truth


def save_truth(folder: Path | str, truth: Truth) -> None:
    """Write ``truth/truth.json`` of a dataset atomically; `load_truth` gives an equal truth back.

    Parameters
    ----------
    folder : path
        The dataset's folder (not its ``truth``).
    truth : Truth
        ``drawn`` must hold plain JSON values.

    Raises
    ------
    UserError
        When it cannot be written.
    """
    write_json(Path(folder) / "truth" / "truth.json", {"schema_version": SCHEMA_VERSION} | to_plain(truth))
