"""Argument types that several commands use, with their limits and error messages.

A type is ``Annotated[type, option(reader, "METAVAR")]``. The reader converts the typed text and raises ValueError with
the allowed limits.
"""

import errno
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

from cyclopts import Parameter

from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.schema import Place
from rhizotwin.scenes.solution import Solution, read_solution
from rhizotwin.scenes.subject import check_subject
from rhizotwin.scenes.terminal import OneBar

T = TypeVar("T")

MOST_PARTS = 250
"""Maximum depth of nested folders in a path. Python creates and removes them by recursion, limited to 1000 calls."""
VOXEL_LIMITS_MM = (0.01, 10.0)
DIAMETER_LIMITS_MM = (0.01, 50.0)
SHIFT_LIMITS_MM = (-1e6, 1e6)
SCALE_LIMITS = (1e-6, 1e6)
MASS_LIMITS_G = (1e-6, 1e6)
DAY_LIMITS = (0.0, 36500.0)
VOLUME_LIMITS_ML = (1e-6, 1e6)
PIXEL_LIMITS = (16, 20000)
MAX_VIEWS = 10000
MAX_SAMPLES = 1 << 16
MAX_SEEDS = 1000


def option(read: Callable[[str], object], metavar: str, *, name: str | tuple[str, ...] | None = None) -> Parameter:
    """Create the parameter of a single value; ``read`` converts its text and raises ValueError with a message."""

    def convert(_: Any, tokens: Any) -> object:
        return read(tokens[0].value)

    return Parameter(name=name, converter=convert, n_tokens=1, accepts_keys=False, metavar=metavar)


def options(read: Callable[[str], object], metavar: str) -> Parameter:
    """Create the parameter of an option that may be repeated; its values form a tuple."""

    def convert(_: Any, tokens: Any) -> object:
        return tuple(read(token.value) for token in tokens)

    return Parameter(converter=convert, n_tokens=1, metavar=metavar, show_default=False)


def with_metavar(metavar: str, *, name: str | tuple[str, ...] | None = None) -> Parameter:
    """Create the parameter of a text or path with its own metavar; paths are checked by `check_paths`."""
    return Parameter(name=name, metavar=metavar, validator=check_paths)


def output(metavar: str) -> Parameter:
    """Create the parameter of the option ``--output`` (``-o``)."""
    return Parameter(name=("--output", "-o"), metavar=metavar, validator=check_paths)


def check_paths(_: Any, given: Any) -> None:
    """Reject paths that are invalid for the operating system, or nested too deeply.

    Raises
    ------
    ValueError
        If a path is rejected.
    """
    for path in given if isinstance(given, list | tuple) else [given]:
        if isinstance(path, Path):
            if len(path.parts) > MOST_PARTS:
                raise ValueError(f"{str(path)[:100]}... has {len(path.parts)} nested folders (maximum {MOST_PARTS}); use a shorter path")
            try:
                path.stat()
            except OSError as error:
                if error.errno in (errno.ELOOP, errno.ENAMETOOLONG):
                    raise ValueError(f"{str(path)[:100]} is not a valid path ({error.strerror}); use another path") from None


def read_integer(text: str, low: int, high: int, what: str) -> int:
    """Convert text to an integer within limits.

    Parameters
    ----------
    text : str
        Text as typed.
    low, high : int
        Minimum and maximum, inclusive.
    what : str
        Description of the limits for the error message.

    Returns
    -------
    int
        Value.
    """
    try:
        value = int(text)
    except ValueError:
        raise ValueError(f"{text!r} is not a whole number") from None
    if not low <= value <= high:
        raise ValueError(f"{text} is out of range; {what}")
    return value


def read_number(text: str, limits: tuple[float, float], unit: str, units: str | None = None) -> float:
    """Convert text to a number within limits.

    Parameters
    ----------
    text : str
        Text as typed.
    limits : tuple of float
        Minimum and maximum, inclusive.
    unit, units : str, (str or None)
        Unit and its plural, for error messages.

    Returns
    -------
    float
        Value.
    """
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{text!r} is not a number{f' of {units or unit}' if unit else ''}") from None
    low, high = limits
    if not low <= value <= high:
        raise ValueError(f"{text} is out of range; give {low:g} to {high:g} {unit}".rstrip())
    return value


def read_length_mm(text: str, limits: tuple[float, float]) -> float:
    """Convert text to a length in mm within limits."""
    return read_number(text, limits, "mm", "millimetres")


