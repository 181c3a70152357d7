"""Options of the benchmarks' commands, with the readers of their words."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias

from cyclopts import Parameter

from benchmarks import cases
from rhizotwin.scenes.errors import UserError
from rhizotwin.steps.arguments import Flag, option

CHANGES = ("rounded", "dithered", "shuffled", "lossy")
"""Changes of the pictures (`benchmarks.perturb`, which is imported by the commands that need it)."""


def read_words(text: str) -> tuple[str, ...]:
    """Convert comma-separated text to words."""
    words = tuple(word for word in text.split(",") if word)
    if not words:
        raise ValueError("is empty")
    return words


def read_choices(allowed: Sequence[str]) -> Callable[[str], tuple[str, ...]]:
    """Return a function that converts comma-separated text to words of a list."""

    def read(text: str) -> tuple[str, ...]:
        words = read_words(text)
        unknown = [word for word in words if word not in allowed]
        if unknown:
            raise ValueError(f"{unknown[0]!r} is none of {', '.join(allowed)}")
        return words

    return read


def read_change(text: str) -> str:
    """Check a change of the pictures, ``KIND:SEED``."""
    kind, _, seed = text.partition(":")
    if text != "none" and (kind not in CHANGES or not seed.isdecimal()):
        raise ValueError(f"{text!r} is none of {', '.join(f'{name}:SEED' for name in CHANGES)}, none")
    return text


def read_seeds(text: str) -> tuple[int, ...]:
    """Convert comma-separated text, or the name of a set, to seeds."""
    if text in cases.SEED_SETS:
        return cases.SEED_SETS[text]
    words = read_words(text)
    if not all(word.isdecimal() for word in words):
        raise ValueError(f"{text!r} is neither whole numbers nor one of {', '.join(cases.SEED_SETS)}")
    return tuple(dict.fromkeys(map(int, words)))


Words: TypeAlias = Annotated[tuple[str, ...] | None, option(read_words, "NAME,...")]


@Parameter(name="*", group="Selection")
@dataclass(frozen=True, kw_only=True)
class Subset:
    """Options that select cases of a set."""

    quick: Flag = False
    """The small set, run for every change (under five minutes)."""
    nightly: Flag = False
    """Dense root systems in one ring: radish_day20b, radish_day30c and wheat."""
    scenes: Annotated[tuple[str, ...] | None, option(read_words, "PATTERN,...")] = None
    """Only scenes whose name matches, such as 'radish_day0*'."""
    profiles: Annotated[tuple[str, ...] | None, option(read_choices(cases.PROFILES), "NAME,...")] = None
    """Only these of clean, bench, harsh."""
    methods: Annotated[tuple[str, ...] | None, option(read_choices(cases.METHODS), "NAME,...")] = None
    """Only these of coverage, thesis."""

    @property
    def given(self) -> dict[str, Any]:
        """Selecting options that were given, by name."""
        return {name: value for name, value in vars(self).items() if isinstance(value, tuple)}

    def chosen(self) -> list[cases.Case]:
        """Return the selected cases of the quick or the nightly set, or of the ladder.

        Raises
        ------
        UserError
            If the options cannot be combined, or select nothing.
        """
        if self.nightly and (self.quick or self.given):
            raise UserError("--nightly is a set of its own; omit --quick, and the selection.")
        if self.nightly:
            return cases.nightly()
        unknown = [name for name in ("rings", "seeds") if self.quick and name in self.given]
        if unknown:
            raise UserError(f"the quick set has no {unknown[0]}; omit --{unknown[0]} or --quick.")
        return cases.quick(**self.given) if self.quick else cases.ladder(**self.given)


@Parameter(name="*", group="Selection")
@dataclass(frozen=True, kw_only=True)
class Selection(Subset):
    """Options that select cases of the ladder."""

    rings: Annotated[tuple[int, ...] | None, option(lambda text: tuple(map(int, read_choices(("1", "2"))(text))), "N,...")] = None
    """Only plants in this number of rings, 1 or 2."""
    seeds: Annotated[tuple[int, ...] | None, option(read_seeds, "S,...")] = None
    """Seeds of disturbances and plants, or a named set: first (0, the default), second (101, 102). The second set is \
for final tests only: do not use it during development."""
    list_: Annotated[bool, Parameter(name="--list", show_default=False)] = False
    """List the cases and exit."""
