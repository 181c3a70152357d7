"""Build a watertight solid from roots.

The solid is the union of tubes around the centre lines, computed with manifold3d. Its volume is exact.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import manifold3d
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]
Faces = NDArray[np.int32]

SIDES = 24
"""Number of sides of a tube. A prism with 24 sides and the cross-sectional area of a circle is 0.3 % wider than the
circle. A prism with 16 sides is 0.6 % wider, with 8 sides 2.7 %."""
SPLIT_TURN_RAD = 2.0
"""Sum of the bend angles along a root at which a new tube begins, rad. Longer tubes could intersect themselves."""
KINK_RAD = 0.6
"""Bend angle at which a new tube begins, rad. The two tubes meet with round ends. A new tube also begins at a bend
whose radius is smaller than that of the tube."""

MOST_AT_ONCE = 250
"""Maximum number of tubes that are united in one call. Such a call neither reports progress nor can be cancelled.
Plants of the library have at most 207 tubes. Uniting as many mutually crossing tubes takes 20 s. More tubes are
united in pairs."""
LEAST_MM = 1e-3
"""Minimum diameter of a tube, mm. Smaller diameters are replaced by it, because diameters in files may taper to zero.
It has no effect on pictures or volume."""


def tube(points_mm: Array, radii_mm: Array, *, sides: int) -> tuple[Array, Faces]:
    """Return the closed surface of a tube with rounded ends.

    Parameters
    ----------
    points_mm : (N, 3) float64
        Centre line, mm, N >= 2, without coincident neighbours.
    radii_mm : (N,) float64
        Radius at each point, mm.
    sides : int
        Number of corners of a cross-section. The polygon has the area of the circle. Its corners are therefore outside
        the circle, at a radius of r sqrt(2 pi / (n sin(2 pi / n))).

    Returns
    -------
    vertices (V, 3) float64, faces (F, 3) int32
        Surface mesh, mm. Faces are counter-clockwise as seen from outside. Cross-sections follow rotation-minimising
        frames (double reflection, Wang et al. 2008, ACM TOG 27:2).
    """
    tangents = np.diff(points_mm, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    normals_to = np.concatenate([tangents[:1], tangents[:-1] + tangents[1:], tangents[-1:]])
    normals_to /= np.linalg.norm(normals_to, axis=1, keepdims=True)
    across = _transport_normals(points_mm, normals_to)
    aside = np.cross(normals_to, across)
    corner = np.sqrt(2.0 * np.pi / (sides * np.sin(2.0 * np.pi / sides)))
    cap = np.linspace(0.0, np.pi / 2.0, max(sides // 4, 2) + 1)[1:-1][::-1]  # from the pole's side to the equator
    start = points_mm[0] - radii_mm[0] * np.sin(cap)[:, None] * normals_to[0]
    end = points_mm[-1] + radii_mm[-1] * np.sin(cap[::-1])[:, None] * normals_to[-1]
    centres = np.concatenate([start, points_mm, end])
    radii = np.concatenate([radii_mm[0] * np.cos(cap), radii_mm, radii_mm[-1] * np.cos(cap[::-1])]) * corner
    n_cap = len(cap)
    across = np.concatenate([np.repeat(across[:1], n_cap, 0), across, np.repeat(across[-1:], n_cap, 0)])
    aside = np.concatenate([np.repeat(aside[:1], n_cap, 0), aside, np.repeat(aside[-1:], n_cap, 0)])
    angle = 2.0 * np.pi * np.arange(sides) / sides
    circle = np.cos(angle)[None, :, None] * across[:, None] + np.sin(angle)[None, :, None] * aside[:, None]
    rings = (centres[:, None] + radii[:, None, None] * circle).reshape(-1, 3)
    poles = np.stack([points_mm[0] - radii_mm[0] * normals_to[0], points_mm[-1] + radii_mm[-1] * normals_to[-1]])
    return np.concatenate([rings, poles]), _tube_faces(len(centres), sides)


def _transport_normals(points_mm: Array, tangents: Array) -> Array:
    """Transport a normal along a curve without twist.

    Each step consists of two reflections (Wang et al. 2008, table I). Returns normals (N, 3).
    """
    normal = np.cross(tangents[0], np.eye(3)[np.argmin(np.abs(tangents[0]))])
    normals = np.empty_like(points_mm)
    normals[0] = normal / np.linalg.norm(normal)
    for i in range(len(points_mm) - 1):
        v1 = points_mm[i + 1] - points_mm[i]
        c1 = v1 @ v1
        reflected = normals[i] - (2.0 / c1) * (v1 @ normals[i]) * v1
        tangent = tangents[i] - (2.0 / c1) * (v1 @ tangents[i]) * v1
        v2 = tangents[i + 1] - tangent
        c2 = v2 @ v2
        if c2 > 1e-24:
            reflected = reflected - (2.0 / c2) * (v2 @ reflected) * v2
        reflected -= (reflected @ tangents[i + 1]) * tangents[i + 1]
        normals[i + 1] = reflected / np.linalg.norm(reflected)
    return normals


def _tube_faces(rings: int, sides: int) -> Faces:
    """Return the triangles (F, 3) of a tube.

    They connect consecutive rings of vertices, and the two end rings with the poles, which are the last two vertices.
    """
    corner = np.arange(sides)
    after = (corner + 1) % sides
    low = (np.arange(rings - 1) * sides)[:, None]
    a, b, c, d = low + corner, low + after, low + sides + after, low + sides + corner
    last = (rings - 1) * sides
    start, end = np.full(sides, rings * sides), np.full(sides, rings * sides + 1)
    parts = [
        np.stack([a, b, c], axis=-1).reshape(-1, 3),
        np.stack([a, c, d], axis=-1).reshape(-1, 3),
        np.stack([start, after, corner], axis=-1),
        np.stack([end, last + corner, last + after], axis=-1),
    ]
    return np.concatenate(parts).astype(np.int32)


def pieces(root: Root) -> list[tuple[Array, Array]]:
    """Divide a root into tubes that do not intersect themselves.

    Each tube is a pair of points (N, 3) and radii (N,), mm.
    """
    apart = np.concatenate([[True], np.linalg.norm(np.diff(root.points_mm, axis=0), axis=1) > 1e-6])
    points_mm, radii_mm = np.asarray(root.points_mm, dtype=np.float64)[apart], np.maximum(root.diameters_mm, LEAST_MM)[apart] / 2.0
    if len(points_mm) < 2:
        return []
    steps = np.diff(points_mm, axis=0)
    lengths_mm = np.linalg.norm(steps, axis=1)
    along = steps / lengths_mm[:, None]
    bends_rad = np.arccos(np.clip(np.sum(along[:-1] * along[1:], axis=1), -1.0, 1.0))
    # the two half tubes of a bend overlap on its inside if r tan(bend / 2) exceeds a segment
    inside_mm = radii_mm[1:-1] * np.tan(np.minimum(bends_rad, 3.0) / 2.0)
    kinks = (bends_rad > KINK_RAD) | (inside_mm > 0.4 * np.minimum(lengths_mm[:-1], lengths_mm[1:]))
    cuts, turned = [0], 0.0
    for i, bend in enumerate(bends_rad, start=1):
        turned += bend
        if kinks[i - 1] or turned > SPLIT_TURN_RAD:
            cuts.append(i)
            turned = 0.0
    cuts.append(len(points_mm) - 1)
    return [(points_mm[a : b + 1], radii_mm[a : b + 1]) for a, b in pairwise(cuts)]


def unite_roots(roots: Sequence[Root], *, scale: float = 1.0, monitor: Monitor | None = None) -> manifold3d.Manifold:
    """Unite the tubes of all roots into one solid.

    All radii are multiplied by ``scale``.

    Parameters
    ----------
    roots : sequence of Root
        Roots with diameters.
    scale : float
        Scale factor of all radii.
    monitor : Monitor, optional
        Progress monitor for many roots, which may cancel the work.
    """
    tubes: list[manifold3d.Manifold] = []
    for root in roots:
        for points_mm, radii_mm in pieces(root):
            tubes.append(to_manifold(*tube(points_mm, scale * radii_mm, sides=SIDES)))
    if not tubes:
        raise UserError("The specimen is empty, because no root has a length.")
    if len(tubes) > MOST_AT_ONCE:
        with (monitor or Monitor()).steps("specimen", len(tubes) - 1, "tube") as step:
            while len(tubes) > 1:
                pairs = [manifold3d.Manifold.batch_boolean(tubes[k : k + 2], manifold3d.OpType.Add) for k in range(0, len(tubes), 2)]
                for pair in pairs[: len(tubes) // 2]:
                    pair.status()  # manifold3d evaluates unions only on request
                    step()
                tubes = pairs
    return manifold3d.Manifold.batch_boolean(tubes, manifold3d.OpType.Add)


def to_manifold(vertices: Array, faces: Faces) -> manifold3d.Manifold:
    """Convert a closed surface with vertices (V, 3) and triangles (F, 3) to a manifold3d solid.

    The caller must check its ``status()``.
    """
    mesh = manifold3d.Mesh64(vert_properties=np.ascontiguousarray(vertices, np.float64), tri_verts=np.ascontiguousarray(faces, np.uint64))
    return manifold3d.Manifold(mesh)


def to_surface(solid: manifold3d.Manifold) -> tuple[Array, Faces]:
    """Return the vertices (V, 3), float64, mm, and faces (F, 3), int32, of a solid."""
    mesh = solid.to_mesh64()
    return np.array(mesh.vert_properties[:, :3], dtype=np.float64), np.array(mesh.tri_verts, dtype=np.int32)


def invert(solid: manifold3d.Manifold) -> manifold3d.Manifold:
    """Return a solid whose surface has the opposite orientation."""
    vertices, faces = to_surface(solid)
    return to_manifold(vertices, faces[:, ::-1])


def scale_to_volume(
    roots: Sequence[Root], volume_mm3: float, *, tolerance: float = 1e-7, rounds: int = 12, monitor: Monitor | None = None
) -> tuple[manifold3d.Manifold, list[Root], float]:
    """Scale all radii by one factor so that the union of the tubes has a given volume.

    Parameters
    ----------
    roots : sequence of Root
        Roots, sorted with parents before children.
    volume_mm3 : float
        Volume of the scaled union, mm3.
    tolerance : float
        Relative tolerance of the volume. The union itself is exact.
    rounds : int
        Maximum number of iterations, each of which computes a union.
    monitor : Monitor, optional
        Progress monitor, see `unite_roots`.

    Returns
    -------
    solid, roots, factor : Manifold, list of Root, float
        Solid, roots with scaled diameters, and scale factor.

    Notes
    -----
    The secant method is applied to log volume against log factor, whose slope is slightly below 2 for thin tubes.

    Raises
    ------
    UserError
        If the volume cannot be reached by scaling these roots.
    """
    previous: tuple[float, float] | None = None
    log_scale, slope = 0.0, 2.0
    for _ in range(rounds):
        solid = unite_roots(roots, scale=float(np.exp(log_scale)), monitor=monitor)
        miss = float(np.log(solid.volume() / volume_mm3))
        if abs(miss) < tolerance:
            scale = float(np.exp(log_scale))
            return solid, [replace(root, diameters_mm=scale * np.asarray(root.diameters_mm)) for root in roots], scale
        if previous is not None and log_scale != previous[0]:
            slope = float(np.clip((miss - previous[1]) / (log_scale - previous[0]), 0.5, 4.0))
        previous = log_scale, miss
        log_scale -= float(np.clip(miss / slope, -1.5, 1.5))
    raise UserError(
        f"specimen.volume_ml {volume_mm3 / 1000.0:g} was not reached with these {len(roots)} roots in {rounds} iterations; "
        "change their number, lengths or diameters."
    )