def list_of(one: Callable[[str], T], *, once: bool = True) -> Callable[[str], tuple[T, ...]]:
    """Return a reader of comma-separated values; ``once`` removes duplicates."""

    def read(text: str) -> tuple[T, ...]:
        values = [one(part) for part in text.split(",")]
        return tuple(dict.fromkeys(values)) if once else tuple(values)

    return read


def read_views(text: str) -> int:
    """Read a number of views."""
    return read_integer(text, 1, MAX_VIEWS, f"give 1 to {MAX_VIEWS}")


def read_mass_g(text: str) -> float:
    """Read a mass."""
    return read_number(text, MASS_LIMITS_G, "g", "grams")


def read_image_wh(text: str) -> tuple[int, int]:
    """Read a picture size such as 800x600."""
    width, cross, height = text.lower().partition("x")
    if not (cross and width.isdecimal() and height.isdecimal()):
        raise ValueError(f"{text!r} is not a picture size; write it as 800x600")
    low, high = PIXEL_LIMITS
    if not all(low <= side <= high for side in (int(width), int(height))):
        raise ValueError(f"{text} is out of range; width and height must be {low} to {high} pixels")
    return int(width), int(height)


Device: TypeAlias = Literal["auto", "cpu", "cuda"]
Flag: TypeAlias = Annotated[bool, Parameter(show_default=False)]
SceneName: TypeAlias = Annotated[str, with_metavar("SCENE")]
Profile: TypeAlias = Annotated[str, with_metavar("clean|bench|camera|harsh|real")]
ResultFolder: TypeAlias = Annotated[Path, with_metavar("RESULT")]
DatasetFolder: TypeAlias = Annotated[Path, with_metavar("DATASET")]
OutputDataset: TypeAlias = Annotated[Path, output("DATASET")]
OutputResult: TypeAlias = Annotated[Path, output("RESULT")]
OutputFile: TypeAlias = Annotated[Path, output("FILE")]
OutputFolder: TypeAlias = Annotated[Path, output("FOLDER")]
Views: TypeAlias = Annotated[int, option(read_views, "N")]
ImageWh: TypeAlias = Annotated[tuple[int, int], option(read_image_wh, "WxH")]
Samples: TypeAlias = Annotated[int, option(lambda text: read_integer(text, 1, MAX_SAMPLES, f"give 1 to {MAX_SAMPLES}"), "N")]
Seed: TypeAlias = Annotated[int, option(lambda text: read_integer(text, 0, 2**63 - 1, "give 0 or a positive whole number"), "S")]
Port: TypeAlias = Annotated[int, option(lambda text: read_integer(text, 1, 65535, "give 1 to 65535"), "N")]
VoxelMm: TypeAlias = Annotated[float, option(lambda text: read_length_mm(text, VOXEL_LIMITS_MM), "MM")]
DiameterMm: TypeAlias = Annotated[float, option(lambda text: read_length_mm(text, DIAMETER_LIMITS_MM), "D")]
VolumeMl: TypeAlias = Annotated[float, option(lambda text: read_number(text, VOLUME_LIMITS_ML, "ml", "millilitres"), "ML")]
MassG: TypeAlias = Annotated[float, option(read_mass_g, "G")]


def read_day(text: str) -> float:
    """Read a plant's age."""
    return read_number(text, DAY_LIMITS, "days")


def read_date(text: str) -> str:
    """Read a date."""
    try:
        return date.fromisoformat(text).isoformat()
    except ValueError:
        raise ValueError(f"{text!r} is not a date; write it as 2022-10-06") from None


def read_shift_mm(text: str) -> tuple[float, float, float]:
    """Read a shift such as 0,0,-20."""
    parts = text.split(",")
    if len(parts) != 3:
        raise ValueError(f"{text!r} is not a shift; write it as X,Y,Z in mm, such as 0,0,-20")
    x, y, z = (read_length_mm(part, SHIFT_LIMITS_MM) for part in parts)
    return x, y, z


SolutionName = Annotated[Solution, option(read_solution, "NAME|FILE[,K=0.5,...]")]


