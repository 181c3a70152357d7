"""What commands share: the types of their arguments, each with the limits that it keeps and the sentence that says so.

A type is ``Annotated[type, option(reader, "METAVAR")]``; the reader takes the typed text and raises ValueError with the
limits.
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
"""Folders within folders of a path: Python makes and removes them by recursion, of which it allows 1000 calls."""
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
    """Return what makes an argument of one typed word, read by a function that raises ValueError with a sentence."""

    def convert(_: Any, tokens: Any) -> object:
        return read(tokens[0].value)

    return Parameter(name=name, converter=convert, n_tokens=1, metavar=metavar)


def options(read: Callable[[str], object], metavar: str) -> Parameter:
    """Return the same for an argument that may be given several times; it becomes a tuple."""

    def convert(_: Any, tokens: Any) -> object:
        return tuple(read(token.value) for token in tokens)

    return Parameter(converter=convert, n_tokens=1, metavar=metavar, show_default=False)


def named(metavar: str, *, name: str | tuple[str, ...] | None = None) -> Parameter:
    """Return what makes an argument shown by a word of its own; paths are checked by `check_paths`."""
    return Parameter(name=name, metavar=metavar, validator=check_paths)


def output(metavar: str) -> Parameter:
    """Return what makes the option ``-o``."""
    return Parameter(name=("--output", "-o"), metavar=metavar, validator=check_paths)


def check_paths(_: Any, given: Any) -> None:
    """Refuse paths that no system call takes, or that are nested too deep.

    Raises
    ------
    ValueError
        With a sentence.
    """
    for path in given if isinstance(given, list | tuple) else [given]:
        if isinstance(path, Path):
            if len(path.parts) > MOST_PARTS:
                raise ValueError(f"{str(path)[:100]}... is {len(path.parts)} folders deep, more than {MOST_PARTS}; choose another place")
            try:
                path.stat()
            except OSError as error:
                if error.errno in (errno.ELOOP, errno.ENAMETOOLONG):
                    raise ValueError(f"{str(path)[:100]} is no path that can be used ({error.strerror}); choose another place") from None


def whole(text: str, low: int, high: int, what: str) -> int:
    """Read a whole number within limits; ``what`` says them.

    Parameters
    ----------
    text : str
        As typed.
    low, high : int
        Least and greatest.
    what : str
        Says the limits, in complaints.

    Returns
    -------
    int
        The number.
    """
    try:
        value = int(text)
    except ValueError:
        raise ValueError(f"{text!r} is not a whole number") from None
    if not low <= value <= high:
        raise ValueError(f"{text} is out of range, {what}")
    return value


def between(text: str, limits: tuple[float, float], unit: str, units: str | None = None) -> float:
    """Read a number within limits; ``unit`` and its plural name it in complaints.

    Parameters
    ----------
    text : str
        As typed.
    limits : tuple of float
        Least and greatest.
    unit, units : str, (str or None)
        One and many, in complaints.

    Returns
    -------
    float
        The number.
    """
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{text!r} is not a number{f' of {units or unit}' if unit else ''}") from None
    low, high = limits
    if not low <= value <= high:
        raise ValueError(f"{text} is out of range, give {low:g} to {high:g} {unit}".rstrip())
    return value


def millimetres(text: str, limits: tuple[float, float]) -> float:
    """Read a length within limits."""
    return between(text, limits, "mm", "millimetres")


def list_of(one: Callable[[str], T], *, once: bool = True) -> Callable[[str], tuple[T, ...]]:
    """Return a reader of a list with commas; with ``once`` what is named again is left out."""

    def read(text: str) -> tuple[T, ...]:
        values = [one(part) for part in text.split(",")]
        return tuple(dict.fromkeys(values)) if once else tuple(values)

    return read


def read_views(text: str) -> int:
    """Read a number of views."""
    return whole(text, 1, MAX_VIEWS, f"give 1 to {MAX_VIEWS}")


def read_mass_g(text: str) -> float:
    """Read a mass."""
    return between(text, MASS_LIMITS_G, "g", "grams")


def read_image_wh(text: str) -> tuple[int, int]:
    """Read a picture size such as 800x600."""
    width, cross, height = text.lower().partition("x")
    if not (cross and width.isdecimal() and height.isdecimal()):
        raise ValueError(f"{text!r} is not a picture size, write it as 800x600")
    low, high = PIXEL_LIMITS
    if not all(low <= side <= high for side in (int(width), int(height))):
        raise ValueError(f"{text} is out of range, give {low} to {high} pixels a side")
    return int(width), int(height)


Device: TypeAlias = Literal["auto", "cpu", "cuda"]
Flag: TypeAlias = Annotated[bool, Parameter(show_default=False)]
SceneName: TypeAlias = Annotated[str, named("SCENE")]
Profile: TypeAlias = Annotated[str, named("clean|bench|camera|harsh|real")]
ResultFolder: TypeAlias = Annotated[Path, named("RESULT")]
DatasetFolder: TypeAlias = Annotated[Path, named("DATASET")]
OutputDataset: TypeAlias = Annotated[Path, output("DATASET")]
OutputResult: TypeAlias = Annotated[Path, output("RESULT")]
OutputFile: TypeAlias = Annotated[Path, output("FILE")]
OutputFolder: TypeAlias = Annotated[Path, output("FOLDER")]
Views: TypeAlias = Annotated[int, option(read_views, "N")]
ImageWh: TypeAlias = Annotated[tuple[int, int], option(read_image_wh, "WxH")]
Samples: TypeAlias = Annotated[int, option(lambda text: whole(text, 1, MAX_SAMPLES, f"give 1 to {MAX_SAMPLES}"), "N")]
Seed: TypeAlias = Annotated[int, option(lambda text: whole(text, 0, 2**63 - 1, "give 0 or a positive whole number"), "S")]
Port: TypeAlias = Annotated[int, option(lambda text: whole(text, 1, 65535, "give 1 to 65535"), "N")]
VoxelMm: TypeAlias = Annotated[float, option(lambda text: millimetres(text, VOXEL_LIMITS_MM), "MM")]
DiameterMm: TypeAlias = Annotated[float, option(lambda text: millimetres(text, DIAMETER_LIMITS_MM), "D")]
VolumeMl: TypeAlias = Annotated[float, option(lambda text: between(text, VOLUME_LIMITS_ML, "ml", "millilitres"), "ML")]
MassG: TypeAlias = Annotated[float, option(read_mass_g, "G")]


def read_day(text: str) -> float:
    """Read a plant's age."""
    return between(text, DAY_LIMITS, "days")


