"""Simulate pictures of the calibration board.

The board is in air, uniformly lit, and imaged with the true lens parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rhizotwin.scenes import frames
from rhizotwin.scenes.atomic import write_image, write_json
from rhizotwin.scenes.board import CharucoBoard, black_parts, check_board, save_board
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import new_folder
from rhizotwin.scenes.model import Camera, Scene
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.schema import to_plain
from rhizotwin.sim import sensor
from rhizotwin.sim.exposure import expose
from rhizotwin.sim.strip import INK, PAPER
from rhizotwin.sim.textures import bitmap
from rhizotwin.sim.world import lens_distortion

BORDER_MM = 12.0
"""Width of the white margin around the pattern, mm."""
TEXELS_PER_MM = 12.0
"""Number of texels per mm of the painted pattern. A texel is a third of a pixel of a camera with 800x600 pixels."""
MOST_TEXELS = 6000
"""Maximum number of texels along the longer side of the painted pattern. Larger boards are painted with a lower
resolution."""
SIDE = 7
"""Number of rays per pixel in each direction. The rays form a regular lattice. `_lens_positions` requires a prime
number."""
MAX_RAYS = 8_000_000
"""Maximum number of rays per kernel launch. It is the same as in `sim.render`."""
LEAST_VISIBLE = 0.6
"""Minimum fraction of the board's corners that must be visible in a picture."""
LEAST_SQUARE_PX = 20.0
"""Minimum edge of a square in the picture, pixels. A marker has 3/4 of this edge, and OpenCV needs 2 pixels for each of
the marker's 6 modules."""
ATTEMPTS = 300
"""Maximum number of random poses that are drawn for a picture. The first pose that shows enough of the board is used,
and a few attempts are usually sufficient."""
TRUTH = Path("truth") / "camera.json"
"""Path of the file with the true camera and poses, relative to the folder of the pictures."""
_POSE, _NOISE = 41, 42  # keys of the random streams


@dataclass(frozen=True, kw_only=True)
class BoardPictures:
    """True camera and true poses of the simulated pictures of a board."""

    camera: Camera
    """True camera of the simulated pictures, with its distortion."""
    cam_from_board: dict[str, frames.Array]
    """Transforms (4, 4) from the board's frame to the camera frame, mm, keyed by file name."""


def simulate_board(
    scene: Scene, board: CharucoBoard, folder: Path, *, pictures: int = 20, seed: int = 0, monitor: Monitor | None = None
) -> BoardPictures:
    """Render pictures of a board to a new folder, together with ``board.toml`` and ``truth/camera.json``.

    Parameters
    ----------
    scene : Scene
        Scene whose camera, working distance of the first ring, and ``disturbances`` (distortion, aperture, focus and
        noise) are used.
    board : CharucoBoard
        Printed board.
    folder : Path
        New or empty folder, which is written atomically.
    pictures : int
        Number of pictures. The files are board_000.png, board_001.png and so on.
    seed : int
        Random seed for poses and noise. A picture does not depend on the number of pictures.
    monitor : Monitor, optional
        Progress monitor.

    Returns
    -------
    BoardPictures
        True camera and true poses.

    Raises
    ------
    UserError
        If the board is too large or too small for the camera, or the folder is not empty.
    """
    check_board(board)
    camera = true_camera(scene)
    poses = {f"board_{k:03d}.png": draw_pose(scene, board, seed=seed, index=k) for k in range(pictures)}
    renderer = BoardRenderer(scene, board)
    monitor = monitor or Monitor()
    with new_folder(folder) as building, monitor.stage("render"), monitor.steps("render", pictures, "picture") as step:
        for k, (name, cam_from_board) in enumerate(poses.items()):
            rng = np.random.default_rng([seed, _NOISE, k])
            write_image(building / name, expose(renderer.light(cam_from_board), camera, scene.disturbances, rng=rng))
            step()
        save_board(board, building / "board.toml")
        views = {name: cam_from_board.tolist() for name, cam_from_board in poses.items()}
        write_json(building / TRUTH, {"camera": to_plain(camera), "seed": seed, "cam_from_board": views})
    return BoardPictures(camera=camera, cam_from_board=poses)


def true_camera(scene: Scene) -> Camera:
    """Return the scene's camera with the true distortion of its lens.

    The ``focal_error`` of a profile is not applied, because the error arises after the calibration.
    """
    return replace(scene.camera, distortion=lens_distortion(scene))


def working_distance_mm(scene: Scene) -> float:
    """Return the distance from the camera to the table's axis, mm.

    It is measured along the optical axis in the first ring.
    """
    ring = scene.plan.rings[0]
    return float(ring.distance_mm / np.cos(np.deg2rad(ring.tilt_deg)))


