"""Rigid registration of one surface to another without an initial estimate.

A printed part is registered to its reconstruction with the iterative closest point algorithm (Besl and McKay 1992) from
many starting poses, with point-to-plane distances (Chen and Medioni 1992) in both directions. Distant points are
down-weighted with a Cauchy function, so that missing roots and artefacts have little influence.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from rhizotwin.recon import surface_sample
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.recon.robust import MAD
from rhizotwin.scenes import frames

Floats = NDArray[np.float64]

COARSE, MIDDLE, FINE = 500, 3_000, 20_000
"""Number of points on each surface in the three stages of the registration, which compare all starting poses, compare
the best poses, and refine the final pose. With 20 000 points, a scatter of 0.1 mm in the points causes a position error
of 0.001 mm."""
TURNS = 12
"""Number of starting poses that differ only by a rotation about the vertical, in steps of 30 degrees. The algorithm
converges if the nearest starting pose is at most 15 degrees off."""
KEPT = 4
"""Number of starting poses that are refined with more points."""
ROUNDS = 25
"""Maximum number of iterations from one starting pose. Ten to twenty are usually sufficient."""
SETTLED_MM = 1e-5
"""Motion of the solid per iteration below which the iteration stops, mm."""
CAUCHY = 2.385
"""Scale of the Cauchy weight function, as a multiple of the standard deviation of the distances. With this scale, the
estimate has 95 % efficiency for normally distributed distances (Holland and Welsch 1977)."""
LEAST_SPREAD = 1e-4
"""Lower limit for the scale of the weight function, as a fraction of the solid's size. It avoids a division by zero if
the surfaces coincide."""


@dataclass(frozen=True, kw_only=True)
class Registration:
    """Result of a registration."""

    to_from_solid: Floats
    """Rigid transform (4, 4) from the frame of the solid to the frame of the reference surface, mm."""
    moved: Mesh
    """Mesh of the solid after registration."""


@dataclass(frozen=True)
class _Cloud:
    """Points sampled uniformly on a surface, with their normals."""

    points: Floats
    """Sample points (N, 3), mm."""
    normals: Floats
    """Unit normals of the surface at the points (N, 3)."""


def register(solid: Mesh, to: Mesh) -> Registration:
    """Register a solid to another surface.

    Parameters
    ----------
    solid : Mesh
        Closed mesh, mm, in any pose but not mirrored.
    to : Mesh
        Reference surface, mm, to which the solid is registered.
    """
    size_mm = float(np.linalg.norm(np.ptp(solid.vertices_mm, axis=0)))
    poses = [np.eye(4)]  # the file of a simulated specimen has the correct pose
    for count, kept in ((COARSE, KEPT), (MIDDLE, 1), (FINE, 1)):
        cloud, cloud_to = (_sample_cloud(mesh, count) for mesh in (solid, to))
        if count == COARSE:
            poses += _starting_poses(cloud, cloud_to)
        found = [_iterate_closest_points(cloud, cloud_to, pose, size_mm=size_mm) for pose in poses]
        found.sort(key=lambda one: one[1])
        poses = [pose for pose, _ in found[:kept]]
    pose = found[0][0]
    moved = Mesh(vertices_mm=frames.apply(pose, solid.vertices_mm), faces=solid.faces)
    return Registration(to_from_solid=pose, moved=moved)


def _sample_cloud(mesh: Mesh, count: int) -> _Cloud:
    """Sample random points on a mesh.

    The random seed is fixed, so that the points of a mesh are the same in each call.
    """
    points, face = surface_sample.sample(mesh.vertices_mm, mesh.faces, count=count, rng=np.random.default_rng(0))
    a, b, c = mesh.corners_mm[:, face]
    across = np.cross(b - a, c - a)
    return _Cloud(points, across / np.maximum(np.linalg.norm(across, axis=1), 1e-300)[:, None])


def _starting_poses(cloud: _Cloud, to: _Cloud) -> list[Floats]:
    """Return the poses (4, 4) from which the registration starts.

    Some align the principal axes of both surfaces, in all combinations of signs that are rotations. Further poses are
    rotations about the vertical, upright and upside down.
    """
    middle, middle_to = cloud.points.mean(axis=0), to.points.mean(axis=0)
    axes, axes_to = (np.linalg.svd(one.points - one.points.mean(axis=0), full_matrices=False)[2].T for one in (cloud, to))
    turns = []
    for signs in product((1.0, -1.0), repeat=3):
        turn = axes_to @ np.diag(signs) @ axes.T
        if np.linalg.det(turn) > 0.0:
            turns.append(turn)
    upside = [np.eye(3), Rotation.from_euler("x", 180.0, degrees=True).as_matrix()]
    for k, up in product(range(TURNS), upside):
        turns.append(Rotation.from_euler("z", 360.0 * k / TURNS, degrees=True).as_matrix() @ up)
    poses = []
    for turn in turns:
        pose = np.eye(4)
        pose[:3, :3] = turn
        pose[:3, 3] = middle_to - turn @ middle
        poses.append(pose)
    return poses


def _iterate_closest_points(cloud: _Cloud, to: _Cloud, pose: Floats, *, size_mm: float) -> tuple[Floats, float]:
    """Refine a pose with the iterative closest point algorithm.

    Return the pose (4, 4), and the mean point-to-point distance, mm, by which poses are ranked. The median distance of
    a plant with misplaced laterals would depend on the taproot only.
    """
    tree = cKDTree(cloud.points)
    tree_to = cKDTree(to.points)
    least_mm = LEAST_SPREAD * size_mm
    mean_mm = np.inf
    for _ in range(ROUNDS):
        now = frames.apply(pose, cloud.points)
        (away, ahead), (away_back, back) = tree_to.query(now), tree.query(frames.apply(frames.invert(pose), to.points))
        mean_mm = float(np.mean(away) + np.mean(away_back)) / 2.0
        at = np.concatenate([now, now[back]])
        normals = np.concatenate([to.normals[ahead], to.normals])
        off = np.einsum("ij,ij->i", np.concatenate([to.points[ahead], to.points]) - at, normals)
        spread_mm = max(CAUCHY * MAD * float(np.median(np.abs(off))), least_mm)
        weight = 1.0 / (1.0 + (off / spread_mm) ** 2)
        middle = at.mean(axis=0)
        rows = np.concatenate([np.cross(at - middle, normals), normals], axis=1)
        normal = rows.T @ (weight[:, None] * rows)
        # directions that the surfaces do not determine are unchanged, such as rotations of a body of revolution
        step = np.linalg.pinv(normal, rcond=1e-9, hermitian=True) @ (rows.T @ (weight * off))
        change = np.eye(4)
        change[:3, :3] = Rotation.from_rotvec(step[:3]).as_matrix()
        change[:3, 3] = middle + step[3:] - change[:3, :3] @ middle
        pose = change @ pose
        if np.linalg.norm(step[3:]) + np.linalg.norm(step[:3]) * size_mm < SETTLED_MM:
            break
    return pose, mean_mm
