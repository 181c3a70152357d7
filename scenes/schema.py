"""Strict conversion between frozen dataclasses and plain mappings (TOML, JSON).

Invalid values are reported in one sentence.

Supported types are bool, int, float, str, Literal, X | None, tuples of fixed or any length, dict[str, X], nested
dataclasses, Any, and unions of dataclasses named ``...Specimen``. Members of such a union are distinguished by the key
``kind`` (``SphereSpecimen`` has the kind "sphere").
"""

import math
import re
from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass, replace
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.name_suggestion import most_similar

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T", bound="DataclassInstance")


@dataclass(frozen=True)
class Place:
    """Location of a value in a file, used in error messages."""

    where: str
    """Name of the file, or another text that describes the origin of the values."""
    text: str = ""
    """Text of the file (TOML), used to determine line numbers."""
    path: tuple[str | int, ...] = ()

    def at(self, *steps: str | int) -> "Place":
        """Return the location of a nested value. The arguments are its keys or indices."""
        return replace(self, path=(*self.path, *steps))

    def error(self, must: str, *value: Any) -> UserError:
        """Return an error with the message ``WHERE, line N: [section] key = value: must ...``."""
        line = _find_line(self.text, self.path)
        start = self.where if line is None else f"{self.where}, line {line}"
        section, key = _split_path(self.path)
        shown = f" = {_format_value(value[0])}" if value else ""
        return UserError(f"{start}: {f'[{section}] ' if section else ''}{key}{shown}: {must}" if key else f"{start}: {must}")


def suggestion(name: str, known: list[str]) -> str:
    """Return `` (did you mean "x"?)`` for the most similar known name, or an empty text."""
    near = most_similar(name, known)
    return f' (did you mean "{near}"?)' if near else ""


