"""Lightbox of the panel: clips on the frame, holders, and walls around the space between LEDs and diffuser.

The design follows appendix E.1 of the thesis.
"""

from itertools import pairwise

import numpy as np
from manifold3d import CrossSection

from rhizotwin.building.measures import Measures
from rhizotwin.building.part import Dimension, Part
from rhizotwin.building.pot import M3_MM
from rhizotwin.building.shapes import polygon, raised, rectangle, rounded, teardrop, union
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.frames import Array
from rhizotwin.scenes.model import Scene

CLIP_WIDE_MM, CLIP_WALL_MM = 20.0, 2.4
SCREW_ROOM_MM = 3.5
"""Radius of the free space around an M3 screw, for its head or nut (ISO 4032: 6.0 across corners)."""
HOLDER_LONG_MM, HOLDER_WALL_MM, HOLDER_DEEP_MM = 40.0, 4.0, 10.0
HOLDER_EVERY_MM = 250.0
"""Maximum distance between two adjacent holders on the upper and lower edge of the panel."""
LEAST_PANEL_MM = 100.0
"""Minimum width and height of a panel, which leaves space for a wall piece beside two holders."""
WALL_LONG_MM = 200.0
"""Maximum length of a wall piece of the lightbox."""


def _clip_outline(measures: Measures) -> CrossSection:
    """Return the C-shaped outline of a clip around a profile at the origin.

    The clip is open towards -y, and its back is at +y.
    """
    gap = _clip_gap_mm(measures)
    wall = CLIP_WALL_MM
    nose = measures.slot_mm / 2.0 - measures.fit_mm / 2.0
    lip = min(measures.slot_lip_mm, nose)
    body = rounded(2.0 * (gap + wall), 2.0 * (gap + wall), 1.0) - CrossSection.square((2.0 * gap, 2.0 * gap), center=True)
    mouth = CrossSection.square((2.0 * (gap - wall), 4.0 * wall)).translate((-(gap - wall), -gap - 3.0 * wall))
    noses = [polygon([(side * (gap + 0.1), -nose), (side * (gap + 0.1), nose), (side * (gap - lip), 0.0)]) for side in (-1, 1)]
    end = _clip_screw_mm(measures) + SCREW_ROOM_MM
    back = rectangle((-end, gap), (end, gap + wall + 2.0))
    return union([body - mouth, *noses, back])


def _clip_gap_mm(measures: Measures) -> float:
    """Return half the width of the opening of a clip, which contains the profile."""
    return measures.profile_mm / 2.0 + measures.fit_mm / 2.0


def _clip_screw_mm(measures: Measures) -> float:
    """Return half the distance between the two screws with which a panel holder is fastened to a clip.

    Their heads or nuts are beside the profile and the walls of the clip.
    """
    return _clip_gap_mm(measures) + CLIP_WALL_MM + SCREW_ROOM_MM


def clip_places_mm(scene: Scene) -> list[tuple[float, float]]:
    """Return the positions (y, z) of the clips and holders along the edges of the panel, in the rig frame."""
    wide, high = scene.lights.backlight_wh_mm
    count = max(2, int(np.ceil(wide / HOLDER_EVERY_MM)))
    across = (np.arange(count) + 0.5) / count * wide - wide / 2.0
    z = scene.lights.backlight_z_mm
    return [(float(y), z + side * high / 2.0) for side in (-1, 1) for y in across]


def lightbox_clip(scene: Scene, measures: Measures) -> Part:
    """Create the clip that snaps onto an aluminium profile.

    The profile is parallel to the z axis of the clip. A panel holder is screwed to the back of the clip.
    """
    back = _clip_gap_mm(measures)
    thick = CLIP_WALL_MM + 2.0
    screw = _clip_screw_mm(measures)
    drop = union(teardrop(M3_MM, (x, CLIP_WIDE_MM / 2.0)) for x in (-screw, screw))
    through = drop.extrude(thick + 2.0).transform(np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, back - 1.0], [0.0, 1.0, 0.0, 0.0]]))
    # the profile runs along y behind the panel; the back of the clip, with the holder, faces the canister
    rig_axes = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    places = []
    for y, z in clip_places_mm(scene):
        side = np.sign(z - scene.lights.backlight_z_mm)
        at = frames.translation(_bar_x_mm(scene, measures), y - CLIP_WIDE_MM / 2.0, z + side * _bar_beyond_mm(measures))
        places.append(np.asarray(at @ rig_axes))
    return Part(
        name="lightbox_clip",
        about="Snaps onto a 2020 profile with two noses in its slots; a panel holder is screwed to its back.",
        solid=raised(_clip_outline(measures), 0.0, CLIP_WIDE_MM) - through,
        rig_from_part=tuple(places),
        apart_mm=(-60.0, 0.0, 0.0),
        dimensions=(
            Dimension(name="around the profile", from_mm=(-back, 0.0, CLIP_WIDE_MM), to_mm=(back, 0.0, CLIP_WIDE_MM)),
            Dimension(name="screws", from_mm=(-screw, back, 0.0), to_mm=(screw, back, 0.0)),
        ),
        numbers=(
            ("opening_mm", 2.0 * back, "profile_mm + fit_mm"),
            ("screws_apart_mm", 2.0 * screw, "profile_mm, so that the heads are beside the profile"),
            ("pieces", float(len(places)), f"one per {HOLDER_EVERY_MM:g} mm of the upper and lower edge of the panel"),
        ),
    )


