"""Dimensions of purchased parts and printing clearances.

These parameters are not part of a scene; all printed parts depend on them.
"""

from dataclasses import dataclass
from pathlib import Path

from rhizotwin.scenes.files import read_toml
from rhizotwin.scenes.limits import bounded
from rhizotwin.scenes.schema import Place, from_plain


@dataclass(frozen=True, kw_only=True)
class Measures:
    """Dimensions of purchased parts and clearances. The defaults are nominal: measure your parts with a caliper."""

    paper_mm: float = bounded(0.1, 0.0, 2.0)
    """Thickness of the paper of the marker strip, as in `rhizotwin markers --paper-mm`."""
    fit_mm: float = bounded(0.3, 0.05, 2.0)
    """Clearance on each side between a printed part and its counterpart; half of it between printed parts that only
    need to move freely."""
    wall_mm: float = bounded(2.4, 0.8, 20.0)
    """Wall thickness of the net pot, unless given by the scene: six lines of a 0.4 mm nozzle."""
    mesh_opening_mm: float = bounded(6.0, 0.5, 50.0)
    """Side length of the square openings of the grid, through which roots grow."""
    mesh_bar_mm: float = bounded(2.0, 0.4, 20.0)
    """Width of the bars between the openings."""
    mesh_middle_mm: float = bounded(40.0, 0.0, 500.0)
    """Diameter of the open centre of the grid, which avoids constriction of roots; 0: none."""
    motor_face_mm: float = bounded(42.3, 20.0, 100.0)
    """Side length of the stepper motor's face (NEMA 17)."""
    motor_holes_mm: float = bounded(31.0, 10.0, 80.0)
    """Distance of the motor's M3 holes (NEMA ICS 16: 1.220 in)."""
    motor_boss_mm: float = bounded(22.0, 5.0, 60.0)
    """Diameter of the collar around the motor shaft."""
    motor_length_mm: float = bounded(40.0, 10.0, 120.0)
    shaft_mm: float = bounded(5.0, 2.0, 20.0)
    """Diameter of the motor shaft."""
    shaft_flat_mm: float = bounded(4.5, 1.5, 20.0)
    """Distance from the flat of the shaft to its opposite side."""
    shaft_length_mm: float = bounded(24.0, 8.0, 80.0)
    bearing_mm: tuple[float, float, float] = bounded((8.0, 22.0, 7.0), 1.0, 100.0)
    """Bore, outer diameter and width of the ball bearing below the turntable (608, ISO 15)."""
    ball_mm: float = bounded(6.0, 2.0, 20.0)
    """Diameter of the loose balls between plate and base."""
    magnet_mm: tuple[float, float] = bounded((10.0, 3.0), 1.0, 30.0)
    """Diameter and height of the magnets that rotate the canister in a tank."""
    profile_mm: float = bounded(20.0, 10.0, 60.0)
    """Side length of the aluminium profile (2020)."""
    slot_mm: float = bounded(6.2, 3.0, 20.0)
    """Opening of the profile's slots (I-type, slot 6)."""
    slot_lip_mm: float = bounded(1.5, 0.5, 6.0)
    """Depth of the slot opening before it widens."""
    camera_holes_mm: float = bounded(30.0, 10.0, 100.0)
    """Distance of the M2.5 holes of the camera board (Raspberry Pi HQ camera: 30 x 30, board 38 x 38)."""
    camera_board_mm: float = bounded(38.0, 15.0, 120.0)
    """Side length of the camera board."""
    camera_centre_mm: float = bounded(18.0, 0.0, 200.0)
    """Distance from the back of the camera board to the projection centre of the lens: about the 17.5 mm of the C
    mount, until calibrated."""
    roll_face_mm: float = bounded(55.0, 5.0, 300.0)
    """Distance from the wrist pitch axis of the arm to the horn of its roll servo (xArm: 53 to 55)."""
    horn_holes_mm: tuple[float, float] = bounded((12.0, 20.0), 2.0, 100.0)
    """Minimum and maximum bolt circle of that horn, covered by the slots of the bracket."""
    arm_base_mm: tuple[float, float] = bounded((80.0, 60.0), 20.0, 400.0)
    """Distances of the holes in the arm's base plate, along and across; not given in published models."""
    panel_board_mm: float = bounded(5.0, 1.0, 40.0)
    """Thickness of the LED board of the panel."""
    diffuser_mm: float = bounded(3.0, 0.1, 20.0)
    """Thickness of the opal diffuser."""
    diffuser_gap_mm: float = bounded(50.0, 5.0, 200.0)
    """Distance from the LED board to the diffuser: with LEDs 17 mm apart, the light is uniform within a few per cent
    from three times that distance."""
    stand_board_mm: float = bounded(4.0, 1.0, 30.0)
    """Thickness of the plate to which the calibration board is glued."""


def load_measures(path: Path) -> Measures:
    """Load dimensions from a TOML file with those that differ from the defaults.

    Raises
    ------
    UserError
        If the file is missing, a key is unknown, or a value has a wrong type or is out of range (with the line).
    """
    table, text = read_toml(path)
    return from_plain(Measures, table, Place(str(path), text))