def to_plain(value: Any) -> Any:
    """Convert dataclasses to dicts and tuples to lists, for JSON.

    For a field with several alternative dataclasses, the key ``kind`` states which of them is used.
    """
    if is_dataclass(value) and not isinstance(value, type):
        plain = {"kind": union_tag(type(value))} if union_tag(type(value)) else {}
        return plain | {f.name: to_plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, (tuple, list)):
        return [to_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {key: to_plain(item) for key, item in value.items()}
    return value


def from_plain(kind: type[T], mapping: Any, place: Place) -> T:
    """Create a dataclass from a mapping. Missing keys take their default values.

    Parameters
    ----------
    kind : type[T]
        Dataclass to create.
    mapping : Any
        Mapping as read from TOML or JSON.
    place : Place
        Place of the mapping in its file, used in messages.

    Returns
    -------
    T
        Validated instance.

    Raises
    ------
    UserError
        If a key is unknown or missing, or a value has a wrong type or is beyond the limits of its field.
    """
    if not isinstance(mapping, Mapping):
        raise place.error(f"must be a table (key = value), not {_type_name(mapping)}", mapping)
    hints = get_type_hints(kind)
    known = {f.name: f for f in fields(kind) if f.init}
    for key in mapping:
        if key not in known:
            raise place.at(str(key)).error(f"unknown key{suggestion(str(key), list(known))}; known keys are {', '.join(known)}")
    for name, f in known.items():
        if name not in mapping and f.default is MISSING and f.default_factory is MISSING:
            raise place.at(name).error("is missing, but has no default value")
    return kind(**{name: _value(hints[name], mapping[name], known[name], place.at(name)) for name in known if name in mapping})


def _value(hint: Any, value: Any, f: Field[Any], place: Place) -> Any:
    """Check a value against its type and the limits of its field, and return it converted."""
    origin, arguments = get_origin(hint), get_args(hint)
    if hint is Any:
        return value
    if origin in (Union, UnionType):
        if value is None and NoneType in arguments:
            return None
        choices = [a for a in arguments if a is not NoneType]
        return _value(choices[0], value, f, place) if len(choices) == 1 else _choose_kind(choices, value, place)
    if origin is Literal:
        if not any(value == a and type(value) is type(a) for a in arguments):
            near = suggestion(value, [a for a in arguments if isinstance(a, str)]) if isinstance(value, str) else ""
            raise place.error(f"must be one of {', '.join(_format_value(a) for a in arguments)}{near}", value)
        return value
    if origin is tuple:
        return _tuple(arguments, value, f, place)
    if origin is dict:
        if not isinstance(value, Mapping):
            raise place.error(f"must be a table (key = value), not {_type_name(value)}", value)
        return {str(key): _value(arguments[1], item, f, place.at(str(key))) for key, item in value.items()}
    if isinstance(hint, type) and is_dataclass(hint):
        return from_plain(hint, value, place)
    return _scalar(hint, value, f, place)


def _scalar(hint: Any, value: Any, f: Field[Any], place: Place) -> Any:
    """Check a bool, int, float or str, and return it. Integers are accepted as floats."""
    wanted = {bool: "true or false", int: "a whole number", float: "a number", str: "text in quotes"}[hint]
    if not isinstance(value, (int, float) if hint is float else hint) or (isinstance(value, bool) and hint is not bool):
        raise place.error(f"must be {wanted}, not {_type_name(value)}", value)
    checked = value
    if hint is float:
        try:
            checked = float(value)
        except OverflowError:
            checked = math.inf
        if not math.isfinite(checked):
            raise place.error("must be a finite number", value)
    if "limits" in f.metadata and hint in (int, float):
        low, high = f.metadata["limits"]
        if not low <= checked <= high:
            raise place.error(f"must be between {low:.12g} and {high:.12g}", value)
    return checked


def _tuple(arguments: tuple[Any, ...], value: Any, f: Field[Any], place: Place) -> tuple[Any, ...]:
    """Check a list against a tuple type, and return the tuple."""
    endless = len(arguments) == 2 and arguments[1] is Ellipsis
    if not isinstance(value, (list, tuple)):
        count = "" if endless else f" of {len(arguments)}"
        raise place.error(f"must be a list{count}, not {_type_name(value)}", value)
    if not endless and len(value) != len(arguments):
        raise place.error(f"must have {len(arguments)} elements, not {len(value)}", value)
    hints = [arguments[0]] * len(value) if endless else arguments
    return tuple(_value(hint, item, f, place.at(i)) for i, (hint, item) in enumerate(zip(hints, value, strict=True)))


def _choose_kind(choices: list[Any], value: Any, place: Place) -> Any:
    """Create one of several alternative dataclasses. The key ``kind`` states which of them."""
    kinds = {union_tag(choice): choice for choice in choices}
    if not isinstance(value, Mapping):
        raise place.error(f"must be a table (key = value), not {_type_name(value)}", value)
    named = ", ".join(f'"{k}"' for k in kinds)
    if "kind" not in value:
        raise place.at("kind").error(f"is missing; it must be one of {named}")
    kind = value["kind"]
    if not isinstance(kind, str) or kind not in kinds:
        raise place.at("kind").error(f"must be one of {named}{suggestion(str(kind), list(kinds))}", kind)
    return from_plain(kinds[kind], {key: item for key, item in value.items() if key != "kind"}, place)


def union_tag(choice: type) -> str:
    """Return the value of ``kind`` that selects a class, such as ``sphere`` for ``SphereSpecimen``.

    It is empty for classes that are not selected by ``kind``.
    """
    name = choice.__name__
    return name.removesuffix("Specimen").lower() if name.endswith("Specimen") else ""


def _type_name(value: Any) -> str:
    """Return the type of a plain value in words that a user understands."""
    names = {bool: "true or false", int: "a number", float: "a number", str: "text", list: "a list", NoneType: "nothing"}
    return names.get(type(value), "a table" if isinstance(value, Mapping) else type(value).__name__)


def _format_value(value: Any) -> str:
    """Format a value as in the file. The text is shortened to 60 characters."""
    text = {True: "true", False: "false"}[value] if isinstance(value, bool) else f'"{value}"' if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _split_path(path: tuple[str | int, ...]) -> tuple[str, str]:
    """Split a path into the section and the key.

    Examples are ("plan.rings 2", "views") and ("camera", "image_wh element 1"). Indices start at 1.
    """
    depth = max((i for i, step in enumerate(path) if isinstance(step, str)), default=-1)
    if depth < 0:
        return "", ""
    words = [f" {step + 1}" if isinstance(step, int) else f".{step}" for step in path[:depth]]
    key = str(path[depth]) + "".join(f" element {int(step) + 1}" for step in path[depth + 1 :])
    return "".join(words).lstrip("."), key


def _find_line(text: str, path: tuple[str | int, ...]) -> int | None:
    """Return the number of the line in a TOML text that contains the value with a given path.

    If the value is not found, the line of its innermost section that is found is returned, or None if there is none.
    """
    best: tuple[int, int | None] = (0, None)
    table: tuple[str | int, ...] = ()
    counts: dict[tuple[str | int, ...], int] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        if header := re.match(r"\s*(\[\[?)\s*([\w.\-\"' ]+?)\s*\]", line):
            table = ()
            for step in _keys(header[2]):
                table = (*table, step)
                if table in counts and table != _keys(header[2]):
                    table = (*table, counts[table])
            if header[1] == "[[":
                counts[table] = counts.get(table, -1) + 1
                table = (*table, counts[table])
            here = table
        elif key := re.match(r"\s*([\w.\-\"']+)\s*=", line):
            here = (*table, *_keys(key[1]))
        else:
            continue
        if len(here) > best[0] and path[: len(here)] == here:
            best = (len(here), number)
    return best[1]


def _keys(dotted: str) -> tuple[str, ...]:
    """Split a dotted TOML key into its parts, and remove quotes."""
    return tuple(part.strip().strip("\"'") for part in dotted.split("."))