def read_date(text: str) -> str:
    """Read a date."""
    try:
        return date.fromisoformat(text).isoformat()
    except ValueError:
        raise ValueError(f"{text!r} is not a date, write it as 2022-10-06") from None


def read_shift_mm(text: str) -> tuple[float, float, float]:
    """Read a shift such as 0,0,-20."""
    parts = text.split(",")
    if len(parts) != 3:
        raise ValueError(f"{text!r} is not a shift, write it as X,Y,Z in mm, such as 0,0,-20")
    x, y, z = (millimetres(part, SHIFT_LIMITS_MM) for part in parts)
    return x, y, z


SolutionName = Annotated[Solution, option(read_solution, "NAME|FILE[,K=0.5,...]")]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class SubjectOptions:
    """Whose roots are in the canister; what is given goes before the scene's [subject]."""

    plant: Annotated[str | None, named("NAME")] = None
    """Name of the plant, the same on every day."""
    species: Annotated[str | None, named("NAME")] = None
    """Its species, such as 'Raphanus sativus'."""
    treatment: Annotated[str | None, named("NAME")] = None
    """Treatment, for example 'low N'."""
    day: Annotated[float | None, option(read_day, "DAYS")] = None
    """Days since sowing."""
    date: Annotated[str | None, option(read_date, "DATE")] = None
    """Date of the scan, as 2022-10-06."""
    replicate: Annotated[int | None, option(lambda text: whole(text, 0, 1000000, "give 0 or a positive whole number"), "N")] = None
    """Which of the plants that were treated alike."""
    notes: Annotated[str | None, named("TEXT")] = None
    """Anything else that tables shall tell."""
    solution: SolutionName | None = None
    """Nutrient solution: kliman_2022 or a TOML file with the keys of [solution], and factors by element."""

    def told(self, scene: Scene) -> Scene:
        """Return a scene whose subject is changed by what was given.

        Raises
        ------
        UserError
            For text that cannot stand in a table.
        """
        given = {name: value for name, value in vars(self).items() if value is not None}
        dissolved = given.pop("solution", scene.solution)
        subject = replace(scene.subject, **given)
        check_subject(subject, Place("the command line").at("subject"))
        return replace(scene, subject=subject, solution=dissolved)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Placing:
    """How a specimen's file is put into the water; None leaves what the scene says."""

    place: Literal["given", "auto"] | None = None
    """Where the specimen's file goes: where its coordinates say (given), or upright below the net pot's grid in the \
middle (auto)."""
    flip: Flag | None = None
    """Turn it upside down first: for files whose z points down."""
    scale: Annotated[float, option(lambda text: between(text, SCALE_LIMITS, ""), "S")] | None = None
    """Then enlarge it so many times, diameters too."""
    shift_mm: Annotated[tuple[float, float, float], option(read_shift_mm, "X,Y,Z")] | None = None
    """Then move it, from where --place puts it; write --shift-mm=-5,0,-20 where the first number is below 0."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Progress:
    """How much is told of the work while it lasts: one bar on a terminal, a line a stage elsewhere."""

    quiet: Flag = False
    """Show no progress."""
    verbose: Flag = False
    """Write a line for each stage, with its time."""

    def bar(self, **shares: float) -> OneBar:
        """Return a bar for stages that take about these shares of the time."""
        return OneBar(shares, quiet=self.quiet, verbose=self.verbose)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Page:
    """Where a page is served."""

    host: Annotated[str, named("ADDRESS")] = "127.0.0.1"
    """Address to serve the page at; 127.0.0.1 is this machine alone."""
    port: Port = 8080
    """Port to serve the page at, or the next free one."""
    no_browser: Flag = False
    """Print the page's address, and open no browser."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class SceneChanges:
    """What the command line changes in a scene."""

    profile: Profile | None = None
    """What the rig gets wrong: clean (nothing), bench (a good rig), camera (and an ordinary camera), harsh (a bad \
day), real (a first scan of a plant), or a file; default: the scene's own."""
    specimen: Annotated[Path | None, named("FILE")] = None
    """Put this in place of the scene's root: a closed mesh (PLY, STL, OBJ) in millimetres, or traced roots (RSML), in \
the canister frame: origin on the axis in the plane of the rim, z up, roots below 0; for files in a frame of their own \
see --place."""
    specimen_unit: Annotated[str | None, named("UNIT")] = None
    """Unit of an RSML file's coordinates, where the file does not say or is wrong: mm, cm, m, um, inch, or a step such\
 as '0.1 mm'."""
    specimen_diameter_mm: DiameterMm | None = None
    """Diameter of the roots for which an RSML file gives none."""
    placing: Placing = Placing()
    """Where the specimen goes."""
    views: Views | None = None
    """Pictures in every ring; default: the scene's."""
    image_wh: ImageWh | None = None
    """Picture size in pixels, such as 800x600; default: the scene's."""
