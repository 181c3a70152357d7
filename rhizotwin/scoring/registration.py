"""Rigid registration of one surface to another without an initial estimate.

It registers a printed part to its reconstruction by iterated closest points (Besl and McKay 1992) from many starting
poses, with point-to-plane distances (Chen and Medioni 1992) in both directions. Distant points have less weight
(Cauchy), so that missing roots and artefacts have little influence.
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
"""Number of points on each surface for: selection among all starts, selection among the best starts, and final
registration. With 20 000 points, scatter of 0.1 mm causes a position error of 1 um."""
TURNS = 12
"""Starts about each vertical axis, 30 degrees apart; the iteration converges from half of this."""
KEPT = 4
"""Number of starts refined with more points."""
ROUNDS = 25
"""Maximum number of iterations; ten to twenty usually suffice."""
SETTLED_MM = 1e-5
"""The iteration ends when no point moves farther than this."""
CAUCHY = 2.385
"""95 % efficiency on normal errors (Holland and Welsch 1977)."""
LEAST_SPREAD = 1e-4
"""Lower limit of the distance scale relative to the size of the solid; it avoids division by zero."""


@dataclass(frozen=True, kw_only=True)
class Registration:
    """Result of a registration."""

    to_from_solid: Floats
    """(4, 4) rigid motion from the coordinates of the solid to those of the other surface."""
    moved: Mesh
    """Registered solid."""


@dataclass(frozen=True)
class _Cloud:
    """Uniformly distributed points on a surface, with their normals."""

    points: Floats
    normals: Floats


def register(solid: Mesh, to: Mesh) -> Registration:
    """Register a solid to another surface.

    Parameters
    ----------
    solid : Mesh
        Closed mesh in mm, in any pose, not mirrored.
    to : Mesh
        Surface to register to.
    """
    size_mm = float(np.linalg.norm(np.ptp(solid.vertices_mm, axis=0)))
    poses = [np.eye(4)]  # the pose may already be correct, as for the file of a simulated specimen
    for count, kept in ((COARSE, KEPT), (MIDDLE, 1), (FINE, 1)):
        cloud, cloud_to = (_cloud(mesh, count) for mesh in (solid, to))
        if count == COARSE:
            poses += _starts(cloud, cloud_to)
        found = [_settled(cloud, cloud_to, pose, size_mm=size_mm) for pose in poses]
        found.sort(key=lambda one: one[1])
        poses = [pose for pose, _ in found[:kept]]
    pose = found[0][0]
    moved = Mesh(vertices_mm=frames.apply(pose, solid.vertices_mm), faces=solid.faces)
    return Registration(to_from_solid=pose, moved=moved)


def _cloud(mesh: Mesh, count: int) -> _Cloud:
    """Sample points on a mesh, identical in each call."""
    points, face = surface_sample.sample(mesh.vertices_mm, mesh.faces, count=count, rng=np.random.default_rng(0))
    a, b, c = mesh.corners_mm[:, face]
    across = np.cross(b - a, c - a)
    return _Cloud(points, across / np.maximum(np.linalg.norm(across, axis=1), 1e-300)[:, None])


def _starts(cloud: _Cloud, to: _Cloud) -> list[Floats]:
    """Return starting poses (4, 4).

    Principal axes are aligned in every proper combination, and rotations about the vertical are added, for both ends
    up.
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
        pose[:3, :3], pose[:3, 3] = turn, middle_to - turn @ middle
        poses.append(pose)
    return poses


def _settled(cloud: _Cloud, to: _Cloud, pose: Floats, *, size_mm: float) -> tuple[Floats, float]:
    """Iterate closest points; return the pose and the mean point-to-point distance.

    Poses are ranked by the mean: for a plant with misplaced laterals, the median would depend on the taproot only.
    """
    tree, tree_to, least_mm, mean_mm = cKDTree(cloud.points), cKDTree(to.points), LEAST_SPREAD * size_mm, np.inf
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
        # a body of revolution can rotate freely; directions that the surfaces do not determine are left unchanged
        step = np.linalg.pinv(normal, rcond=1e-9, hermitian=True) @ (rows.T @ (weight * off))
        change = np.eye(4)
        change[:3, :3] = Rotation.from_rotvec(step[:3]).as_matrix()
        change[:3, 3] = middle + step[3:] - change[:3, :3] @ middle
        pose = change @ pose
        if np.linalg.norm(step[3:]) + np.linalg.norm(step[:3]) * size_mm < SETTLED_MM:
            break
    return pose, mean_mm
