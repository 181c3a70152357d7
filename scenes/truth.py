"""Ground truth of simulated datasets. It is not available to the reconstruction.

Code that reconstructs a shape never opens the ``truth`` folder of a dataset.

The truth is used by `score`, which compares it with a result, and by the command line, which draws the true solid
beside the reconstructed shape after a result is written.

truth/  truth.json      this module's `Truth`
        specimen.ply    watertight solid, canister frame, mm
        shoot.ply       the same for the shoot, if there is one
        skeleton.rsml   roots with diameters (grown and RSML specimens)
        masks/NAME.png  16 bit: fraction of the pixel whose refracted primary ray meets the specimen; NAME as in images/
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rhizotwin.scenes.atomic import write_json
from rhizotwin.scenes.dataset import check_rigid
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.schema import Place, from_plain, to_plain
from rhizotwin.scenes.versioned_json import read_versioned_json

SCHEMA_VERSION = 1


@dataclass(frozen=True, kw_only=True)
class TrueView:
    """True camera pose and table angle of a frame."""

    file: str
    cam_from_canister: tuple[tuple[float, ...], ...]
    table_deg: float
    """True table angle, deg. The offset and the tilt of the canister are not included."""


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
    """Fields of `scenes.traits.Traits`. Traits that require centre lines are None if the specimen has no centre
    lines."""
    plants: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Volume (``volume_mm3``) and ``traits`` of each plant. The keys are names of plants. There is no entry if the
    canister contains a single plant. If plants touch, the sum of their volumes exceeds the total volume."""
    shoot: dict[str, float] = field(default_factory=dict)
    """Volume, one-sided leaf area, number of leaves, height and widths of the shoot. For a camera with bands, its
    reflectances and vegetation indices are included. It is empty if there is no shoot."""
    drawn: dict[str, Any] = field(default_factory=dict)
    """Other random values that were drawn for the pictures, the error of the focal length, and the description of the
    specimen with notes. Dust, scratches, the highlight and the factors of the exposure are not included."""


def load_truth(folder: Path | str) -> Truth:
    """Load ``truth/truth.json`` of a dataset.

    Parameters
    ----------
    folder : path
        Folder of the dataset (not its ``truth`` folder).

    Raises
    ------
    UserError
        If the file is missing (only simulated datasets have a truth), damaged, or of an unsupported version.
    """
    path = Path(folder) / "truth" / "truth.json"
    if not path.is_file():
        raise UserError(
            f"{folder}: the dataset has no truth/truth.json; only simulated datasets (`rhizotwin simulate` or `scan`) can be scored"
        )
    mapping = read_versioned_json(path, SCHEMA_VERSION)
    place = Place(str(path))
    truth = from_plain(Truth, {key: value for key, value in mapping.items() if key != "schema_version"}, place)
    check_rigid(truth.canister_from_strip, place.at("canister_from_strip"))
    for i, view in enumerate(truth.views):
        check_rigid(view.cam_from_canister, place.at("views", i, "cam_from_canister"))
    return truth


def save_truth(folder: Path | str, truth: Truth) -> None:
    """Write ``truth/truth.json`` of a dataset atomically.

    `load_truth` returns an object that is equal to the given one.

    Parameters
    ----------
    folder : path
        Folder of the dataset (not its ``truth`` folder).
    truth : Truth
        Ground truth, whose ``drawn`` must contain only plain JSON values.

    Raises
    ------
    UserError
        If the file cannot be written.
    """
    write_json(Path(folder) / "truth" / "truth.json", {"schema_version": SCHEMA_VERSION} | to_plain(truth))
