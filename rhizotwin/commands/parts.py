"""Command `rhizotwin parts`."""

from pathlib import Path
from typing import Annotated

from rhizotwin.steps.arguments import OutputFolder, SceneName, option, options, read_length_mm, with_metavar

BED_LIMITS_MM = (50.0, 2000.0)


def read_bed_mm(text: str) -> tuple[float, float, float]:
    """Convert a build volume such as 220x220x250 to width, depth and height in mm."""
    sides = text.lower().split("x")
    if len(sides) != 3:
        raise ValueError(f"{text!r} is not a build volume; write width, depth and height in mm, such as 220x220x250")
    wide, deep, high = (read_length_mm(side, BED_LIMITS_MM) for side in sides)
    return wide, deep, high


def parts(
    scene: SceneName,
    /,
    *,
    output: OutputFolder,
    rig: Annotated[Path | None, with_metavar("FILE")] = None,
    measures: Annotated[Path | None, with_metavar("FILE")] = None,
    bed_mm: Annotated[tuple[float, float, float], option(read_bed_mm, "WxDxH", show_default=False)] = (220.0, 220.0, 250.0),
    part: Annotated[tuple[str, ...], options(str, "NAME")] = (),
) -> None:
    """Write the mechanical parts of a rig for 3D printing.

    The parts are the net pot (holds the plant on the canister), canister ring (centres the canister), turntable with
    gears and feet, camera bracket, arm mount, clips and holders of the light panel, and a stand for the calibration
    board. Their dimensions are derived from the scene, so that they fit its canister and marker strip. Written files:

      NAME.stl                 watertight mesh in mm, in printing orientation
      drawings/NAME.svg        views with dimensions; also rig.svg, exploded.svg, wiring_*.svg
      parameters.csv, .json    all dimensions and their sources

    These parts have not been printed yet. Print and test the net pot and the canister ring first.

    Parameters
    ----------
    scene : str
        Scene, which describes canister and rig: a name listed by 'rhizotwin scenes', or a scene file (TOML).
    output : Path
        New or empty output folder.
    rig : Path, optional
        Rig file (TOML) with the position of the arm, the length of its last link and the height of the floor; default:
        rig of Kliman's thesis (2022).
    measures : Path, optional
        TOML file with the dimensions of purchased parts and your own measurements, such as fit_mm = 0.25; the defaults
        are listed in parameters.json.
    bed_mm : tuple
        Width, depth and height of your printer's build volume in mm; default: 220x220x250.
    part : tuple of str
        Name of a part to write, such as net_pot, without drawings of the rig; may be repeated; default: all parts.

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
    from rhizotwin.scenes.files import load_scene

    known = load_scene(scene)
    stands = thesis_rig(known) if rig is None else load_rig(rig)
    bought = Measures() if measures is None else load_measures(measures)
    made = write_parts(known, output, rig=stands, measures=bought, bed_mm=bed_mm, names=part)
    for one in made:
        wide, deep, high = one.size_mm
        print(f"{one.name:<16} {wide:6.1f} x {deep:6.1f} x {high:5.1f} mm   {one.about}")
    print(f"wrote {output}; these parts have not been printed yet, so print and test the net pot and the canister ring first")
