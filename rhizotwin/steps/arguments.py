"""Types of command-line arguments shared by several commands, with limits and error messages.

A type is ``Annotated[type, option(reader, "METAVAR")]``. The reader is a function that converts the typed text, and
raises ValueError with the allowed limits.
"""

import errno
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

from cyclopts import Parameter

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.schema import Place
from rhizotwin.scenes.solution import Solution, read_solution
from rhizotwin.scenes.subject import check_subject
from rhizotwin.scenes.terminal import OneBar

T = TypeVar("T")

MOST_PARTS = 250
"""Maximum number of nested folders in a path. Python creates and removes folders recursively, to a depth of 1000."""
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


def option(read: Callable[[str], object], metavar: str, *, name: str | tuple[str, ...] | None = None, **more: Any) -> Parameter:
    """Define a command-line parameter that has a single value.

    The function ``read`` converts the typed text, and raises ValueError if it is invalid. Other arguments are passed to
    `cyclopts.Parameter`.
    """

    def convert(_: Any, tokens: Any) -> object:
        return read(tokens[0].value)

    return Parameter(name=name, converter=convert, n_tokens=1, accepts_keys=False, metavar=metavar, **more)


def options(read: Callable[[str], object], metavar: str) -> Parameter:
    """Define an option that may be repeated.

    The values of all repetitions are collected in a tuple.
    """

    def convert(_: Any, tokens: Any) -> object:
        return tuple(read(token.value) for token in tokens)

    return Parameter(converter=convert, n_tokens=1, metavar=metavar, show_default=False)


def with_metavar(metavar: str, *, name: str | tuple[str, ...] | None = None) -> Parameter:
    """Define a parameter for a text or a path.

    ``metavar`` is its placeholder in the help text. A path is validated by `check_paths`.
    """
    return Parameter(name=name, metavar=metavar, validator=check_paths)


def output(metavar: str) -> Parameter:
    """Define the option ``--output`` (``-o``) with the given metavar."""
    return Parameter(name=("--output", "-o"), metavar=metavar, validator=check_paths)


def check_paths(_: Any, given: Any) -> None:
    """Validate a path or list of paths.

    Raises
    ------
    ValueError
        If a path is invalid for the operating system or has more than `MOST_PARTS` nested folders.
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


def check_new_file(path: Path, *suffixes: str) -> None:
    """Raise UserError if a file to be written exists, or if its name has none of the suffixes."""
    if path.exists():
        raise UserError(f"{path} already exists; choose another name")
    if suffixes and path.suffix.lower() not in suffixes:
        raise UserError(f"the suffix of {path} must be {' or '.join(suffixes)}")


def read_integer(text: str, low: int, high: int, what: str) -> int:
    """Convert text to an integer within limits.

    Parameters
    ----------
    text : str
        Text to convert.
    low, high : int
        Minimum and maximum value, inclusive.
    what : str
        Description of the limits for the error message, such as "give 1 to 9".

    Returns
    -------
    int
        Converted value.
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
        Text to convert.
    limits : tuple of float
        Minimum and maximum value, inclusive.
    unit, units : str, (str or None)
        Symbol of the unit and its name in the plural, for error messages.

    Returns
    -------
    float
        Converted value.
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
    """Return a function that converts comma-separated text to a tuple.

    ``one`` converts each part. If ``once`` is true, duplicate values are removed.
    """

    def read(text: str) -> tuple[T, ...]:
        values = [one(part) for part in text.split(",")]
        return tuple(dict.fromkeys(values)) if once else tuple(values)

    return read


def read_views(text: str) -> int:
    """Convert text to a number of views, 1 to `MAX_VIEWS`."""
    return read_integer(text, 1, MAX_VIEWS, f"give 1 to {MAX_VIEWS}")


def read_mass_g(text: str) -> float:
    """Convert text to a mass in grams."""
    return read_number(text, MASS_LIMITS_G, "g", "grams")


