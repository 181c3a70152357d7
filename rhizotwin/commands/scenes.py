"""`rhizotwin scenes`."""

from pathlib import Path
from typing import Annotated

from rhizotwin.arguments import Flag, SceneName, output
from rhizotwin.scenes import explained, files
from rhizotwin.scenes.errors import UserError


def scenes(name: SceneName | None = None, /, *, copy: Annotated[Path | None, output("FILE")] = None, keys: Flag = False) -> None:
    """List the scenes and profiles that come with the program, or write a copy of one.

    The list has one line each. With a name and -o, write that scene's file instead, with every setting, to be changed and given to the
    other commands as a scene of your own.

    Parameters
    ----------
    name : str, optional
        A scene's name, or a scene file: write a copy of it.
    copy : Path, optional
        File to write the copy to (TOML), every key with its unit, range and why; must not exist yet.
    keys : bool
        Print the reference of all keys of scene files (Markdown).

    Examples
    --------
    rhizotwin scenes
    rhizotwin scenes sphere_20mm -o my_scene.toml
    rhizotwin simulate my_scene.toml -o my_dataset
    rhizotwin scenes --keys
    """
    if keys:
        if name is not None or copy is not None:
            raise UserError("--keys prints the keys of every scene file; leave the scene and -o out")
        print(explained.page(), end="")
        return
    if (name is None) != (copy is None):
        raise UserError("give both a scene and -o FILE to write a copy of a scene's file, or neither to list the library")
    if name is not None and copy is not None:
        if copy.exists():
            raise UserError(f"{copy} exists already; choose another name")
        files.save_scene(files.load_scene(name), copy, new=True)
        print(f"wrote {copy}; change it, then try: rhizotwin simulate {copy} -o my_dataset")
        return
    for title, rows in (("scenes", files.library()), ("profiles (simulate --profile)", files.profiles())):
        width = max((len(row[0]) for row in rows), default=0)
        print(f"{title}:")
        for row in rows:
            print(f"  {row[0]:<{width}}  {row[1]}")
