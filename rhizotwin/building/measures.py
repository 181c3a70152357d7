"""What is bought and what the printer makes of a gap.

Numbers that a scene does not hold, and that every printed part hangs on.
"""

from dataclasses import dataclass
from pathlib import Path

from rhizotwin.scenes.files import read_toml
from rhizotwin.scenes.limits import bounded
from rhizotwin.scenes.schema import Place, from_plain


@dataclass(frozen=True, kw_only=True)
class Measures:
    """Sizes of what the printed parts hold and are held by. The defaults are nominal: measure yours with a caliper."""

    paper_mm: float = bounded(0.1, 0.0, 2.0)
    """Thickness of the strip's paper, as in `rhizotwin markers --paper-mm`."""
    fit_mm: float = bounded(0.3, 0.05, 2.0)
    """Gap on each side between a printed part and what it goes round or into; half of it where two printed parts only
    must not bind."""
    wall_mm: float = bounded(2.4, 0.8, 20.0)
    """Thickness of the net pot's walls, where the scene leaves the choice: six lines of a 0.4 mm nozzle."""
    mesh_opening_mm: float = bounded(6.0, 0.5, 50.0)
    """Side of the grid's square openings, through which roots grow."""
    mesh_bar_mm: float = bounded(2.0, 0.4, 20.0)
    """Width of the bars between them."""
    mesh_middle_mm: float = bounded(40.0, 0.0, 500.0)
    """Diameter of the grid's open middle, so that it constricts no roots; 0: none."""
    motor_face_mm: float = bounded(42.3, 20.0, 100.0)
    """Side of the stepper's face (NEMA 17)."""
    motor_holes_mm: float = bounded(31.0, 10.0, 80.0)
    """Distance of its M3 holes (NEMA ICS 16: 1.220 in)."""
    motor_boss_mm: float = bounded(22.0, 5.0, 60.0)
    """Diameter of the collar round its shaft."""
    motor_length_mm: float = bounded(40.0, 10.0, 120.0)
    shaft_mm: float = bounded(5.0, 2.0, 20.0)
    """Diameter of its shaft."""
    shaft_flat_mm: float = bounded(4.5, 1.5, 20.0)
    """From the shaft's flat to its other side."""
    shaft_length_mm: float = bounded(24.0, 8.0, 80.0)
    bearing_mm: tuple[float, float, float] = bounded((8.0, 22.0, 7.0), 1.0, 100.0)
    """Bore, outer diameter and width of the ball bearing under the table (608, ISO 15)."""
    ball_mm: float = bounded(6.0, 2.0, 20.0)
    """Diameter of the loose balls between table and base."""
    magnet_mm: tuple[float, float] = bounded((10.0, 3.0), 1.0, 30.0)
    """Diameter and height of the magnets that turn the canister in a tank."""
    profile_mm: float = bounded(20.0, 10.0, 60.0)
    """Side of the aluminium profile (2020)."""
    slot_mm: float = bounded(6.2, 3.0, 20.0)
    """Opening of its slots (I-type, slot 6)."""
    slot_lip_mm: float = bounded(1.5, 0.5, 6.0)
    """How deep a slot's opening is before it widens."""
    camera_holes_mm: float = bounded(30.0, 10.0, 100.0)
    """Distance of the camera board's M2.5 holes (Raspberry Pi HQ camera: 30 x 30 on a board of 38 x 38)."""
    camera_board_mm: float = bounded(38.0, 15.0, 120.0)
    """Side of the camera's board."""
    camera_centre_mm: float = bounded(18.0, 0.0, 200.0)
    """From the back of the camera's board to the lens's centre of projection: about the C-mount's 17.5 until it is
    calibrated."""
    roll_face_mm: float = bounded(55.0, 5.0, 300.0)
    """From the arm's wrist pitch axis to the horn of its roll servo (xArm: 53 to 55 in published models)."""
    horn_holes_mm: tuple[float, float] = bounded((12.0, 20.0), 2.0, 100.0)
    """Least and largest bolt circle of that horn, which the bracket's slots take."""
    arm_base_mm: tuple[float, float] = bounded((80.0, 60.0), 20.0, 400.0)
    """Distances of the holes in the arm's base plate, along and across; published models do not give them."""
    panel_board_mm: float = bounded(5.0, 1.0, 40.0)
    """Thickness of the board that carries the panel's LEDs."""
    diffuser_mm: float = bounded(3.0, 0.1, 20.0)
    """Thickness of the opal diffuser."""
    diffuser_gap_mm: float = bounded(50.0, 5.0, 200.0)
    """From the LEDs' board to the diffuser: LEDs 17 mm apart are even to a few per cent from three times their
    distance."""
    stand_board_mm: float = bounded(4.0, 1.0, 30.0)
    """Thickness of what the calibration board is glued on."""


def load_measures(path: Path) -> Measures:
    """Load measures from a TOML file that holds those that differ from the defaults.

    Raises
    ------
    UserError
        For a missing file, an unknown key, a wrong type, or a value beyond its limits (with the line).
    """
    table, text = read_toml(path)
    return from_plain(Measures, table, Place(str(path), text))
