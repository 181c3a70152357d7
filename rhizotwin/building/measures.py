"""Dimensions of purchased parts, and clearances for 3D printing.

All printed parts depend on these parameters, which are not included in a scene.
"""

from dataclasses import dataclass
from pathlib import Path

from rhizotwin.scenes.files import read_toml
from rhizotwin.scenes.limits import bounded
from rhizotwin.scenes.schema import Place, from_plain


@dataclass(frozen=True, kw_only=True)
class Measures:
    """Dimensions of purchased parts, and clearances. The defaults are nominal.

    Measure the real parts with a caliper.
    """

    paper_mm: float = bounded(0.1, 0.0, 2.0)
    """Thickness of the paper on which the marker strip is printed, as given by `rhizotwin markers --paper-mm`."""
    fit_mm: float = bounded(0.3, 0.05, 2.0)
    """Gap on each side between a printed part and the part that it must fit. Half of this gap is used between printed
    parts that only need to move freely."""
    wall_mm: float = bounded(2.4, 0.8, 20.0)
    """Wall thickness of the net pot if the scene does not specify it. The default is the width of six printed lines
    from a 0.4 mm nozzle."""
    mesh_opening_mm: float = bounded(6.0, 0.5, 50.0)
    """Side length of the square openings in the grid, through which roots grow."""
    mesh_bar_mm: float = bounded(2.0, 0.4, 20.0)
    """Width of the bars between the openings of the grid."""
    mesh_middle_mm: float = bounded(40.0, 0.0, 500.0)
    """Diameter of the open centre of the grid, which prevents constriction of roots. If it is 0, the grid has no open
    centre."""
    motor_face_mm: float = bounded(42.3, 20.0, 100.0)
    """Side length of the stepper motor's face (NEMA 17)."""
    motor_holes_mm: float = bounded(31.0, 10.0, 80.0)
    """Spacing of the motor's M3 holes (NEMA ICS 16: 1.220 in)."""
    motor_boss_mm: float = bounded(22.0, 5.0, 60.0)
    """Diameter of the collar around the motor shaft."""
    motor_length_mm: float = bounded(40.0, 10.0, 120.0)
    shaft_mm: float = bounded(5.0, 2.0, 20.0)
    """Diameter of the motor shaft."""
    shaft_flat_mm: float = bounded(4.5, 1.5, 20.0)
    """Distance from the flat side of the motor shaft to the opposite point of its surface."""
    shaft_length_mm: float = bounded(24.0, 8.0, 80.0)
    bearing_mm: tuple[float, float, float] = bounded((8.0, 22.0, 7.0), 1.0, 100.0)
    """Bore, outer diameter and width of the ball bearing below the turntable (608, ISO 15)."""
    ball_mm: float = bounded(6.0, 2.0, 20.0)
    """Diameter of the loose balls between turntable plate and base."""
    magnet_mm: tuple[float, float] = bounded((10.0, 3.0), 1.0, 30.0)
    """Diameter and height of the magnets that turn the canister if it stands in a tank."""
    profile_mm: float = bounded(20.0, 10.0, 60.0)
    """Side length of the aluminium profiles (2020)."""
    slot_mm: float = bounded(6.2, 3.0, 20.0)
    """Width of the narrow opening of the slots in the aluminium profiles (I-type, slot 6)."""
    slot_lip_mm: float = bounded(1.5, 0.5, 6.0)
    """Depth of the narrow opening of the slots in the aluminium profiles."""
    camera_holes_mm: float = bounded(30.0, 10.0, 100.0)
    """Spacing of the M2.5 holes of the camera board. The Raspberry Pi HQ camera has holes at 30 x 30 on a board of 38 x
    38."""
    camera_board_mm: float = bounded(38.0, 15.0, 120.0)
    """Side length of the camera board."""
    camera_centre_mm: float = bounded(18.0, 0.0, 200.0)
    """Distance from the back of the camera board to the projection centre of the lens. The default is approximately the
    flange distance of the C mount (17.5 mm), and is used until the camera is calibrated."""
    roll_face_mm: float = bounded(55.0, 5.0, 300.0)
    """Distance from the arm's wrist pitch axis to the horn (mounting disc) of the roll servo. For the xArm it is 53 to
    55 mm."""
    horn_holes_mm: tuple[float, float] = bounded((12.0, 20.0), 2.0, 100.0)
    """Smallest and largest diameter of the servo horn's bolt circle for which the bracket has slots."""
    arm_base_mm: tuple[float, float] = bounded((80.0, 60.0), 20.0, 400.0)
    """Spacing of the holes in the arm's base plate, along and across the arm. It must be measured, because published
    models of the arm do not include these holes."""
    panel_board_mm: float = bounded(5.0, 1.0, 40.0)
    """Thickness of the LED board of the panel."""
    diffuser_mm: float = bounded(3.0, 0.1, 20.0)
    """Thickness of the opal diffuser."""
    diffuser_gap_mm: float = bounded(50.0, 5.0, 200.0)
    """Distance from the LED board to the diffuser. The light is uniform within a few per cent if this distance is at
    least three times the spacing of the LEDs. The LEDs are 17 mm apart."""
    stand_board_mm: float = bounded(4.0, 1.0, 30.0)
    """Thickness of the plate to which the calibration board is glued."""


def load_measures(path: Path) -> Measures:
    """Load dimensions from a TOML file.

    Keys that are missing in the file have their default values.

    Raises
    ------
    UserError
        If the file is missing, a key is unknown, or a value has a wrong type or is out of range. The message states the
        line.
    """
    table, text = read_toml(path)
    return from_plain(Measures, table, Place(str(path), text))
