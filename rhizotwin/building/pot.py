"""Net pot with its grid, holder of the wire phantom, and ring that centres the canister on the turntable."""

import math

import numpy as np

from rhizotwin.building.measures import Measures
from rhizotwin.building.part import FLIPPED, Dimension, Part, moved, round_up
from rhizotwin.building.shapes import SIDES, circle, hole, polygon, raised, rectangle, turned, union
from rhizotwin.rig.printing.print_strip import FlatStrip
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene

LEAST_WALL_MM = 1.2
"""Minimum wall thickness, which is the width of three printed lines from a 0.4 mm nozzle. Thinner walls leak and
bend."""
SEAT_MM = 3.0
"""Width of the conical seat in the net pot, on which the grid rests."""
GRID_MM = 2.4
"""Thickness of the grid."""
RIM_MM = 3.0
"""Width of the solid rim of the grid. The rim rests on the conical seat of the net pot."""
NOTCH_MM = 1.5
"""Depth of the notch in the upper edge of the net pot. The ends of the marker strip meet at this notch."""
RING_WIDE_MM = 8.0
"""Radial width of the ring that centres the canister. It leaves space for the head of an M3 screw beside the
canister."""
RING_SCREWS = 3
"""Number of screws with which the canister ring is fastened."""
WIRE_HOLE_MM = 1.2
"""Diameter of the holes for wires of 0.8 mm. It is the smallest hole that a printer produces reliably."""
WIRES_AT_MM = ((14.0, 4.0), (-5.0, 13.0), (-13.0, -6.0), (4.0, -15.0))
"""Positions (x, y) of the wires, which equal those in the scene wire_phantom. They are chosen so that wires occlude
each other in only a few views."""
M3_MM = 3.4
"""Diameter of the clearance hole for an M3 screw (ISO 273, medium)."""


def strip_seat_radius_mm(scene: Scene, measures: Measures) -> float:
    """Return the outer radius of the net pot without the marker strip.

    The radius in the scene includes the thickness of the paper.
    """
    return scene.net_pot.outer_radius_mm - measures.paper_mm


def _refuse_pot(scene: Scene, measures: Measures, *, skirt_mm: float, funnel_mm: float) -> None:
    """Raise UserError if the walls of the net pot would be too thin, or if its heights cannot be printed."""
    pot = scene.net_pot
    if skirt_mm < LEAST_WALL_MM:
        least_mm = scene.canister.outer_radius_mm + measures.fit_mm + measures.paper_mm + LEAST_WALL_MM
        raise UserError(
            f"the outer wall of the net pot would be {max(skirt_mm, 0.0):.2f} mm thick, but at least {LEAST_WALL_MM:g} mm are needed; "
            f"set net_pot.outer_radius_mm to at least {round_up(least_mm):g} for this canister and these dimensions"
        )
    if pot.grid_z_mm > -SEAT_MM or pot.top_mm < funnel_mm + NOTCH_MM or pot.skirt_bottom_mm >= 0.0:
        raise UserError(
            f"the net pot of the scene cannot be printed; net_pot.grid_z_mm must be {-SEAT_MM:g} or lower, net_pot.top_mm at least "
            f"{round_up(funnel_mm + NOTCH_MM):g}, and net_pot.skirt_bottom_mm below 0"
        )


