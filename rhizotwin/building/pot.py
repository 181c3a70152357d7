"""The net pot with its grid, and the ring that keeps the canister in the table's middle.

The canister's frame: the rim lies at z = 0. The pot sits on the rim; its skirt goes over the canister and carries the
strip, its insert goes into it and carries the grid.
"""

import numpy as np

from rhizotwin.building.measures import Measures
from rhizotwin.building.part import FLIPPED, Dimension, Part, moved
from rhizotwin.building.shapes import SIDES, circle, hole, polygon, raised, rectangle, turned, union
from rhizotwin.rig.printing.print_strip import FlatStrip
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene

LEAST_WALL_MM = 1.2
"""Three lines of a 0.4 mm nozzle: thinner walls leak and bend."""
SEAT_MM = 3.0
"""Width of the cone that the grid rests on."""
GRID_MM = 2.4
RIM_MM = 3.0
"""Solid edge of the grid, which lies in the cone."""
NOTCH_MM = 1.5
"""Depth of the notch in the upper edge that marks the strip's seam."""
RING_WIDE_MM = 8.0
"""Of the canister's ring: room for an M3 screw's head beside the canister."""
RING_SCREWS = 3
WIRE_HOLE_MM = 1.2
"""A printer's smallest sure hole, wide enough for a wire of 0.8 mm."""
WIRES_AT_MM = ((14.0, 4.0), (-5.0, 13.0), (-13.0, -6.0), (4.0, -15.0))
"""Places of the wires, as in the scene wire_phantom: none hides another one in more than a few views."""
M3_MM = 3.4
"""Clearance hole of an M3 screw (ISO 273, medium)."""


def strip_seat_radius_mm(scene: Scene, measures: Measures) -> float:
    """Return the radius under the paper: the scene's radius is the one over it."""
    return scene.net_pot.outer_radius_mm - measures.paper_mm


def _refuse_pot(scene: Scene, measures: Measures, *, skirt_mm: float, funnel_mm: float) -> None:
    """Refuse a net pot whose walls would be too thin or too short."""
    pot = scene.net_pot
    if skirt_mm < LEAST_WALL_MM:
        least_mm = scene.canister.outer_radius_mm + measures.fit_mm + measures.paper_mm + LEAST_WALL_MM
        raise UserError(
            f"the net pot's skirt would be {max(skirt_mm, 0.0):.2f} mm thick, but needs {LEAST_WALL_MM:g}: "
            f"net_pot.outer_radius_mm must be at least {least_mm:.2f} with this canister and these measures"
        )
    if pot.grid_z_mm > -SEAT_MM or pot.top_mm < funnel_mm + NOTCH_MM or pot.skirt_bottom_mm >= 0.0:
        raise UserError(
            f"the net pot cannot be printed: net_pot.grid_z_mm must be {-SEAT_MM:g} or lower, top_mm above {funnel_mm + NOTCH_MM:.1f}, "
            "and skirt_bottom_mm below 0"
        )


def net_pot(scene: Scene, measures: Measures) -> Part:
    """Return the net pot without its grid.

    Raises
    ------
    UserError
        Where the scene leaves too little for its walls.
    """
    pot, can, fit = scene.net_pot, scene.canister, measures.fit_mm
    seat = strip_seat_radius_mm(scene, measures)
    over, into = can.outer_radius_mm + fit, can.inner_radius_mm - fit
    inside = into - measures.wall_mm
    funnel = over - inside
    _refuse_pot(scene, measures, skirt_mm=seat - over, funnel_mm=funnel)
    # a circle's corners lie outside it, so that the strip's seat has the circumference of the paper
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
        about="Sits on the canister's rim; the strip is glued round its skirt, its seam at the notch.",
        solid=body - wedge.transform(along_x),
        bed_from_part=FLIPPED,
        rig_from_part=(np.eye(4),),
        apart_mm=(0.0, 0.0, 60.0),
        dimensions=(
            Dimension(name="strip's seat", from_mm=(-seat, 0.0, pot.top_mm), to_mm=(seat, 0.0, pot.top_mm)),
            Dimension(name="into the canister", from_mm=(-into, 0.0, pot.grid_z_mm), to_mm=(into, 0.0, pot.grid_z_mm)),
            Dimension(name="skirt", from_mm=(seat, 0.0, pot.skirt_bottom_mm), to_mm=(seat, 0.0, pot.top_mm)),
        ),
        numbers=(
            ("strip_seat_radius_mm", seat, "net_pot.outer_radius_mm - paper_mm"),
            ("strip_length_mm", length, "the paper's, as `rhizotwin markers` draws it"),
            ("skirt_inner_radius_mm", over, "canister.outer_radius_mm + fit_mm"),
            ("insert_outer_radius_mm", into, "canister's inner radius - fit_mm"),
            ("insert_inner_radius_mm", inside, "insert_outer_radius_mm - wall_mm"),
            ("skirt_bottom_mm", pot.skirt_bottom_mm, "net_pot.skirt_bottom_mm"),
            ("top_mm", pot.top_mm, "net_pot.top_mm"),
            ("grid_z_mm", pot.grid_z_mm, "net_pot.grid_z_mm"),
        ),
    )


