"""`rhizotwin scenes`."""

from pathlib import Path
from typing import Annotated

from rhizotwin.arguments import Flag, SceneName, SolutionName, named, output
from rhizotwin.scenes import files, key_descriptions
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.solution import UNIT, Solution


def scenes(
    name: SceneName | None = None,
    /,
    *,
    copy: Annotated[Path | None, output("FILE")] = None,
    specimen_stl: Annotated[Path | None, named("FILE")] = None,
    keys: Flag = False,
    solution: SolutionName | None = None,
) -> None:
    """List the scenes and profiles that come with the program, write a copy of one, or its specimen to be printed.

    The list has one line each. With a name and -o, write that scene's file instead, with every setting, to be changed
    and given to the other commands as a scene of your own. With a name and --specimen-stl, write its root as a closed
    surface.

    Parameters
    ----------
    name : str, optional
        A scene's name, or a scene file: write a copy of it.
    copy : Path, optional
        File to write the copy to (TOML), every key with its unit, range and why; must not exist yet.
    specimen_stl : Path, optional
        File to write the scene's specimen to (STL, mm, canister frame), for a 3D printer; must not exist yet.
    keys : bool
        Print the reference of all keys of scene files (Markdown).
    solution : Solution, optional
        Print the compounds of a nutrient solution in grams per litre, and its ions.

    Examples
    --------
    rhizotwin scenes
    rhizotwin scenes sphere_20mm -o my_scene.toml
    rhizotwin simulate my_scene.toml -o my_dataset
    rhizotwin scenes --keys
    rhizotwin scenes --solution kliman_2022,K=0.5
    rhizotwin scenes printed_8ml --specimen-stl my_part.stl
    """
    if keys or solution is not None:
        if name is not None or copy is not None or specimen_stl is not None:
            raise UserError("--keys and --solution print a page; leave the scene, -o and --specimen-stl out")
        print(key_descriptions.page() if solution is None else _solution_table(solution), end="")
        return
    if (name is None) != (copy is None and specimen_stl is None):
        raise UserError("give a scene with -o FILE or --specimen-stl FILE to write it or its specimen, or none of them to list the library")
    for path in (copy, specimen_stl):
        if path is not None and path.exists():
            raise UserError(f"{path} exists already; choose another name")
    if name is not None and specimen_stl is not None:
        from rhizotwin.printable import write_specimen_stl

        for line in write_specimen_stl(name, specimen_stl):
            print(line)
    if name is not None and copy is not None:
        files.save_scene(files.load_scene(name), copy, new=True)
        print(f"wrote {copy}; change it, then try: rhizotwin simulate {copy} -o my_dataset")
    if name is not None:
        return
    _print_library()


def _print_library() -> None:
    for title, rows in (("scenes", files.library()), ("profiles (simulate --profile)", files.profiles())):
        width = max((len(row[0]) for row in rows), default=0)
        print(f"{title}:")
        for row in rows:
            print(f"  {row[0]:<{width}}  {row[1]}")


def _solution_table(solution: Solution) -> str:
    lines = []
    for title, unit, rows in (("compound", "g/l", solution.compounds_g_per_l), ("ion", UNIT, solution.ions_mmol_per_l)):
        width = max(len(title), *(len(name) for name in rows))
        lines.append(f"{title:<{width}}  {unit:>10}")
        lines += [f"{name:<{width}}  {amount:>10.4g}" for name, amount in rows.items() if amount]
    return "\n".join(lines) + "\n"
