"""Command `rhizotwin scenes`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from rhizotwin.scenes import files, key_descriptions
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.solution import LITRES, UNIT, Solution
from rhizotwin.steps.arguments import Flag, SceneName, SolutionName, check_new_file, option, output, read_number, with_metavar


def scenes(
    name: SceneName | None = None,
    /,
    *,
    copy: Annotated[Path | None, output("FILE")] = None,
    specimen_stl: Annotated[Path | None, with_metavar("FILE")] = None,
    keys: Flag = False,
    solution: SolutionName | None = None,
    litres: Annotated[float | None, option(lambda text: read_number(text, LITRES, "l", "litres"), "L")] = None,
) -> None:
    """List the scenes and profiles of the library, or write a scene or its specimen to a file.

    A scene describes canister, water, specimen (roots or another object), camera and camera positions. A profile
    describes the imperfections of a simulated rig. Without arguments, the scenes and profiles of the library are
    listed. With a name and -o, the scene is written to a file with all its keys, as a starting point for your own
    scene. With a name and --specimen-stl, the specimen is written as a closed mesh.

    Parameters
    ----------
    name : str, optional
        Name of a library scene, or path of a scene file (TOML).
    copy : Path, optional
        Scene file to write (TOML), with unit, range and explanation of each key; must not exist yet.
    specimen_stl : Path, optional
        Mesh file of the specimen to write for 3D printing (STL, mm); must not exist yet.
    keys : bool
        Print a reference of all keys of scene files (Markdown).
    solution : Solution, optional
        Print the composition of a nutrient solution: kliman_2022, or a TOML file with the keys of a scene's table
        [solution], optionally with scaled elements, such as kliman_2022,K=0.5. With kliman_2022,K=0.5,only the other
        ions remain unchanged, apart from sodium and chloride, which balance the charge.
    litres : float, optional
        Also print the volumes of stock solutions and the masses of salts for this volume of the nutrient solution.

    Examples
    --------
    rhizotwin scenes
    rhizotwin scenes sphere_20mm -o my_scene.toml
    rhizotwin simulate my_scene.toml -o my_dataset
    rhizotwin scenes --keys
    rhizotwin scenes --solution kliman_2022 --litres 18
    rhizotwin scenes --solution kliman_2022,K=0.5,only
    rhizotwin scenes printed_8ml --specimen-stl my_part.stl
    """
    if litres is not None and solution is None:
        raise UserError("--litres is the volume of a nutrient solution; add --solution, such as --solution kliman_2022")
    if (keys or solution is not None) and (name is not None or copy is not None or specimen_stl is not None):
        raise UserError("--keys and --solution cannot be used with a scene, -o or --specimen-stl; remove these arguments")
    if keys or solution is not None:
        print(key_descriptions.page() if solution is None else _solution_table(solution, litres), end="")
    elif (name is None) != (copy is None and specimen_stl is None):
        raise UserError("a scene must be given together with -o FILE or --specimen-stl FILE; to list the library, give no arguments")
    elif name is None:
        _print_library()
    else:
        _write(name, copy, specimen_stl)


def _write(name: str, copy: Path | None, specimen_stl: Path | None) -> None:
    """Write a scene and its specimen to new files."""
    for path in (copy, specimen_stl):
        if path is not None:
            check_new_file(path)
    if specimen_stl is not None:
        from rhizotwin.exporter.printable import write_specimen_stl

        for line in write_specimen_stl(name, specimen_stl):
            print(line)
    if copy is not None:
        files.save_scene(files.load_scene(name), copy, new=True)
        print(f"wrote {copy}; edit the file, then run: rhizotwin simulate {copy} -o my_dataset")


def _print_library() -> None:
    for title, rows in (("scenes", files.library()), ("profiles (simulate --profile)", files.profiles())):
        width = max((len(row[0]) for row in rows), default=0)
        print(f"{title}:")
        for row in rows:
            print(f"  {row[0]:<{width}}  {row[1]}")


def _solution_table(solution: Solution, litres: float | None) -> str:
    dissolved = solution.compounds_g_per_l
    tables: list[tuple[str, str, str, Mapping[str, float], Mapping[str, str]]] = []
    tables.append(("compound", "g/l", "", dissolved, {}))
    tables.append(("ion", UNIT, "", solution.ions_mmol_per_l, {}))
    if litres is not None:
        made, volume = solution.portions(litres), f"for {litres:g} l"
        masses = {formula: f"{grams * litres:>12.4g}" for formula, grams in dissolved.items()}
        contents = {name: ", ".join(f"{formula} {grams:g}" for formula, grams in own.items()) for name, own in solution.stocks.items()}
        tables[0] = ("compound", "g/l", f"{'g ' + volume:>12}", dissolved, masses)
        tables.append((f"stock {volume}", "ml", "contents (g/l)", made.stocks_ml, contents))
        tables.append((f"salt {volume}", "g", "", made.salts_g, {}))
    lines = []
    for title, unit, remark, rows, remarks in tables:
        shown = [
            (title, f"{unit:>10}", remark),
            *((name, f"{amount:>10.4g}", remarks.get(name, "")) for name, amount in rows.items() if amount),
        ]
        width = max(len(row[0]) for row in shown)
        lines += [f"{name:<{width}}  {amount}  {more}".rstrip() for name, amount, more in shown]
    return "\n".join(lines) + "\n"