def net_pot(scene: Scene, measures: Measures) -> Part:
    """Create the net pot without its grid.

    Raises
    ------
    UserError
        If the walls would be too thin, or the heights in the scene cannot be printed.
    """
    pot, can, fit = scene.net_pot, scene.canister, measures.fit_mm
    seat = strip_seat_radius_mm(scene, measures)
    over = can.outer_radius_mm + fit
    into = can.inner_radius_mm - fit
    inside = into - measures.wall_mm
    funnel = over - inside
    _refuse_pot(scene, measures, skirt_mm=seat - over, funnel_mm=funnel)
    # vertices outside the circle, so that the circumference of the strip's seat equals that of the paper
    corner = seat * np.pi / SIDES / np.sin(np.pi / SIDES)
    body = turned(
        [
            (corner, pot.skirt_bottom_mm),
            (corner, pot.top_mm),
            (over, pot.top_mm),
            (over, funnel),
            (inside, 0.0),
            (inside, pot.grid_z_mm + SEAT_MM),
            (inside - SEAT_MM, pot.grid_z_mm),
            (into, pot.grid_z_mm),
            (into, 0.0),
            (over, 0.0),
            (over, pot.skirt_bottom_mm),
        ]
    )
    wedge = polygon([(-NOTCH_MM, pot.top_mm), (NOTCH_MM, pot.top_mm), (0.0, pot.top_mm - NOTCH_MM)]).extrude(2.0 * RING_WIDE_MM)
    along_x = np.array([[0.0, 0.0, 1.0, seat - RING_WIDE_MM], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]])
    length = FlatStrip(strip=scene.strip, net_pot=pot, paper_mm=measures.paper_mm).length_mm
    return Part(
        name="net_pot",
        about="Rests on the rim of the canister; the marker strip is glued around its skirt, with the seam at the notch.",
        solid=body - wedge.transform(along_x),
        bed_from_part=FLIPPED,
        rig_from_part=(np.eye(4),),
        apart_mm=(0.0, 0.0, 60.0),
        dimensions=(
            Dimension(name="strip's seat", from_mm=(-seat, 0.0, pot.top_mm), to_mm=(seat, 0.0, pot.top_mm)),
            Dimension(name="inside the canister", from_mm=(-into, 0.0, pot.grid_z_mm), to_mm=(into, 0.0, pot.grid_z_mm)),
            Dimension(name="skirt", from_mm=(seat, 0.0, pot.skirt_bottom_mm), to_mm=(seat, 0.0, pot.top_mm)),
        ),
        numbers=(
            ("strip_seat_radius_mm", seat, "net_pot.outer_radius_mm - paper_mm"),
            ("strip_length_mm", length, "height of the paper, as drawn by 'rhizotwin markers'"),
            ("skirt_inner_radius_mm", over, "canister.outer_radius_mm + fit_mm"),
            ("insert_outer_radius_mm", into, "inner radius of the canister - fit_mm"),
            ("insert_inner_radius_mm", inside, "insert_outer_radius_mm - wall_mm"),
            ("skirt_bottom_mm", pot.skirt_bottom_mm, "net_pot.skirt_bottom_mm"),
            ("top_mm", pot.top_mm, "net_pot.top_mm"),
            ("grid_z_mm", pot.grid_z_mm, "net_pot.grid_z_mm"),
        ),
    )


def net_pot_grid(scene: Scene, measures: Measures) -> Part:
    """Create the grid of the net pot, a disc that rests on the conical seat of the pot.

    The lower face of the grid is at ``net_pot.grid_z_mm`` of the scene.

    Raises
    ------
    UserError
        If the open centre is too large.
    """
    low = scene.canister.inner_radius_mm - measures.fit_mm - measures.wall_mm - SEAT_MM
    z = scene.net_pot.grid_z_mm
    disc = turned([(0.0, z), (low, z), (low + GRID_MM, z + GRID_MM), (0.0, z + GRID_MM)])
    opening = measures.mesh_opening_mm
    pitch = measures.mesh_opening_mm + measures.mesh_bar_mm
    steps = (np.arange(-int(low / pitch) - 1, int(low / pitch) + 2)) * pitch
    reach = low - RIM_MM
    openings = union(
        rectangle((x - opening / 2.0, y - opening / 2.0), (x + opening / 2.0, y + opening / 2.0)) for x in steps for y in steps
    ) ^ circle(reach)
    middle = measures.mesh_middle_mm / 2.0
    if not 0.0 <= middle < reach - RIM_MM:
        most_mm = math.ceil(2.0 * (reach - RIM_MM)) - 1
        raise UserError(f"mesh_middle_mm {measures.mesh_middle_mm:g} is too large for the grid; give 0 to {most_mm}")
    if middle > 0.0:  # without the opening, roots were constricted and had to be cut out (thesis, section 3.1)
        openings = openings - circle(middle + RIM_MM) + circle(middle)
    return Part(
        name="net_pot_grid",
        about="Rests in the net pot below the felt; roots grow through the open centre and the openings.",
        solid=disc - raised(openings, z - 1.0, z + GRID_MM + 1.0),
        rig_from_part=(np.eye(4),),
        apart_mm=(0.0, 0.0, 110.0),
        dimensions=(Dimension(name="underside", from_mm=(-low, 0.0, z), to_mm=(low, 0.0, z)),),
        numbers=(
            ("underside_radius_mm", low, "insert_inner_radius_mm - 3 mm of the conical seat"),
            ("thickness_mm", GRID_MM, ""),
            ("mesh_opening_mm", opening, "mesh_opening_mm"),
            ("mesh_bar_mm", measures.mesh_bar_mm, "mesh_bar_mm"),
            ("mesh_middle_mm", measures.mesh_middle_mm, "mesh_middle_mm"),
            ("open_percent", 100.0 * openings.area() / (np.pi * low**2), "open fraction of the lower face"),
        ),
    )


