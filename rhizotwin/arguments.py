"""What the modules of the command line share: the parser whose complaints are sentences, and readers of values with their limits."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn, TypeAlias, TypeVar

from rhizotwin.scenes.errors import UserError

T = TypeVar("T")

VOXEL_LIMITS_MM = (0.01, 10.0)
DIAMETER_LIMITS_MM = (0.01, 50.0)
MASS_LIMITS_G = (1e-6, 1e6)
PIXEL_LIMITS = (16, 20000)
MAX_VIEWS = 10000


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaints are one sentence."""

    def error(self, message: str) -> NoReturn:
        """Raise the complaint for `main` to print."""
        raise UserError(f"{message}; see {self.prog} --help")


Commands: TypeAlias = "argparse._SubParsersAction[Parser]"


def add_command(commands: Commands, name: str, short: str, *, description: str, epilog: str) -> Parser:
    """Add a command whose description and examples keep their line breaks."""
    return commands.add_parser(
        name, help=short, description=description, epilog=epilog, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def add_output(parser: Parser, name: str, text: str) -> None:
    """Add the required option ``-o``."""
    parser.add_argument("-o", "--output", type=Path, required=True, metavar=name, help=text)


def add_device(parser: Parser) -> None:
    """Add the option that chooses what computes."""
    parser.add_argument(
        "--device",
        choices=("auto", "cpu", "cuda"),
        default="auto",
        help="what computes: cpu, cuda (an NVIDIA card), auto (the card if there is one); default: %(default)s",
    )


def whole(text: str, low: int, high: int, what: str) -> int:
    """Read a whole number within limits; ``what`` says them."""
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text} is out of range, {what}")
    return value


def views(text: str) -> int:
    """Read a number of views."""
    return whole(text, 1, MAX_VIEWS, f"give 1 to {MAX_VIEWS}")


def samples(text: str) -> int:
    """Read a number of light paths."""
    return whole(text, 1, 1 << 16, f"give 1 to {1 << 16}")


def seeds(text: str) -> int:
    """Read a number of runs."""
    return whole(text, 1, 1000, "give 1 to 1000")


def height(text: str) -> tuple[float, float | None]:
    """Read a camera's height in mm, and its tilt in degrees where there is one behind a colon."""
    height_mm, colon, tilt_deg = text.partition(":")
    return between(height_mm, (-2000.0, 2000.0), "mm"), between(tilt_deg, (-89.0, 89.0), "degrees") if colon else None


def percent(text: str) -> float:
    """Read a percentage."""
    return between(text, (0.01, 1000.0), "%")


def list_of(one: Callable[[str], T], *, once: bool = True) -> Callable[[str], tuple[T, ...]]:
    """Return a reader of a list with commas; with ``once`` what is named again is left out."""

    def read(text: str) -> tuple[T, ...]:
        values = [one(part) for part in text.split(",")]
        return tuple(dict.fromkeys(values)) if once else tuple(values)

    return read


def seed(text: str) -> int:
    """Read a seed."""
    return whole(text, 0, 2**63 - 1, "give 0 or a positive whole number")


def image_wh(text: str) -> tuple[int, int]:
    """Read a picture size such as 800x600."""
    width, cross, height = text.lower().partition("x")
    if not (cross and width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is not a picture size, write it as 800x600")
    low, high = PIXEL_LIMITS
    if not all(low <= side <= high for side in (int(width), int(height))):
        raise argparse.ArgumentTypeError(f"{text} is out of range, give {low} to {high} pixels a side")
    return int(width), int(height)


def voxel_mm(text: str) -> float:
    """Read a voxel's edge."""
    return millimetres(text, VOXEL_LIMITS_MM)


def diameter_mm(text: str) -> float:
    """Read a diameter."""
    return millimetres(text, DIAMETER_LIMITS_MM)


def mass_g(text: str) -> float:
    """Read a mass."""
    return between(text, MASS_LIMITS_G, "g", "grams")


def millimetres(text: str, limits: tuple[float, float]) -> float:
    """Read a length within limits."""
    return between(text, limits, "mm", "millimetres")


def between(text: str, limits: tuple[float, float], unit: str, units: str | None = None) -> float:
    """Read a number within limits; ``unit`` and its plural name it in complaints."""
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of {units or unit}") from None
    low, high = limits
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text} is out of range, give {low:g} to {high:g} {unit}")
    return value
