"""`rhizotwin parts`."""

from pathlib import Path
from typing import Annotated

from rhizotwin.arguments import OutputFolder, SceneName, option, options, read_length_mm, with_metavar

BED_LIMITS_MM = (50.0, 2000.0)


def read_bed_mm(text: str) -> tuple[float, float, float]:
    """Read a build volume such as 220x220x250."""
    sides = text.lower().split("x")
    if len(sides) != 3:
        raise ValueError(f"{text!r} is not a build volume; write width, depth and height in mm as 220x220x250")
    wide, deep, high = (read_length_mm(side, BED_LIMITS_MM) for side in sides)
    return wide, deep, high


def parts(
    scene: SceneName,
    /,
    *,
    output: OutputFolder,
    rig: Annotated[Path | None, with_metavar("FILE")] = None,
    measures: Annotated[Path | None, with_metavar("FILE")] = None,
    bed_mm: Annotated[tuple[float, float, float], option(read_bed_mm, "WxDxH")] = (220.0, 220.0, 250.0),
    part: Annotated[tuple[str, ...], options(str, "NAME")] = (),
) -> None:
    """Write the mechanical parts of a rig for 3D printing.

    The parts are: net pot, canister ring, turntable with gears, feet, camera bracket, arm mount, clips and holders of
    the light panel, and a stand for the calibration board. Dimensions are derived from the scene, so that the parts fit
    its canister and marker strip. Files:

      NAME.stl                       watertight mesh in mm, in printing orientation
      drawings/NAME.svg              three views with dimensions; also rig.svg, exploded.svg and wiring_*.svg
      parameters.csv, .json          every dimension and its source

    These parts have not been printed yet. Print and test the net pot and the canister ring first.

    Parameters
    ----------
    scene : str
        Name of a scene (listed by 'rhizotwin scenes') or path of a scene file (TOML).
    output : Path
        Output folder: new or empty.
    rig : Path, optional
        Rig file with the position of the arm, its last link and the height of the floor; default: the arm of Kliman's
        thesis (2022).
    measures : Path, optional
        TOML file with the dimensions of purchased parts and your own measurements, such as fit_mm = 0.25; the defaults
        are listed in parameters.json.
    bed_mm : tuple
        Build volume of your printer: width, depth and height in mm.
    part : tuple of str
        Part to write, such as net_pot, without the drawings of the whole rig; may be repeated; default: all.

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
    print(f"wrote {output}; these parts have not been printed yet: print and test the net pot and the canister ring first")
