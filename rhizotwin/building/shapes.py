"""Outlines and solids of parts, computed with manifold3d in millimetres with z up."""

from collections.abc import Iterable, Sequence
from typing import TypeAlias

import numpy as np
from manifold3d import CrossSection, JoinType, Manifold, OpType
from numpy.typing import NDArray

from rhizotwin.scenes.frames import Array

SIDES = 240
"""Number of sides of the polygon that approximates a circle. At a radius of 80 mm, the polygon deviates from the circle
by at most 7 um."""
PRESSURE_RAD = np.deg2rad(20.0)
"""Pressure angle of the gears (ISO 53)."""
FLANK_POINTS = 6
"""Number of points along the flank of a tooth. With this number, the polygon deviates from the involute of the pinion
by at most 5 um."""

Outline: TypeAlias = Sequence[tuple[float, float]]


def polygon(points: Outline | Array) -> CrossSection:
    """Return the polygon with the vertices (N, 2), in clockwise or counter-clockwise order."""
    corners = np.asarray(points, dtype=np.float64)
    x, y = corners.T
    turn = float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
    return CrossSection([corners if turn > 0.0 else corners[::-1]])


def circle(radius: float, at: tuple[float, float] = (0.0, 0.0), *, sides: int = SIDES) -> CrossSection:
    """Return a regular polygon with its vertices on a circle."""
    return CrossSection.circle(radius, sides).translate(at)


def hole(diameter: float, at: tuple[float, float] = (0.0, 0.0)) -> CrossSection:
    """Return the outline of a screw hole.

    The outline is a regular polygon around the circle of the given diameter, so that the hole is nowhere smaller than
    the screw.
    """
    sides = 32
    return CrossSection.circle(diameter / 2.0 / np.cos(np.pi / sides), sides).translate(at)


def slot(diameter: float, start: tuple[float, float], end: tuple[float, float]) -> CrossSection:
    """Return the outline of a slotted hole with round ends.

    ``start`` and ``end`` are the centres of these ends.
    """
    return CrossSection.batch_hull([hole(diameter, start), hole(diameter, end)])


def teardrop(diameter: float, at: tuple[float, float] = (0.0, 0.0)) -> CrossSection:
    """Return the outline of a teardrop-shaped hole.

    Its roof, which is inclined by 45 degrees and points towards +y, can be printed without support.
    """
    radius = diameter / 2.0
    return CrossSection.batch_hull([circle(radius, sides=32), polygon([(-0.1, 0.0), (0.1, 0.0), (0.0, np.sqrt(2.0) * radius)])]).translate(
        at
    )


def rectangle(low: tuple[float, float], high: tuple[float, float]) -> CrossSection:
    """Return the rectangle between its lower left and upper right corner."""
    return CrossSection.square((high[0] - low[0], high[1] - low[1])).translate(low)


def rounded(width: float, height: float, radius: float) -> CrossSection:
    """Return a rectangle with rounded corners whose centre is at the origin."""
    inner = CrossSection.square((width - 2.0 * radius, height - 2.0 * radius), center=True)
    return inner.offset(radius, JoinType.Round, circular_segments=48)


def union(outlines: Iterable[CrossSection]) -> CrossSection:
    """Return the union of outlines."""
    return CrossSection.batch_boolean(list(outlines), OpType.Add)


def joined(solids: Iterable[Manifold]) -> Manifold:
    """Return the union of solids."""
    return Manifold.batch_boolean(list(solids), OpType.Add)


def raised(outline: CrossSection, low: float, high: float) -> Manifold:
    """Extrude an outline between two heights."""
    return outline.extrude(high - low).translate((0.0, 0.0, low))


def turned(points: Outline, *, sides: int = SIDES) -> Manifold:
    """Revolve an outline with vertices (radius, z) about the z axis."""
    return polygon(points).revolve(sides)


def gear(teeth: int, module_mm: float, *, backlash_mm: float) -> CrossSection:
    """Return the outline of a spur gear with involute flanks and a tooth centred on +x.

    Parameters
    ----------
    teeth : int
        Number of teeth, at least 17 to avoid undercut flanks.
    module_mm : float
        Pitch diameter divided by the number of teeth. A tooth extends 1 module above and 1.25 modules below the pitch
        circle (ISO 53).
    backlash_mm : float
        Reduction of the tooth thickness along the pitch circle.
    """
    pitch = module_mm * teeth / 2.0
    base = pitch * np.cos(PRESSURE_RAD)
    tip = pitch + module_mm
    root = pitch - 1.25 * module_mm
    half = (np.pi * module_mm / 2.0 - backlash_mm) / 2.0 / pitch  # half the tooth angle at the pitch circle, rad
    radius = np.linspace(max(base, root), tip, FLANK_POINTS)
    width = half + _involute(PRESSURE_RAD) - _involute(np.arccos(np.minimum(base / radius, 1.0)))
    radius = np.concatenate([[root], radius])
    width = np.concatenate([width[:1], width])
    angle = np.concatenate([-width, width[::-1]])
    tooth = np.concatenate([radius, radius[::-1]])
    angles = (angle[None] + (2.0 * np.pi / teeth * np.arange(teeth))[:, None]).ravel()
    radii = np.tile(tooth, teeth)
    return polygon(np.column_stack([radii * np.cos(angles), radii * np.sin(angles)]))


def _involute(angle_rad: NDArray[np.float64] | float) -> NDArray[np.float64]:
    return np.asarray(np.tan(angle_rad) - angle_rad)
