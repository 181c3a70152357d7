"""`rhizotwin parts`."""

from pathlib import Path
from typing import Annotated

from rhizotwin.arguments import OutputFolder, SceneName, millimetres, named, option, options

BED_LIMITS_MM = (50.0, 2000.0)


def read_bed_mm(text: str) -> tuple[float, float, float]:
    """Read a printer's room such as 220x220x250."""
    sides = text.lower().split("x")
    if len(sides) != 3:
        raise ValueError(f"{text!r} is no printer's room, write width, depth and height in mm as 220x220x250")
    wide, deep, high = (millimetres(side, BED_LIMITS_MM) for side in sides)
    return wide, deep, high


def parts(
    scene: SceneName,
    /,
    *,
    output: OutputFolder,
    rig: Annotated[Path | None, named("FILE")] = None,
    measures: Annotated[Path | None, named("FILE")] = None,
    bed_mm: Annotated[tuple[float, float, float], option(read_bed_mm, "WxDxH")] = (220.0, 220.0, 250.0),
    part: Annotated[tuple[str, ...], options(str, "NAME")] = (),
) -> None:
    """Write the parts of a scene's rig for a 3D printer.

    Net pot, canister ring, turntable with its gears, feet, camera bracket, arm mount, clips and holders of the panel,
    the calibration board's stand: all from the scene's own numbers, so that they fit its canister and strip.

      NAME.stl                       watertight, mm, as it lies on the printer's bed
      drawings/NAME.svg              three views with dimensions; also rig.svg, exploded.svg and wiring_*.svg
      parameters.csv, .json          every number, and where it comes from

    Nothing has been printed yet: print the net pot and the canister ring first, and try them.

    Parameters
    ----------
    scene : str
        A name from 'rhizotwin scenes', or a scene file (TOML).
    output : Path
        Folder to write; new or empty.
    rig : Path, optional
        Rig file, for the arm's place and last link and the floor's height; default: the thesis's arm.
    measures : Path, optional
        TOML file of what you bought and measured, such as fit_mm = 0.25; the defaults are in parameters.json.
    bed_mm : tuple
        What your printer can print.
    part : tuple of str
        Only this part, such as net_pot, without the drawings of the whole; once for each part; default: all.

    Examples
    --------
    rhizotwin parts printed_8ml -o my_parts
    rhizotwin parts my_scene.toml --rig my_rig.toml --bed-mm 256x256x256 -o my_parts
    rhizotwin parts my_scene.toml --part net_pot --part canister_ring -o my_first_parts
    """
    from rhizotwin.building.measures import Measures, load_measures
    from rhizotwin.building.rig_parts import thesis_rig
    from rhizotwin.building.write import write_parts
    from rhizotwin.rig.rig_file import load_rig
    from rhizotwin.scenes.board import CharucoBoard
    from rhizotwin.scenes.files import load_scene

    known = load_scene(scene)
    stands = thesis_rig(known) if rig is None else load_rig(rig)
    bought = Measures() if measures is None else load_measures(measures)
    made = write_parts(known, output, rig=stands, measures=bought, board=CharucoBoard(), bed_mm=bed_mm, names=part)
    for one in made:
        wide, deep, high = one.size_mm
        print(f"{one.name:<16} {wide:6.1f} x {deep:6.1f} x {high:5.1f} mm   {one.about}")
    print(f"wrote {output}; nothing has been printed from it yet: try the net pot and the canister ring first")
