"""Checks of the calls of the Python interface, whose errors are single sentences in the words of Python.

The types are those of the signatures, so that each parameter is declared once.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import is_dataclass
from functools import wraps
from typing import Any, Literal, get_args

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import scene_from_dict, scene_to_dict
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.name_suggestion import most_similar
from rhizotwin.scenes.schema import Place, from_plain, to_plain
from rhizotwin.steps.arguments import (
    DIAMETER_LIMITS_MM,
    MASS_LIMITS_G,
    MAX_SAMPLES,
    MAX_VIEWS,
    PIXEL_LIMITS,
    VOLUME_LIMITS_ML,
    VOXEL_LIMITS_MM,
)
from rhizotwin.steps.calls import require

LIMITS: Mapping[str, tuple[float, float]] = {
    "image_wh": PIXEL_LIMITS,
    "mass_g": MASS_LIMITS_G,
    "port": (1, 65535),
    "samples": (1, MAX_SAMPLES),
    "seed": (0, 2**63 - 1),
    "specimen_diameter_mm": DIAMETER_LIMITS_MM,
    "table_angle_deg": (-360.0, 360.0),
    "views": (1, MAX_VIEWS),
    "volume_ml": VOLUME_LIMITS_ML,
    "voxel_mm": VOXEL_LIMITS_MM,
    "workers": (1, 10000),
}
"""Smallest and largest value of each number, by the name of the parameter, which states the unit."""
KINDS = {
    "str": "text",
    "Path": "path",
    "int": "whole number",
    "float": "number",
    "bool": "True or False",
    "None": "None",
    "Progress": "monitor",
    "Callable": "callable",
}
"""Name in messages of each type of a signature. Other types, such as ``Result``, have the name of the class."""
_EXAMPLE_WH = "(800, 600)"


def in_python(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function whose arguments are checked before it is called, and whose errors name Python's parameters.

    Parameters
    ----------
    function : callable
        Function of the Python interface, whose annotations are texts or types.

    Returns
    -------
    callable
        Function with the same signature. It raises `UserError` if an argument is unknown, missing, of another type or
        beyond its limits.
    """
    known = _parameters(function)
    named = inspect.signature(function).parameters.values()
    positional = [parameter.name for parameter in named if parameter.kind is parameter.POSITIONAL_OR_KEYWORD]
    needed = [
        parameter.name
        for parameter in named
        if parameter.default is parameter.empty and parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
    ]

    @wraps(function)
    def checked(*arguments: Any, **options: Any) -> Any:
        given = _bind(function.__name__, arguments, options, positional, list(known), needed)
        for name, value in given.items():
            _check(name, value, known[name], is_optional=name not in needed)
        try:
            return function(**given)
        except UserError as error:
            error.args = (_in_words_of_python(str(error)), *error.args[1:])
            raise

    return checked


def checked_class(kind: type) -> type:
    """Return a class that stands for a dataclass, and checks the values before it creates an instance.

    The instance is one of the dataclass itself.

    Parameters
    ----------
    kind : type
        Dataclass whose fields have types and limits.
    """
    known = list(inspect.signature(kind).parameters)

    class Checking(type):
        def __call__(cls, *arguments: Any, **options: Any) -> Any:
            given = _bind(kind.__name__, arguments, options, [], known, [])
            return check_values(kind(**given))

        def __instancecheck__(cls, value: Any) -> bool:
            return isinstance(value, kind)

    return Checking(kind.__name__, (kind,), {"__doc__": kind.__doc__, "__module__": kind.__module__})


def check_values(value: Any) -> Any:
    """Return a scene, or another dataclass, with checked values. Other values are returned unchanged.

    Raises
    ------
    UserError
        If a value has a wrong type, is beyond its limits, or contradicts another one.
    """
    if isinstance(value, Scene):
        return scene_from_dict(scene_to_dict(value), where="Scene")
    if is_dataclass(value) and not isinstance(value, type):
        return from_plain(type(value), to_plain(value), Place(type(value).__name__))
    return value


def _bind(
    name: str, arguments: Sequence[Any], options: Mapping[str, Any], positional: list[str], known: Sequence[str], needed: list[str]
) -> dict[str, Any]:
    """Return the arguments of a call by name."""
    if len(arguments) > len(positional):
        first = f"only {' and '.join(positional)} can be given without a name" if positional else "every value needs its name"
        raise UserError(f"{name} was given {len(arguments)} values without a name, but {first}; its parameters are {', '.join(known)}")
    given = dict(zip(positional, arguments, strict=False))
    for option in options:
        if option in given:
            raise UserError(f"{name} was given {option} twice; give it once")
        if option not in known:
            near = most_similar(option, known)
            hint = f" (did you mean {near}?)" if near else ""
            raise UserError(f"{name} has no parameter {option}{hint}; its parameters are {', '.join(known)}")
    given |= options
    missing = [parameter for parameter in needed if parameter not in given]
    if missing:
        raise UserError(f"{name} needs {' and '.join(missing)}; its parameters are {', '.join(known)}")
    return given


