"""Scene and profile files (TOML), the library of named scenes, and conversion of scenes to and from plain values.

A scene file contains the sections of `scenes.model.Scene`: ``[subject] [solution] [canister] [water] [net_pot] [strip]
[camera] [lights] [turntable] [[plan.rings]] [specimen] [disturbances]``, and the keys ``name`` and ``description``.
Missing keys take their default values.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from rhizotwin.scenes import key_descriptions
from rhizotwin.scenes.atomic import write_text
from rhizotwin.scenes.checks import check_scene
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.errors import UserError, parser_message
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.reading import read_text
from rhizotwin.scenes.schema import Place, from_plain, suggestion, to_plain
from rhizotwin.scenes.specimens import MeshSpecimen, RsmlSpecimen, Specimen

MOST_CANDIDATES = 6
"""Maximum number of scenes that are listed for an ambiguous name."""
_LIBRARY = Path(__file__).parent / "library"
_PROFILES = Path(__file__).parent / "profiles"


def load_scene(name_or_path: str | Path) -> Scene:
    """Load a scene file, or a scene of the library by its name.

    Parameters
    ----------
    name_or_path : path
        Name listed by `library`, or path of a TOML file.

    Returns
    -------
    Scene
        Validated scene. The path of a specimen is resolved relative to the folder of the scene file. The default name
        is that of the file.

    Raises
    ------
    UserError
        If the name is unknown, or the file is unreadable or invalid; the message states file, line, key, value and
        limit.
    """
    path = _find_scene(name_or_path)
    table, text = read_toml(path)
    scene = from_plain(Scene, {"name": path.stem} | table, Place(str(path), text))
    plants = tuple(replace(plant, specimen=_resolve(plant.specimen, path.parent)) for plant in scene.plants)
    scene = replace(scene, specimen=_resolve(scene.specimen, path.parent), plants=plants)
    check_scene(scene, where=str(path), text=text)
    return scene


def save_scene(scene: Scene, path: str | Path, *, new: bool = False) -> None:
    """Write a scene as a TOML file with a comment above each key. `load_scene` returns an equal scene.

    Paths of specimens are written as absolute paths.

    Parameters
    ----------
    scene : Scene
        Scene to write.
    path : str or Path
        Path of the TOML file.
    new : bool
        Whether to raise an error if the file exists.
    """
    here = Path()
    plants = tuple(replace(plant, specimen=_resolve(plant.specimen, here)) for plant in scene.plants)
    scene = replace(scene, specimen=_resolve(scene.specimen, here), plants=plants)
    plain = scene_to_dict(scene)
    if not plants:
        del plain["plants"]  # if the file had an empty list, users could not add a [[plants]] section
    write_text(path, key_descriptions.to_commented_toml(_without_none(plain)), new=new)


def _resolve(specimen: Specimen | None, folder: Path) -> Specimen | None:
    """Make the path of the specimen's file absolute. Specimens without a file are returned unchanged."""
    if not isinstance(specimen, MeshSpecimen | RsmlSpecimen):
        return specimen
    return replace(specimen, file=str((folder / specimen.file).resolve()))


def scene_to_dict(scene: Scene) -> dict[str, Any]:
    """Convert a scene to plain dicts, lists and scalars for JSON. `scene_from_dict` returns an equal scene."""
    plain: dict[str, Any] = to_plain(scene)
    return plain


def scene_from_dict(mapping: Mapping[str, Any], *, where: str) -> Scene:
    """Create a scene from plain values, and check it.

    Parameters
    ----------
    mapping : mapping of object
        Mapping as returned by `scene_to_dict`. Missing keys take their default values.
    where : str
        Name of the file or other origin, used in messages.

    Raises
    ------
    UserError
        If there is an unknown key, a wrong type, a value beyond its limits, or an inconsistency between values.
    """
    scene = from_plain(Scene, mapping, Place(where))
    check_scene(scene, where=where)
    return scene


def library() -> list[tuple[str, str]]:
    """Return the name and description of every scene in the library, sorted by name."""
    return _list_files(_LIBRARY)


def profiles() -> list[tuple[str, str]]:
    """Return the name and description of every built-in disturbance profile, from the mildest to the most severe."""
    order = {"clean": 0, "bench": 1, "camera": 2, "harsh": 3, "real": 4}
    return sorted(_list_files(_PROFILES), key=lambda row: (order.get(row[0], len(order)), row[0]))


def load_profile(name: str) -> Disturbances:
    """Load a disturbance profile by its name, such as ``clean`` or ``bench``, or from a TOML file.

    The file must have a ``[disturbances]`` section.

    Raises
    ------
    UserError
        If the name is unknown or the file is invalid.
    """
    path = _PROFILES / f"{name}.toml"
    if _looks_like_path(name):
        path = Path(name)
    elif name not in (known := [row[0] for row in profiles()]):
        raise UserError(f'there is no disturbance profile "{name}"{suggestion(name, known)}; available profiles are {", ".join(known)}')
    table, text = read_toml(path)
    place = Place(str(path), text)
    allowed = ["name", "description", "disturbances"]
    for key in table:
        if key not in allowed:
            raise place.at(key).error(f"unknown key{suggestion(key, allowed)}; known keys are {', '.join(allowed)}")
    return from_plain(Disturbances, table.get("disturbances", {}), place.at("disturbances"))


def _find_scene(name_or_path: str | Path) -> Path:
    """Return the path of a scene that is given by its name in the library or by its path."""
    name = str(name_or_path)
    if isinstance(name_or_path, Path) or _looks_like_path(name):
        return Path(name_or_path)
    known = sorted(path.stem for path in _LIBRARY.glob("*.toml"))
    if name in known:
        return _LIBRARY / f"{name}.toml"
    if Path(name).is_file():
        return Path(name)
    several = [scene for scene in known if name and scene.startswith(name)]
    if len(several) > 1:
        more = "" if len(several) <= MOST_CANDIDATES else f" or one of {len(several) - MOST_CANDIDATES} others (`rhizotwin scenes`)"
        raise UserError(f'the scene "{name}" is ambiguous; choose {", ".join(several[:MOST_CANDIDATES])}{more}')
    near = suggestion(name, known)
    raise UserError(
        f'there is no scene "{name}"{near}; list the available scenes with `rhizotwin scenes`, or specify a file that ends in .toml'
    )


def _looks_like_path(name: str) -> bool:
    return name.endswith(".toml") or "/" in name or "\\" in name


def read_toml(path: Path) -> tuple[dict[str, Any], str]:
    """Read a TOML file, and return its table and its text."""
    if path.is_dir():
        raise UserError(f"{path}: the path is a folder, but a TOML file is required")
    text = read_text(path)
    try:
        return tomllib.loads(text), text
    except (ValueError, RecursionError) as error:  # TOMLDecodeError, and integers with thousands of digits
        raise UserError(f"{path}: the file is not valid TOML ({parser_message(error)})") from error


def _list_files(folder: Path) -> list[tuple[str, str]]:
    return [(path.stem, str(read_toml(path)[0].get("description", ""))) for path in sorted(folder.glob("*.toml"))]


def _without_none(value: Any) -> Any:
    """Remove all entries that are None, because TOML has no such value.

    They can be omitted because None is then the default.
    """
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    if isinstance(value, list):
        return [_without_none(item) for item in value]
    return value