def back_mm(measures: Measures) -> float:
    """Return the distance from the back of a panel holder to the front face of the diffuser.

    The diffuser is assumed to be in the middle of its slot.
    """
    return slots(measures)[1][1] - measures.fit_mm / 2.0


def _bar_x_mm(scene: Scene, measures: Measures) -> float:
    return _panel_x_mm(scene, measures) - (_clip_gap_mm(measures) + CLIP_WALL_MM + 2.0)


def _bar_beyond_mm(measures: Measures) -> float:
    """Return the distance from the edge of the panel to the centre line of the profile beyond it.

    The panel holder is screwed to the clip at this distance.
    """
    return HOLDER_WALL_MM + SCREW_ROOM_MM + _clip_screw_mm(measures)


def slots(measures: Measures) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return two intervals (start, end): the slot for the LED board, and the slot for the diffuser.

    They are measured from the back of the channel, in mm.
    """
    wall = HOLDER_WALL_MM
    fit = measures.fit_mm
    board = (wall, wall + measures.panel_board_mm + fit)
    bright = board[1] + measures.diffuser_gap_mm
    return board, (bright, bright + measures.diffuser_mm + fit)


def channel(measures: Measures, deep: float = HOLDER_DEEP_MM) -> CrossSection:
    """Return the cross-section of the channel that encloses the edge of the panel.

    The floor of the channel is below y = 0. Above it, fins on both sides of each slot guide LED board and diffuser.
    """
    wall = HOLDER_WALL_MM
    grooves = slots(measures)
    floor = rectangle((0.0, -wall), (grooves[1][1] + wall, 0.0))
    fins = [rectangle((x, -wall), (x + wall, deep)) for begin, end in grooves for x in (begin - wall, end)]
    return union([floor, *fins])


def panel_holder(scene: Scene, measures: Measures) -> Part:
    """Create the channel that holds LED board and diffuser at one edge of the panel.

    The back of the channel is at x = 0, and the edge of the panel at y = 0.
    """
    wall = HOLDER_WALL_MM
    deep = HOLDER_DEEP_MM
    screw = _clip_screw_mm(measures)
    bar = _bar_beyond_mm(measures)
    board, diffuser = slots(measures)
    long = diffuser[1] + wall
    outline = union([channel(measures), rectangle((0.0, -bar - screw - SCREW_ROOM_MM), (wall, 0.0))])
    middle = HOLDER_LONG_MM / 2.0
    screws = union(teardrop(M3_MM, (-bar + s * screw, middle)) for s in (-1, 1))
    through = screws.extrude(wall + 2.0).transform(np.array([[0.0, 0.0, 1.0, -1.0], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]]))
    places = []
    x = _panel_x_mm(scene, measures)
    for y, z in clip_places_mm(scene):
        up = -np.sign(z - scene.lights.backlight_z_mm)  # the channel opens towards the centre of the panel
        places.append(_at_edge((x, y, z), up, HOLDER_LONG_MM))
    return Part(
        name="panel_holder",
        about="Holds the LED board and the diffuser at the upper and lower edge of the panel.",
        solid=raised(outline, 0.0, HOLDER_LONG_MM) - through,
        rig_from_part=tuple(places),
        apart_mm=(-20.0, 0.0, 0.0),
        dimensions=(
            Dimension(name="board to diffuser", from_mm=(board[1], deep, HOLDER_LONG_MM), to_mm=(diffuser[0], deep, HOLDER_LONG_MM)),
            Dimension(name="length", from_mm=(0.0, -wall, 0.0), to_mm=(long, -wall, 0.0)),
        ),
        numbers=(
            ("board_slot_mm", board[1] - board[0], "panel_board_mm + fit_mm"),
            ("diffuser_slot_mm", diffuser[1] - diffuser[0], "diffuser_mm + fit_mm"),
            ("between_mm", diffuser[0] - board[1], "diffuser_gap_mm"),
            ("pieces", float(len(places)), "same number as clips"),
        ),
    )


def _at_edge(middle_mm: tuple[float, float, float], up: float, long_mm: float) -> Array:
    """Return the pose (4, 4) in the rig frame of a piece at an edge of the panel.

    The middle of the piece is at ``middle_mm``. ``up`` is the direction in which the channel opens: -1 at the upper
    edge, 1 at the lower edge.
    """
    x, y, z = middle_mm
    axes = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -up, 0.0], [0.0, up, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    return np.asarray(frames.translation(x, y + up * long_mm / 2.0, z) @ axes)


def lightbox_walls(scene: Scene, measures: Measures) -> list[Part]:
    """Create the wall pieces of the lightbox.

    They close the gaps between the holders and the two sides.

    Raises
    ------
    UserError
        If the panel is too small.
    """
    wide, high = scene.lights.backlight_wh_mm
    if min(wide, high) < LEAST_PANEL_MM:
        raise UserError(
            f"the panel (lights.backlight_wh_mm) of {wide:g} x {high:g} mm is too small for the printed holders and walls; "
            f"use a panel of at least {LEAST_PANEL_MM:g} x {LEAST_PANEL_MM:g} mm"
        )
    centres = sorted({y for y, _ in clip_places_mm(scene)})
    half = HOLDER_LONG_MM / 2.0
    gaps = [(-wide / 2.0, centres[0] - half), *((a + half, b - half) for a, b in pairwise(centres)), (centres[-1] + half, wide / 2.0)]
    by_length: dict[float, list[float]] = {}
    for low, end in gaps:
        count = int(np.ceil((end - low) / WALL_LONG_MM))
        long = round((end - low) / count, 3)
        by_length.setdefault(long, []).extend(low + (k + 0.5) * long for k in range(count))
    edges = [_edge_piece(scene, measures, number, long, middles) for number, (long, middles) in enumerate(by_length.items(), start=1)]
    return [*edges, _side_piece(scene, measures)]


def _edge_piece(scene: Scene, measures: Measures, number: int, long_mm: float, middles_mm: list[float]) -> Part:
    """Create a wall piece for the upper and lower edge of the lightbox."""
    z = scene.lights.backlight_z_mm
    high = scene.lights.backlight_wh_mm[1]
    x = _panel_x_mm(scene, measures)
    cut = long_mm - measures.fit_mm
    places = []
    for y in middles_mm:
        for up in (1.0, -1.0):
            places.append(_at_edge((x, y, z - up * high / 2.0), up, cut))
    return Part(
        name=f"lightbox_wall_{number}",
        about="Closes the lightbox between two holders at its upper and lower edge; glue it to the LED board.",
        solid=raised(channel(measures), 0.0, cut),
        rig_from_part=tuple(places),
        apart_mm=(-40.0, 0.0, 0.0),
        dimensions=(Dimension(name="length", from_mm=(0.0, -HOLDER_WALL_MM, 0.0), to_mm=(0.0, -HOLDER_WALL_MM, cut)),),
        numbers=(("length_mm", cut, "between the holders, minus fit_mm"), ("pieces", float(len(places)), "")),
    )


def _side_piece(scene: Scene, measures: Measures) -> Part:
    """Create a wall piece for the left and right side of the lightbox.

    Its fins are shortened so that they do not touch the upper and lower walls.
    """
    wide, high = scene.lights.backlight_wh_mm
    count = int(np.ceil(high / WALL_LONG_MM))
    long = high / count - measures.fit_mm
    clear = HOLDER_DEEP_MM + measures.fit_mm
    floor = raised(channel(measures, deep=0.0), 0.0, long)
    solid = floor + raised(channel(measures), clear, long - clear)
    x = _panel_x_mm(scene, measures)
    low = scene.lights.backlight_z_mm - high / 2.0
    places = []
    for side in (-1.0, 1.0):  # opens towards the centre of the panel
        axes = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, -side, 0.0, 0.0], [0.0, 0.0, -side, 0.0], [0.0, 0.0, 0.0, 1.0]])
        for k in range(count):
            begin = low + (k + 0.5) * high / count + side * long / 2.0
            places.append(np.asarray(frames.translation(x, side * wide / 2.0, begin) @ axes))
    return Part(
        name="lightbox_side",
        about="Closes the lightbox at its left and right; glue it to the LED board.",
        solid=solid,
        bed_from_part=np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]),
        rig_from_part=tuple(places),
        apart_mm=(-40.0, 0.0, 0.0),
        dimensions=(Dimension(name="length", from_mm=(0.0, -HOLDER_WALL_MM, 0.0), to_mm=(0.0, -HOLDER_WALL_MM, long)),),
        numbers=(("length_mm", long, "height of lights.backlight_wh_mm, minus fit_mm"), ("pieces", float(len(places)), "")),
    )


def _panel_x_mm(scene: Scene, measures: Measures) -> float:
    """Return the x coordinate, in the rig frame, of the back of the channels that hold the panel."""
    return -scene.lights.backlight_distance_mm - back_mm(measures)
