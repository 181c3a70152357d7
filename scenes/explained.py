"""What every key of a scene file means.

Its unit, its range and one line of why, from the descriptions in the model itself.
"""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
import types
from collections.abc import Iterator, Mapping
from dataclasses import Field, dataclass, fields, is_dataclass
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from rhizotwin.scenes import toml_text
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.schema import kind_of

UNITS = {
    "per_mm": "per mm",
    "mm_per_day": "mm a day",
    "mm_per_px": "mm a pixel",
    "mm": "mm",
    "deg": "degrees",
    "px": "pixels",
    "wh": "pixels",
    "ml": "ml",
    "days": "days",
    "e": "electrons",
}
"""Unit by the end of a key's name; the longest that fits counts."""
_ELSEWHERE = "plants.specimen"
"""Section whose keys are told where ``specimen`` is."""
WIDTH = 120
"""Characters of a line of comment."""


@dataclass(frozen=True)
class Key:
    """A key of a scene file."""

    path: str
    """With dots: ``canister.wall_mm``; of a specimen with its kind: ``specimen.sphere.diameter_mm``."""
    default: Any
    """None where there is none."""
    unit: str
    limits: str
    """Range or choices."""
    why: str

    def line(self) -> str:
        """Return what is said of it: what it means, its unit and range."""
        about = " ".join(part for part in (self.limits, self.unit) if part)
        return f"{self.why} [{about}]" if about else self.why


def keys(of: type = Scene, path: str = "") -> Iterator[Key]:
    """Return every key in the order of the file, those of sections after their section.

    A plant's specimen is one key: its own are those of ``specimen``.
    """
    said, hints = _said(of), get_type_hints(of)
    for one in fields(of):
        here = f"{path}.{one.name}" if path else one.name
        parts = [] if here == _ELSEWHERE else _parts(hints[one.name])
        if not parts or get_origin(hints[one.name]) is tuple:  # a list of sections may be empty, and is a key then
            yield Key(here, _default(one), _unit(one.name), _limits(one, hints[one.name]), said.get(one.name, ""))
        for part in parts:
            kind = kind_of(part)
            yield from keys(part, f"{here}.{kind}" if kind else here)


def sections(of: type = Scene, path: str = "") -> Iterator[tuple[str, str]]:
    """Return the path and the description of every section."""
    hints = get_type_hints(of)
    for one in fields(of):
        if f"{path}.{one.name}" == _ELSEWHERE:
            continue
        for part in _parts(hints[one.name]):
            kind = kind_of(part)
            here = ".".join(filter(None, (path, one.name, kind)))
            yield here, _plain(inspect.getdoc(part) or "")
            yield from sections(part, here)


def commented(plain: Mapping[str, Any]) -> str:
    """Return a scene (`scenes.files.scene_to_dict`, without None) as TOML with a comment above each key."""
    said = {key.path: key.line() for key in keys()}
    kinds = iter(one["kind"] for one in (plain.get("specimen"), *(plant.get("specimen") for plant in plain.get("plants", ()))) if one)
    lines: list[str] = []
    table, kind = "", ""
    for line in toml_text.dumps(plain).splitlines():
        if header := re.fullmatch(r"\[\[?([\w.]+)\]?\]", line):
            table = header[1].removeprefix("plants.") + "."  # a plant's specimen has the keys of any
            if table == "specimen.":
                kind = next(kinds)
            if table.startswith("specimen."):
                table = table.replace("specimen.", f"specimen.{kind}.", 1)
            if why := said.get(header[1]):  # a table whose keys are free
                lines += _comment(why)
        elif (key := re.match(r"(\w+) = ", line)) and (why := said.get(table + key[1])):
            lines += _comment(why)
        lines.append(line)
    head = ["# A scene of rhizotwin, every key with what it means [range, unit]. What is left out takes its default."]
    head.append("# Lengths are in the canister frame: origin on the canister's axis in the plane of its rim, z up; roots have z < 0.")
    return "\n".join([*head, "", *lines]) + "\n"


def _comment(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent="# ", subsequent_indent="# ", break_long_words=False)


def page() -> str:
    """Return the reference page of all keys (Markdown)."""
    found, about = list(keys()), dict(sections())
    lines = [
        "# Keys of scene files",
        "",
        "Made from the program's own descriptions by `rhizotwin scenes --keys`. What a file leaves out takes the default.",
    ]
    groups: dict[str, list[Key]] = {}
    for key in found:
        groups.setdefault(key.path.rpartition(".")[0], []).append(key)
    for group, members in groups.items():
        lines += ["", f"## {_title(group)}", ""]
        if group in about:
            lines += [about[group], ""]
        lines += ["| key | default | range | unit | meaning |", "|---|---|---|---|---|"]
        for key in members:
            default = "" if key.default is None else f"`{toml_text.value(key.default)}`"
            cells = [f"`{key.path.rpartition('.')[2]}`", default, key.limits, key.unit, key.why]
            lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def _title(group: str) -> str:
    if not group:
        return "At the top"
    first, _, rest = group.partition(".")
    if first == "specimen":
        kind, _, deeper = rest.partition(".")
        return f"[specimen], kind = {kind}" if not deeper else f"[[specimen.{deeper}]], kind = {kind}"
    return f"[[{group}]]" if group in ("plan.rings", "plants") else f"[{group}]"


def _said(of: type) -> dict[str, str]:
    """Return the text under each field of a class and of those that it comes from."""
    return {name: why for one in reversed(of.__mro__) if is_dataclass(one) for name, why in _said_in(one).items()}


def _said_in(of: type) -> dict[str, str]:
    """Return the text under each field that a class adds."""
    body = ast.parse(textwrap.dedent(inspect.getsource(of))).body[0]
    found: dict[str, str] = {}
    name = ""
    for node in body.body if isinstance(body, ast.ClassDef) else []:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            name = node.target.id
        elif name and isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            found[name] = _plain(node.value.value)
            name = ""
        else:
            name = ""
    return found


def _plain(text: str) -> str:
    """Return a description on one line, as a file's comment can hold it."""
    return " ".join(text.replace("``", "`").split())


def _choices(hint: Any) -> list[Any]:
    """Return the types that a value may have, None left out; of a list those of its items."""
    if get_origin(hint) in (Union, types.UnionType):
        return [choice for one in get_args(hint) if one is not types.NoneType for choice in _choices(one)]
    if get_origin(hint) is tuple and (arguments := get_args(hint)) and is_dataclass(arguments[0]):
        return [arguments[0]]
    return [hint]


def _parts(hint: Any) -> list[type]:
    """Return the dataclasses that a value may be of."""
    return [choice for choice in _choices(hint) if isinstance(choice, type) and is_dataclass(choice)]


def _default(one: Field[Any]) -> Any:
    plain = not isinstance(one.default, tuple) or not any(is_dataclass(item) for item in one.default)
    return one.default if plain and isinstance(one.default, (int, float, str, bool, tuple)) else None


def _unit(name: str) -> str:
    ends = [end for end in UNITS if name.endswith(f"_{end}")]
    return UNITS[max(ends, key=len)] if ends else ""


def _limits(one: Field[Any], hint: Any) -> str:
    for choice in _choices(hint):
        if get_origin(choice) is Literal:
            return " or ".join(toml_text.value(value) for value in get_args(choice))
    if "limits" not in one.metadata:
        return ""
    low, high = one.metadata["limits"]
    return f"{low:.12g} to {high:.12g}"