def read_two_integers(text: str, limits: tuple[int, int], kind: str, example: str, unit: str) -> tuple[int, int]:
    """Convert text such as 800x600 to two integers within limits.

    Parameters
    ----------
    text : str
        Text to convert.
    limits : tuple of int
        Minimum and maximum value of both, inclusive.
    kind, example, unit : str
        Description of the values, an example, and their unit, for error messages.
    """
    first, cross, second = text.lower().partition("x")
    if not (cross and first.isdecimal() and second.isdecimal()):
        raise ValueError(f"{text!r} is not {kind}; write it as {example}")
    low, high = limits
    if not all(low <= one <= high for one in (int(first), int(second))):
        raise ValueError(f"{text} is out of range; give {low} to {high} {unit}")
    return int(first), int(second)


def read_image_wh(text: str) -> tuple[int, int]:
    """Convert a picture size such as 800x600 to width and height in pixels."""
    return read_two_integers(text, PIXEL_LIMITS, "a picture size", "800x600", "pixels for width and height")


Device: TypeAlias = Literal["auto", "cpu", "cuda"]
Flag: TypeAlias = Annotated[bool, Parameter(show_default=False)]
SceneName: TypeAlias = Annotated[str, with_metavar("SCENE")]
Profile: TypeAlias = Annotated[str, with_metavar("PROFILE")]
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
    """Convert text to the age of a plant in days."""
    return read_number(text, DAY_LIMITS, "days")


def read_date(text: str) -> str:
    """Validate an ISO date such as 2022-10-06, and return it as text."""
    try:
        return date.fromisoformat(text).isoformat()
    except ValueError:
        raise ValueError(f"{text!r} is not a date; write it as 2022-10-06") from None


def read_shift_mm(text: str) -> tuple[float, float, float]:
    """Convert a translation such as 0,0,-20 to x, y and z in mm."""
    parts = text.split(",")
    if len(parts) != 3:
        raise ValueError(f"{text!r} is not a translation; write it as X,Y,Z in mm, such as 0,0,-20")
    x, y, z = (read_length_mm(part, SHIFT_LIMITS_MM) for part in parts)
    return x, y, z


Replicate: TypeAlias = Annotated[int, option(lambda text: read_integer(text, 0, 1000000, "give 0 or a positive whole number"), "N")]
SolutionName = Annotated[Solution, option(read_solution, "SOLUTION")]


@Parameter(name="*", group="Plant")
@dataclass(frozen=True, kw_only=True)
class SubjectOptions:
    """Options that describe the plant in the canister; they override the scene's table [subject]."""

    plant: Annotated[str | None, with_metavar("NAME")] = None
    """Name of the plant; use the same name for all scans of a plant."""
    species: Annotated[str | None, with_metavar("NAME")] = None
    """Species of the plant, such as 'Raphanus sativus'."""
    treatment: Annotated[str | None, with_metavar("NAME")] = None
    """Treatment of the plant, such as 'low N'."""
    day: Annotated[float | None, option(read_day, "DAYS")] = None
    """Age of the plant, in days since sowing."""
    date: Annotated[str | None, option(read_date, "DATE")] = None
    """Date of the scan, such as 2022-10-06."""
    replicate: Replicate | None = None
    """Number of the replicate within its treatment."""
    notes: Annotated[str | None, with_metavar("TEXT")] = None
    """Free text, copied to all tables of traits."""
    solution: SolutionName | None = None
    """Nutrient solution: kliman_2022, or a TOML file with the keys of a scene's table [solution]. The concentration \
of an element can be scaled, for example kliman_2022,K=0.5 for half the potassium."""

    def apply_to(self, scene: Scene) -> Scene:
        """Return a copy of the scene with the options that were given.

        Raises
        ------
        UserError
            If a text contains a character that is not allowed in tables.
        """
        given = {name: value for name, value in vars(self).items() if value is not None}
        dissolved = given.pop("solution", scene.solution)
        subject = replace(scene.subject, **given)
        check_subject(subject, Place("the command line").at("subject"))
        return replace(scene, subject=subject, solution=dissolved)