def wire_holder(scene: Scene, measures: Measures) -> Part:
    """Create the holder of the wire phantom, a disc that replaces the grid of the net pot.

    Each wire hangs through a hole of the disc and is bent at its upper end.
    """
    low = scene.canister.inner_radius_mm - measures.fit_mm - measures.wall_mm - SEAT_MM
    z = scene.net_pot.grid_z_mm
    disc = turned([(0.0, z), (low, z), (low + GRID_MM, z + GRID_MM), (0.0, z + GRID_MM)])
    holes = union(hole(WIRE_HOLE_MM, at) for at in WIRES_AT_MM)
    return Part(
        name="wire_holder",
        about="Replaces the grid for the wire phantom; each wire hangs through a hole and is bent at its upper end.",
        solid=disc - raised(holes, z - 1.0, z + GRID_MM + 1.0),
        dimensions=(Dimension(name="underside", from_mm=(-low, 0.0, z), to_mm=(low, 0.0, z)),),
        numbers=(
            ("underside_radius_mm", low, "insert_inner_radius_mm - the cone's 3 mm"),
            ("thickness_mm", GRID_MM, ""),
            ("hole_mm", WIRE_HOLE_MM, ""),
        ),
    )


def ring_outer_radius_mm(scene: Scene, measures: Measures) -> float:
    """Return the outer radius of the ring that centres the canister."""
    return scene.canister.outer_radius_mm + measures.fit_mm + RING_WIDE_MM


def ring_screws_mm(scene: Scene, measures: Measures) -> list[tuple[float, float]]:
    """Return the positions (x, y) of the screws of the canister ring."""
    radius = scene.canister.outer_radius_mm + measures.fit_mm + RING_WIDE_MM / 2.0
    turn = 2.0 * np.pi * np.arange(RING_SCREWS) / RING_SCREWS
    return [(float(radius * np.cos(a)), float(radius * np.sin(a))) for a in turn]


def canister_ring(scene: Scene, measures: Measures) -> Part:
    """Create the ring that centres the canister on the turntable.

    The height of the ring equals the thickness of the canister's base, so that the ring does not occlude the water.
    """
    can = scene.canister
    inner = can.outer_radius_mm + measures.fit_mm
    outer = ring_outer_radius_mm(scene, measures)
    outline = circle(outer) - circle(inner / np.cos(np.pi / SIDES)) - union(hole(M3_MM, at) for at in ring_screws_mm(scene, measures))
    return Part(
        name="canister_ring",
        about="Centres the canister on the turntable; fastened by three M3 screws.",
        solid=raised(outline, 0.0, can.base_mm),
        rig_from_part=(moved(0.0, 0.0, -can.height_mm),),
        apart_mm=(0.0, 0.0, -50.0),
        dimensions=(
            Dimension(name="around the canister", from_mm=(-inner, 0.0, can.base_mm), to_mm=(inner, 0.0, can.base_mm)),
            Dimension(name="outside", from_mm=(-outer, 0.0, 0.0), to_mm=(outer, 0.0, 0.0)),
        ),
        numbers=(
            ("inner_radius_mm", inner, "canister.outer_radius_mm + fit_mm"),
            ("outer_radius_mm", outer, f"inner_radius_mm + {RING_WIDE_MM:g}"),
            ("height_mm", can.base_mm, "canister.base_mm"),
        ),
    )