@Parameter(name="*", group="Plant")
@dataclass(frozen=True, kw_only=True)
class SubjectOptions:
    """Plant in the canister; each option overrides the scene's [subject]."""

    plant: Annotated[str | None, with_metavar("NAME")] = None
    """Name of the plant; must be the same for every scan of the plant."""
    species: Annotated[str | None, with_metavar("NAME")] = None
    """Species of the plant, such as 'Raphanus sativus'."""
    treatment: Annotated[str | None, with_metavar("NAME")] = None
    """Treatment, for example 'low N'."""
    day: Annotated[float | None, option(read_day, "DAYS")] = None
    """Age of the plant: days since sowing."""
    date: Annotated[str | None, option(read_date, "DATE")] = None
    """Date of the scan, such as 2022-10-06."""
    replicate: Annotated[int | None, option(lambda text: read_integer(text, 0, 1000000, "give 0 or a positive whole number"), "N")] = None
    """Number of the replicate within its treatment."""
    notes: Annotated[str | None, with_metavar("TEXT")] = None
    """Free text, copied to every table."""
    solution: SolutionName | None = None
    """Nutrient solution: kliman_2022, or a TOML file with the keys of [solution]; optionally with a factor per \
element, such as kliman_2022,K=0.5."""

    def apply_to(self, scene: Scene) -> Scene:
        """Return a copy of the scene with the given subject and solution.

        Raises
        ------
        UserError
            If a text contains characters that are not allowed in tables.
        """
        given = {name: value for name, value in vars(self).items() if value is not None}
        dissolved = given.pop("solution", scene.solution)
        subject = replace(scene.subject, **given)
        check_subject(subject, Place("the command line").at("subject"))
        return replace(scene, subject=subject, solution=dissolved)


@Parameter(name="*", group="Scene")
@dataclass(frozen=True, kw_only=True)
class Placing:
    """Position of a specimen file in the canister; None keeps the scene's value."""

    place: Literal["given", "auto"] | None = None
    """Position of the specimen: given (use the coordinates of the file) or auto (upright and centred below the net \
pot)."""
    flip: Flag | None = None
    """Turn the specimen upside down first, for files in which z points down."""
    scale: Annotated[float, option(lambda text: read_number(text, SCALE_LIMITS, ""), "S")] | None = None
    """Scale factor, applied to coordinates and diameters after --flip."""
    shift_mm: Annotated[tuple[float, float, float], option(read_shift_mm, "X,Y,Z")] | None = None
    """Translation in mm, applied last. If the first number is negative, write --shift-mm=-5,0,-20."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Progress:
    """Progress output: one bar on a terminal, one line per stage elsewhere."""

    quiet: Flag = False
    """Show no progress."""
    verbose: Flag = False
    """Print one line per stage with its duration."""

    def bar(self, **shares: float) -> OneBar:
        """Return a progress bar; ``shares`` are the relative durations of the stages."""
        return OneBar(shares, quiet=self.quiet, verbose=self.verbose)


@Parameter(name="*", group="Web page")
@dataclass(frozen=True, kw_only=True)
class Page:
    """Address of a served page."""

    host: Annotated[str, with_metavar("ADDRESS")] = "127.0.0.1"
    """Network address to serve the page on; 127.0.0.1 allows connections from this computer only."""
    port: Port = 8080
    """Port to serve the page on; if it is in use, the next free port."""
    no_browser: Flag = False
    """Print the address of the page without opening a browser."""


@Parameter(name="*", group="Scene")
@dataclass(frozen=True, kw_only=True)
class SceneChanges:
    """Changes to a scene."""

    profile: Profile | None = None
    """Simulated errors of the rig: clean (none), bench (a well-built rig), camera (bench with an ordinary camera), \
harsh (a badly adjusted rig), real (a first scan of a living plant), or a TOML file; default: as in the scene."""
    specimen: Annotated[Path | None, with_metavar("FILE")] = None
    """Replace the scene's root by a file: a closed mesh (PLY, STL, OBJ) in mm, or traced roots (RSML). Coordinates \
are in the canister frame: origin on the axis in the plane of the rim, z up, roots at negative z. For other \
coordinates see --place."""
    specimen_unit: Annotated[str | None, with_metavar("UNIT")] = None
    """Unit of the coordinates in an RSML file, if the file gives none or a wrong one: mm, cm, m, um, inch, or a \
multiple such as '0.1 mm'."""
    specimen_diameter_mm: DiameterMm | None = None
    """Diameter of roots without a diameter in the RSML file."""
    placing: Placing = Placing()
    """Position of the specimen."""
    views: Views | None = None
    """Number of pictures per ring of camera positions; default: as in the scene."""
    image_wh: ImageWh | None = None
    """Picture size in pixels, such as 800x600; default: as in the scene."""
