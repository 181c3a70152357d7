"""Shapes and surfaces of the rig, for Mitsuba: walls, plates, meshes and tubes, in mm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import frames
from rhizotwin.sim import dirt

OVAL_SIDES = 1440
"""Number of facets of an oval wall. The facets deviate from the oval by at most 0.2 um. Their normals are exact."""


def oval_wall(
    radius_mm: float, oval_mm: float, oval_rad: float, z_range_mm: tuple[float, float], bsdf: dict[str, Any], interior: Any
) -> mi.Mesh:
    """Return a vertical wall with exact normals.

    Its radius is ``radius_mm + oval_mm cos(2 (azimuth - oval_rad))``.

    Parameters
    ----------
    radius_mm, oval_mm, oval_rad : float
        Mean radius and amplitude, mm, and azimuth of the largest radius, rad.
    z_range_mm : tuple of float
        Heights of the lower and the upper edge, mm.
    bsdf : dict
        Surface.
    interior : Medium or None
        Medium inside.
    """
    azimuth = np.arange(OVAL_SIDES) * 2.0 * np.pi / OVAL_SIDES
    radius = radius_mm + oval_mm * np.cos(2.0 * (azimuth - oval_rad))
    slope = -2.0 * oval_mm * np.sin(2.0 * (azimuth - oval_rad))
    c, s = np.cos(azimuth), np.sin(azimuth)
    ring, out = np.stack([radius * c, radius * s], axis=1), np.stack([radius * c + slope * s, radius * s - slope * c], axis=1)
    normals = np.tile(np.column_stack([out / np.linalg.norm(out, axis=1, keepdims=True), np.zeros(OVAL_SIDES)]), (2, 1))
    return mesh(f"oval_{radius_mm:g}_{z_range_mm[0]:g}", *_extrude(ring, z_range_mm), bsdf, Media(interior=interior), normals=normals)


def plane_walls(half_mm: tuple[float, float], z_range_mm: tuple[float, float], bsdf: dict[str, Any], interior: Any) -> mi.Mesh:
    """Return the four vertical walls of a box about the axis, with outward normals.

    Parameters
    ----------
    half_mm : tuple of float
        Half the widths along x and y, mm.
    z_range_mm : tuple of float
        Heights of the lower and the upper edge, mm.
    bsdf : dict
        Surface.
    interior : Medium or None
        Medium inside.
    """
    (x, y), name = half_mm, f"plane_{half_mm[0]:g}_{z_range_mm[0]:g}"
    ring = np.array([[x, -y], [x, y], [-x, y], [-x, -y]])
    return mesh(name, *_extrude(ring, z_range_mm), bsdf, Media(interior=interior))


def _extrude(ring_mm: NDArray[np.float64], z_range_mm: tuple[float, float]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the vertices and the faces of a vertical wall over a closed polygon (N, 2), mm."""
    count = len(ring_mm)
    a = np.arange(count)
    b = (a + 1) % count
    vertices = np.concatenate([np.column_stack([ring_mm, np.full(count, z)]) for z in z_range_mm])
    return vertices, np.concatenate([np.stack([a, b, b + count], axis=1), np.stack([a, b + count, a + count], axis=1)])


def plate(half_mm: tuple[float, float], z_mm: float, bsdf: dict[str, Any]) -> dict[str, Any]:
    """Return a horizontal rectangle about the axis, whose normal points upwards.

    Parameters
    ----------
    half_mm : tuple of float
        Half the widths along x and y, mm.
    z_mm : float
        Height, mm.
    bsdf : dict
        Surface.
    """
    local = frames.translation(0.0, 0.0, z_mm) @ np.diag([*half_mm, 1.0, 1.0])
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f(local), "bsdf": bsdf}


@dataclass(frozen=True, kw_only=True)
class Media:
    """Media on both sides of a surface; None for a medium without attenuation."""

    interior: Any = None
    exterior: Any = None