def draw_pose(scene: Scene, board: CharucoBoard, *, seed: int, index: int) -> frames.Array:
    """Draw a random pose ``cam_from_board`` for a picture.

    The board is rotated by multiples of 90 degrees, tilted in all directions, and placed at any position in the
    picture.

    Parameters
    ----------
    scene : Scene
        Scene with camera and working distance.
    board : CharucoBoard
        Board that must be visible.
    seed, index : int
        Random seed of the series, and index of the picture.

    Returns
    -------
    (4, 4) array
        First random pose in which a sufficient part of the board is visible.
    """
    camera, rng = true_camera(scene), np.random.default_rng([seed, _POSE, index])
    middle_mm, corners_mm = np.array([*board.size_mm, 0.0]) / 2.0, board.corners_mm
    best = 0.0
    for _ in range(ATTEMPTS):
        tilt_rad = np.deg2rad(rng.uniform(0.0, 10.0) if index % 5 == 0 else rng.uniform(20.0, 45.0))
        towards_rad = 2.399963 * index + rng.uniform(0.0, 1.0)  # multiples of the golden angle distribute the directions of the tilt evenly
        roll_rad = np.deg2rad(90.0 * (index % 4) + rng.normal(0.0, 8.0))
        turn = Rotation.from_rotvec(tilt_rad * np.array([np.cos(towards_rad), np.sin(towards_rad), 0.0])) * Rotation.from_rotvec(
            [0.0, 0.0, roll_rad]
        )
        depth_mm = working_distance_mm(scene) * rng.uniform(0.8, 1.15)
        at_px = (rng.uniform(0.2, 0.8, 2)) * np.array(camera.image_wh)
        towards = np.append((at_px - camera.principal_px) / camera.focal_px, 1.0)
        cam_from_board = frames.from_rotation_translation(turn.as_matrix(), towards * depth_mm - turn.apply(middle_mm))
        share = _visible(camera, cam_from_board, corners_mm)
        if share >= LEAST_VISIBLE:
            square_px = camera.focal_px[0] * board.square_mm / depth_mm
            if square_px < LEAST_SQUARE_PX:
                raise UserError(
                    f"the board's squares of {board.square_mm:g} mm are only {square_px:.0f} px wide at the working distance of "
                    f"{working_distance_mm(scene):.0f} mm, but at least {LEAST_SQUARE_PX:g} px are needed; use larger squares (--square-mm)"
                )
            return cam_from_board
        best = max(best, share)
    (wide_mm, high_mm), depth = board.size_mm, working_distance_mm(scene)
    raise UserError(
        f"the board of {wide_mm:g} x {high_mm:g} mm is too large for the camera at {depth:.0f} mm: at most {best:.0%} of its corners "
        f"are in the picture, but {LEAST_VISIBLE:.0%} are needed; use fewer or smaller squares"
    )


def _visible(camera: Camera, cam_from_board: frames.Array, corners_mm: frames.Array) -> float:
    """Return the fraction of the board's corners that are inside the picture.

    It is zero if a corner is close to or behind the camera.
    """
    at_cam = frames.apply(cam_from_board, corners_mm)
    if at_cam[:, 2].min() < 0.4 * at_cam[:, 2].mean():
        return 0.0
    pixels = project(camera, cam_from_board, corners_mm)
    return float(np.mean(np.all((pixels > 4.0) & (pixels < np.array(camera.image_wh) - 5.0), axis=1)))


def project(camera: Camera, cam_from_board: frames.Array, points_mm: frames.Array) -> frames.Array:
    """Project points (N, 3) on the board to pixels (N, 2). Pixel centres have integer coordinates.

    Parameters
    ----------
    camera : Camera
        Camera with distortion.
    cam_from_board : (4, 4) array
        Pose of the board, mm.
    points_mm : (N, 3) array
        Points in the board's frame, mm.

    Returns
    -------
    (N, 2) array
        Pixel coordinates.
    """
    (fx, fy), (cx, cy) = camera.focal_px, camera.principal_px
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    found, _ = cv2.projectPoints(
        points_mm, frames.to_rotvec(cam_from_board), cam_from_board[:3, 3].copy(), matrix, np.array(camera.distortion)
    )
    return np.asarray(found, np.float64).reshape(-1, 2)