def net_pot_grid(scene: Scene, measures: Measures) -> Part:
    """Return the grid: a disc that is dropped into the pot and rests on its cone.

    Its underside is at the scene's ``grid_z_mm``.
    """
    low = scene.canister.inner_radius_mm - measures.fit_mm - measures.wall_mm - SEAT_MM
    z = scene.net_pot.grid_z_mm
    disc = turned([(0.0, z), (low, z), (low + GRID_MM, z + GRID_MM), (0.0, z + GRID_MM)])
    opening, pitch = measures.mesh_opening_mm, measures.mesh_opening_mm + measures.mesh_bar_mm
    steps = (np.arange(-int(low / pitch) - 1, int(low / pitch) + 2)) * pitch
    reach = low - RIM_MM
    openings = union(
        rectangle((x - opening / 2.0, y - opening / 2.0), (x + opening / 2.0, y + opening / 2.0)) for x in steps for y in steps
    ) ^ circle(reach)
    middle = measures.mesh_middle_mm / 2.0
    if not 0.0 <= middle < reach - RIM_MM:
        raise UserError(f"mesh_middle_mm {measures.mesh_middle_mm:g} leaves no grid: give 0 to {2.0 * (reach - RIM_MM):.0f}")
    if middle > 0.0:  # what grew through a grid without it was constricted, and had to be cut out (thesis, section 3.1)
        openings = openings - circle(middle + RIM_MM) + circle(middle)
    return Part(
        name="net_pot_grid",
        about="Lies in the net pot under the felt; roots grow through its open middle and its openings.",
        solid=disc - raised(openings, z - 1.0, z + GRID_MM + 1.0),
        rig_from_part=(np.eye(4),),
        apart_mm=(0.0, 0.0, 110.0),
        dimensions=(Dimension(name="underside", from_mm=(-low, 0.0, z), to_mm=(low, 0.0, z)),),
        numbers=(
            ("underside_radius_mm", low, "insert_inner_radius_mm - the cone's 3 mm"),
            ("thickness_mm", GRID_MM, ""),
            ("mesh_opening_mm", opening, "mesh_opening_mm"),
            ("mesh_bar_mm", measures.mesh_bar_mm, "mesh_bar_mm"),
            ("mesh_middle_mm", measures.mesh_middle_mm, "mesh_middle_mm"),
            ("open_percent", 100.0 * openings.area() / (np.pi * low**2), "openings over the underside"),
        ),
    )


def wire_holder(scene: Scene, measures: Measures) -> Part:
    """Return the holder of the wire phantom: a closed disc that lies in the pot in place of the grid.

    Each wire hangs through a hole and is bent over on top.
    """
    low = scene.canister.inner_radius_mm - measures.fit_mm - measures.wall_mm - SEAT_MM
    z = scene.net_pot.grid_z_mm
    disc = turned([(0.0, z), (low, z), (low + GRID_MM, z + GRID_MM), (0.0, z + GRID_MM)])
    holes = union(hole(WIRE_HOLE_MM, at) for at in WIRES_AT_MM)
    return Part(
        name="wire_holder",
        about="In place of the grid, for the wire phantom: each wire hangs through a hole and is bent over on top.",
        solid=disc - raised(holes, z - 1.0, z + GRID_MM + 1.0),
        dimensions=(Dimension(name="underside", from_mm=(-low, 0.0, z), to_mm=(low, 0.0, z)),),
        numbers=(
            ("underside_radius_mm", low, "insert_inner_radius_mm - the cone's 3 mm"),
            ("thickness_mm", GRID_MM, ""),
            ("hole_mm", WIRE_HOLE_MM, ""),
        ),
    )


def ring_outer_radius_mm(scene: Scene, measures: Measures) -> float:
    """Return the outer radius of the canister's ring."""
    return scene.canister.outer_radius_mm + measures.fit_mm + RING_WIDE_MM


def ring_screws_mm(scene: Scene, measures: Measures) -> list[tuple[float, float]]:
    """Return where the ring's screws go through ring and table."""
    radius = scene.canister.outer_radius_mm + measures.fit_mm + RING_WIDE_MM / 2.0
    turn = 2.0 * np.pi * np.arange(RING_SCREWS) / RING_SCREWS
    return [(float(radius * np.cos(a)), float(radius * np.sin(a))) for a in turn]


def canister_ring(scene: Scene, measures: Measures) -> Part:
    """Return the ring that keeps the canister on the table's axis.

    It is as high as the canister's base, so that it hides no water.
    """
    can = scene.canister
    inner, outer = can.outer_radius_mm + measures.fit_mm, ring_outer_radius_mm(scene, measures)
    outline = circle(outer) - circle(inner / np.cos(np.pi / SIDES)) - union(hole(M3_MM, at) for at in ring_screws_mm(scene, measures))
    return Part(
        name="canister_ring",
        about="Keeps the canister in the table's middle; three M3 screws into the table.",
        solid=raised(outline, 0.0, can.base_mm),
        rig_from_part=(moved(0.0, 0.0, -can.height_mm),),
        apart_mm=(0.0, 0.0, -50.0),
        dimensions=(
            Dimension(name="round the canister", from_mm=(-inner, 0.0, can.base_mm), to_mm=(inner, 0.0, can.base_mm)),
            Dimension(name="outside", from_mm=(-outer, 0.0, 0.0), to_mm=(outer, 0.0, 0.0)),
        ),
        numbers=(
            ("inner_radius_mm", inner, "canister.outer_radius_mm + fit_mm"),
            ("outer_radius_mm", outer, f"inner_radius_mm + {RING_WIDE_MM:g}"),
            ("height_mm", can.base_mm, "canister.base_mm"),
        ),
    )
