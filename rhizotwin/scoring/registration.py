"""Lay one surface onto another by a turn and a shift, with nothing known of where it was.

So the printed part is laid onto what was found of it: iterated closest points (Besl and McKay 1992) from many starts,
with distances to the other surface's tangent planes (Chen and Medioni 1992), both ways at once, and less weight to what
lies far off (Cauchy): missing roots and ghosts do not pull.
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
"""Points on each surface: to choose among the starts, among the best of them, and to settle the best. With 20 000 the
error of a place that 0.1 mm of scatter leaves is 1 um."""
TURNS = 12
"""Starts about each upright axis, 30 degrees apart: closest points find their way from half of that."""
KEPT = 4
"""Starts that are followed with more points."""
ROUNDS = 25
"""Closest points settle in ten to twenty."""
SETTLED_MM = 1e-5
"""A step that moves no point farther than this is the last."""
CAUCHY = 2.385
"""95 % efficiency on normal errors (Holland and Welsch 1977)."""
LEAST_SPREAD = 1e-4
"""Part of the solid's size below which distances are not told apart: it keeps the weights from dividing by nothing."""


@dataclass(frozen=True, kw_only=True)
class Registration:
    """Where a solid lies."""

    to_from_solid: Floats
    """(4, 4) rigid: from the solid's own coordinates to those of what it was laid onto."""
    moved: Mesh
    """The solid there."""


@dataclass(frozen=True)
class _Cloud:
    """Points evenly over a surface, with its normals there."""

    points: Floats
    normals: Floats


def register(solid: Mesh, to: Mesh) -> Registration:
    """Lay a solid onto another surface.

    Parameters
    ----------
    solid : Mesh
        Closed, in mm, anywhere and turned anyhow, but not mirrored.
    to : Mesh
        What it is laid onto.
    """
    size_mm = float(np.linalg.norm(np.ptp(solid.vertices_mm, axis=0)))
    poses = [np.eye(4)]  # it may lie right: a simulated specimen's own file
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
    """Spread points over a mesh, the same at every call."""
    points, face = surface_sample.sample(mesh.vertices_mm, mesh.faces, count=count, rng=np.random.default_rng(0))
    a, b, c = mesh.corners_mm[:, face]
    across = np.cross(b - a, c - a)
    return _Cloud(points, across / np.maximum(np.linalg.norm(across, axis=1), 1e-300)[:, None])


def _starts(cloud: _Cloud, to: _Cloud) -> list[Floats]:
    """Return poses (4, 4) to start from.

    Principal axes laid on each other in every proper way, and turns about the upright, either end up.
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
    """Return the pose that closest points lead to, and the mean distance from point to point there.

    The mean ranks poses: in a plant whose roots lie wrong the median would still be the taproot's.
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
        # a body of revolution turns freely: what the surfaces do not tell is left as it is
        step = np.linalg.pinv(normal, rcond=1e-9, hermitian=True) @ (rows.T @ (weight * off))
        change = np.eye(4)
        change[:3, :3] = Rotation.from_rotvec(step[:3]).as_matrix()
        change[:3, 3] = middle + step[3:] - change[:3, :3] @ middle
        pose = change @ pose
        if np.linalg.norm(step[3:]) + np.linalg.norm(step[:3]) * size_mm < SETTLED_MM:
            break
    return pose, mean_mm