def mesh(
    name: str,
    vertices: NDArray[Any],
    faces: NDArray[Any],
    bsdf: dict[str, Any],
    media: Media = Media(),
    *,
    normals: NDArray[Any] | None = None,
) -> mi.Mesh:
    """Return a triangle mesh with a surface, and media on both sides.

    Parameters
    ----------
    name : str
        Name of the shape in the scene.
    vertices, faces : (V, 3) float array, (F, 3) int array
        Triangles, mm.
    bsdf : dict
        Surface.
    media : Media
        Media inside and outside.
    normals : (V, 3) float array, optional
        Unit normals at the vertices; by default, the triangles are flat.
    """
    props = mi.Properties()
    props["bsdf"] = mi.load_dict(bsdf)
    for side, medium in vars(media).items():
        if medium is not None:
            props[side] = medium
    smooth = normals is not None
    mesh = mi.Mesh(name, vertex_count=len(vertices), face_count=len(faces), props=props, has_vertex_normals=smooth)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.ascontiguousarray(vertices, dtype=np.float32).ravel()
    parameters["faces"] = np.ascontiguousarray(faces, dtype=np.uint32).ravel()
    if normals is not None:
        parameters["vertex_normals"] = np.ascontiguousarray(normals, dtype=np.float32).ravel()
    parameters.update()
    mesh.set_id(name)
    return mesh


def fibre_tubes(fibres: tuple[dirt.Fibre, ...], *, sides: int = 6) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the vertices (V, 3), mm, and faces (F, 3) of tubes around the centre lines of fibres.

    The tubes are open at both ends.
    """
    vertices, faces, start = [], [], 0
    turn = np.arange(sides) * 2.0 * np.pi / sides
    for fibre in fibres:
        count = len(fibre.points_mm)
        tangent = np.gradient(fibre.points_mm, axis=0)
        across = np.cross(tangent, [1.0, 0.0, 0.0])
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
        other = np.cross(tangent, across)
        other /= np.maximum(np.linalg.norm(other, axis=1, keepdims=True), 1e-9)
        ring = np.cos(turn)[None, :, None] * across[:, None] + np.sin(turn)[None, :, None] * other[:, None]
        vertices.append((fibre.points_mm[:, None] + fibre.radius_mm * ring).reshape(-1, 3))
        i, j = (a.ravel() for a in np.meshgrid(np.arange(count - 1), np.arange(sides), indexing="ij"))
        a, b = start + i * sides + j, start + i * sides + (j + 1) % sides
        faces += [np.stack([a, b, b + sides], axis=1), np.stack([a, b + sides, a + sides], axis=1)]
        start += count * sides
    return np.concatenate(vertices), np.concatenate(faces).astype(np.int32)


def cylinder(radius_mm: float, low_mm: float, high_mm: float, bsdf: dict[str, Any], seat: frames.Array | None = None) -> dict[str, Any]:
    """Return a vertical wall around the axis, open at both ends.

    Parameters
    ----------
    radius_mm, low_mm, high_mm : float
        Radius and heights of both edges, mm.
    bsdf : dict
        Surface.
    seat : (4, 4) float64 array, optional
        Pose of the axis in the canister frame.
    """
    local = frames.translation(0.0, 0.0, low_mm) @ np.diag([radius_mm, radius_mm, high_mm - low_mm, 1.0])
    to_world = local if seat is None else seat @ local
    return {"type": "cylinder", "to_world": mi.ScalarTransform4f(to_world), "bsdf": bsdf}


def disk(radius_mm: float, z_mm: float, bsdf: dict[str, Any], seat: frames.Array | None = None) -> dict[str, Any]:
    """Return a horizontal disk about the axis, whose normal points upwards.

    Parameters
    ----------
    radius_mm, z_mm : float
        Radius and height, mm.
    bsdf : dict
        Surface.
    seat : (4, 4) float64 array, optional
        Pose of the axis in the canister frame.
    """
    local = frames.translation(0.0, 0.0, z_mm) @ np.diag([radius_mm, radius_mm, 1.0, 1.0])
    to_world = local if seat is None else seat @ local
    return {"type": "disk", "to_world": mi.ScalarTransform4f(to_world), "bsdf": bsdf}


def dielectric(n_inside: float, n_outside: float) -> dict[str, Any]:
    """Return a smooth dielectric interface.

    ``n_outside`` is the refractive index on the side to which the surface's normal points.
    """
    return {"type": "dielectric", "int_ior": n_inside, "ext_ior": n_outside}


def diffuse(reflectance: float) -> dict[str, Any]:
    """Return a matt surface."""
    return {"type": "diffuse", "reflectance": reflectance}