@Parameter(name="*", group="Scene")
@dataclass(frozen=True, kw_only=True)
class Placing:
    """Options that position a specimen from a file in the canister; None leaves the scene's value unchanged."""

    place: Literal["given", "auto"] | None = None
    """Position of the specimen: given (coordinates of the file) or auto (upright and centred below the net pot, which \
holds the plant)."""
    vertical_axis: Literal["x", "y", "z"] | None = None
    """Axis of an RSML file along which the depth is measured; default: z, or y in drawings with two coordinates."""
    flip: Flag | None = None
    """Turn the specimen upside down before it is scaled, for files in which z points down."""
    scale: Annotated[float, option(lambda text: read_number(text, SCALE_LIMITS, ""), "S")] | None = None
    """Scale factor of coordinates and diameters, applied after --flip."""
    shift_mm: Annotated[tuple[float, float, float], option(read_shift_mm, "X,Y,Z")] | None = None
    """Translation in mm, applied last. If the first number is negative, write an equals sign: --shift-mm=-5,0,-20."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Progress:
    """Options for progress output: one bar on a terminal, one line per stage in other outputs."""

    quiet: Flag = False
    """Do not show the progress."""
    verbose: Flag = False
    """Print the name and duration of each stage, in addition to the progress bar on a terminal."""

    def bar(self, **shares: float) -> OneBar:
        """Return a progress bar.

        ``shares`` contains the name of each stage and its relative duration.
        """
        return OneBar(shares, quiet=self.quiet, verbose=self.verbose)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Computing(Progress):
    """Options for the device of the computation, and for its progress output."""

    device: Device = "auto"
    """Device for the computation: cpu, cuda (an NVIDIA GPU) or auto (the GPU if available)."""


@Parameter(name="*", group="Web page")
@dataclass(frozen=True, kw_only=True)
class Page:
    """Options for the address of a local web page."""

    host: Annotated[str, with_metavar("ADDRESS")] = "127.0.0.1"
    """Network address of the page; 127.0.0.1 allows connections from this computer only."""
    port: Port = 8080
    """Port of the page; if the port is in use, the next free port is used."""
    no_browser: Flag = False
    """Print the address of the page, and do not open a browser."""


@Parameter(name="*", group="Scene")
@dataclass(frozen=True, kw_only=True)
class SceneChanges:
    """Options that change a scene."""

    profile: Profile | None = None
    """Simulated imperfections of rig and pictures: clean (none), bench (well-built rig), camera (bench with an \
ordinary camera), harsh (badly adjusted rig), real (first scan of a living plant), or a TOML file; default: as in \
the scene."""
    specimen: Annotated[Path | None, with_metavar("FILE")] = None
    """File with a specimen that replaces the scene's roots: a closed mesh (PLY, STL, OBJ) in mm, or traced roots \
(RSML). The origin of the coordinates is on the canister's axis in the plane of its rim, with z up, so that roots have \
negative z; for files with other coordinates see --place."""
    specimen_unit: Annotated[str | None, with_metavar("UNIT")] = None
    """Unit of the coordinates in an RSML file whose own unit is missing or wrong: mm, cm, m, um, inch, or a multiple \
such as '0.1 mm'."""
    specimen_diameter_mm: DiameterMm | None = None
    """Diameter in mm of roots for which the RSML file has no diameter."""
    placing: Placing = Placing()
    """Position of the specimen."""
    views: Views | None = None
    """Number of pictures per ring (one turn of the table at one camera height and tilt); default: as in the scene."""
    image_wh: ImageWh | None = None
    """Picture size in pixels, such as 800x600; default: as in the scene."""