def _parameters(function: Callable[..., Any]) -> dict[str, str]:
    """Return the annotation of each parameter. The options of ``**options: Unpack[Options]`` are parameters, too."""
    annotations: dict[str, str] = {}
    for parameter in inspect.signature(function).parameters.values():
        text = parameter.annotation if isinstance(parameter.annotation, str) else inspect.formatannotation(parameter.annotation)
        if parameter.kind is parameter.VAR_KEYWORD:
            options = function.__globals__[text.removeprefix("Unpack[").removesuffix("]")]
            more = {name: getattr(hint, "__forward_arg__", None) or str(hint) for name, hint in options.__annotations__.items()}
        else:
            more = {parameter.name: text}
        annotations |= {name: _expanded(hint, function) for name, hint in more.items()}
    return annotations


def _expanded(annotation: str, function: Callable[..., Any]) -> str:
    """Return an annotation, with the choices of aliases such as ``Device``, and without the names of modules."""
    parts = []
    for part in re.split(r" \| (?![^\[]*\])", annotation):
        alias = function.__globals__.get(part)
        choices = get_args(alias) if getattr(alias, "__origin__", None) is Literal else ()
        plain = re.sub(r"\b(?:pathlib|typing|collections\.abc)\.", "", part)
        parts.append(f"Literal{list(choices)}" if choices else plain)
    return " | ".join(parts)


def _check(name: str, value: Any, annotation: str, *, is_optional: bool) -> None:
    """Check the type and the limits of one argument."""
    parts = re.split(r" \| (?![^\[]*\])", annotation)
    if value is None and ("None" in parts or (is_optional and "Progress" in parts)):
        return
    if "Any" in parts or any(part.startswith(("Sequence", "Paths", "Mapping")) for part in parts):
        return  # checked one by one by the function
    choices = [choice for part in parts if part.startswith("Literal") for choice in re.findall(r"[\"']([^\"']+)[\"']", part)]
    if choices:
        if value not in choices:
            shown = [f'"{choice}"' for choice in choices]
            near = most_similar(str(value), choices)
            hint = f' (did you mean "{near}"?)' if near else ""
            raise UserError(f"{name} must be {' or '.join(filter(None, [', '.join(shown[:-1]), shown[-1]]))}, not {value!r}{hint}")
        return
    if any(part.startswith("tuple[int, int]") for part in parts):
        _check_pair(name, value)
        return
    require(name, value, *(KINDS.get(part, part) for part in parts if part != "str" or "Path" not in parts))
    _check_limits(name, value)
    if name in ("settings", "scene", "placing"):
        check_values(value)


def _check_limits(name: str, value: Any) -> None:
    if name in LIMITS and not isinstance(value, str):
        low, high = LIMITS[name]
        if not low <= float(value) <= high:
            has_unit = name.rpartition("_")[2] in ("deg", "g", "mm", "ml")
            cure = "check the unit" if has_unit else "choose another number"
            raise UserError(f"{name} must be {low:g} to {high:g}, not {value!r}; {cure}")


def _check_pair(name: str, value: Any) -> None:
    """Check a picture size."""
    low, high = LIMITS[name]
    is_pair = isinstance(value, Sequence) and not isinstance(value, str) and len(value) == 2
    if not is_pair or not all(hasattr(one, "__index__") and not isinstance(one, bool) and low <= one <= high for one in value):
        must = f"must be width and height, two whole numbers of {low:g} to {high:g}, such as {_EXAMPLE_WH}"
        raise UserError(f"{name} {must}, not {str(value)[:40]!r} ({type(value).__name__})")


def _in_words_of_python(text: str) -> str:
    """Return an error message in which options of commands are parameters: for ``--keep-stages``, ``keep_stages``."""
    text = re.sub(r"--(device|method|fidelity|profile) (\w+)", r'\1="\2"', text)
    return re.sub(r"(?<![\w-])--([a-z][a-z-]*[a-z])", lambda option: option[1].replace("-", "_"), text)


def public(value: Any) -> Any:
    """Return a name of the Python interface with its checks: a function, or a dataclass that users create."""
    if inspect.isfunction(value):
        return in_python(value)
    return checked_class(value) if value.__name__ in ("Placing", "Scene", "Settings") else value