class BoardRenderer:
    """Renderer of the board as seen by a scene's camera."""

    def __init__(self, scene: Scene, board: CharucoBoard) -> None:
        wide_mm, high_mm = (side + 2.0 * BORDER_MM for side in board.size_mm)
        board_from_rectangle = np.diag([wide_mm / 2.0, -high_mm / 2.0, -1.0, 1.0])
        board_from_rectangle[:2, 3] = np.array(board.size_mm) / 2.0
        paper = {"type": "diffuse", "reflectance": bitmap(board_picture(board), wrap="clamp")}
        rectangle = {"type": "rectangle", "to_world": mi.ScalarTransform4f(board_from_rectangle), "bsdf": paper}
        self.board = mi.load_dict({"type": "scene", "board": rectangle})
        self.level = scene.lights.front_level / PAPER
        self.image_wh = scene.camera.image_wh
        wrong = scene.disturbances
        self.eye = mi.load_dict(
            sensor.sensor_dict(
                scene.camera,
                distortion=lens_distortion(scene),
                aperture_mm=wrong.aperture_mm,
                focus_mm=working_distance_mm(scene) + wrong.focus_error_mm,
            )
        )

    def light(self, cam_from_board: frames.Array) -> NDArray[np.float32]:
        """Render a picture of linear light (H, W), as a fraction of full scale.

        Pixels outside the board are black. The illumination is uniform from all directions. The radiance of the matt
        paper is therefore proportional to its reflectance, without shadows and without random numbers.
        """
        sensor.set_pose(self.eye, cam_from_board)
        width, height = self.image_wh
        rows = max(1, MAX_RAYS // (width * SIDE * SIDE))
        image = np.empty((height, width), np.float32)
        for first in range(0, height, rows):
            count = min(rows, height - first)
            index = dr.arange(mi.UInt32, count * width * SIDE * SIDE)
            pixel, ray = index // (SIDE * SIDE), index % (SIDE * SIDE)
            u = (mi.Float(pixel % width) + (mi.Float(ray % SIDE) + 0.5) / SIDE) / width
            v = (mi.Float(pixel // width) + dr.opaque(mi.Float, first) + (mi.Float(ray // SIDE) + 0.5) / SIDE) / height
            primary, _ = self.eye.sample_ray(0.0, 0.0, mi.Point2f(u, v), _lens_positions(ray))
            hit = self.board.ray_intersect(primary)
            seen = hit.bsdf(primary).eval_diffuse_reflectance(hit, hit.is_valid())
            light = dr.select(hit.is_valid(), seen[0], 0.0)
            image[first : first + count] = np.array(dr.block_sum(light, SIDE * SIDE)).reshape(count, width) / SIDE**2
        return image * np.float32(self.level)


def board_picture(board: CharucoBoard) -> NDArray[np.float32]:
    """Return the reflectance of the board and its white margin as an array (rows, columns).

    Each value is an average over a texel. Row 0 is at the top.
    """
    wide_mm, high_mm = (side + 2.0 * BORDER_MM for side in board.size_mm)
    scale = min(TEXELS_PER_MM, MOST_TEXELS / max(wide_mm, high_mm))
    columns, rows = round(wide_mm * scale), round(high_mm * scale)
    x_mm, y_mm = np.linspace(0.0, wide_mm, columns + 1) - BORDER_MM, np.linspace(0.0, high_mm, rows + 1) - BORDER_MM
    black = np.zeros((rows, columns), np.float32)
    for left, top, right, bottom in black_parts(board):
        (i, across), (j, down) = _coverage(x_mm, left, right), _coverage(y_mm, top, bottom)
        black[j, i] += np.outer(down, across).astype(np.float32)
    return (PAPER + (INK - PAPER) * black).astype(np.float32)


def _coverage(edges: frames.Array, low: float, high: float) -> tuple[slice, frames.Array]:
    """Return the range of texels that overlap an interval, and the covered fraction of each of them.

    The boundaries of the texels are ``edges``, in ascending order.
    """
    first, last = int(np.searchsorted(edges, low, "right")) - 1, int(np.searchsorted(edges, high, "left"))
    low_edges, high_edges = edges[first:last], edges[first + 1 : last + 1]
    return slice(first, last), (np.minimum(high_edges, high) - np.maximum(low_edges, low)) / (high_edges - low_edges)


def _lens_positions(ray: mi.UInt32) -> mi.Point2f:
    """Return the position on the lens of each ray of a pixel's lattice, as two coordinates from 0 to 1.

    The two coordinates on the lens and the two coordinates in the pixel form an orthogonal array, because SIDE is
    prime. All pairs of coordinates are uncorrelated, so that blur causes no displacement.
    """
    a, b = ray % SIDE, ray // SIDE
    return mi.Point2f((mi.Float((a + b) % SIDE) + 0.5) / SIDE, (mi.Float((a + 2 * b) % SIDE) + 0.5) / SIDE)
