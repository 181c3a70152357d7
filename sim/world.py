"""Draw all disturbances of a scene, with which its pictures are rendered.

Each effect has its own random stream for each ring and view, so that each picture is independent of all others.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import frames, plan
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.model import Canister, Scene
from rhizotwin.sim.dirt import Bubble, Fibre, OuterDirt, Patch, draw_algae, draw_bubbles, draw_fibres, draw_outer_dirt
from rhizotwin.sim.exposure import stored_camera

# Second key of the random stream of each effect.
_ARM, _TABLE, _CANISTER, _STRIP, _BACKLIGHT, _ALGAE, _FIBRES, _BUBBLES = 1, 2, 3, 4, 5, 6, 7, 8
_OVAL, _SEAM, _SWAY, _OUTER, _HIGHLIGHT = 12, 13, 14, 15, 16

BACKLIGHT_MAP_WH = (64, 48)
"""Number of columns and rows of the map of the panel's radiance. A coarse map is sufficient, because the radiance
varies smoothly."""


@dataclass(frozen=True, kw_only=True)
class TrueCamera:
    """True poses of camera and canister for one picture."""

    cam_from_rig: frames.Array
    """True transform (4, 4) from the rig frame to the camera frame, mm. The camera's axes are those of OpenCV."""
    rig_from_canister: frames.Array
    """True transform (4, 4) from the canister frame to the rig frame, mm."""
    table_deg: float
    """True table angle, deg. It does not include the offset and tilt of the canister."""

    @property
    def cam_from_canister(self) -> frames.Array:
        """True transform (4, 4) from the canister frame to the camera frame, mm.

        The camera's axes are those of OpenCV.
        """
        return self.cam_from_rig @ self.rig_from_canister


@dataclass(frozen=True, kw_only=True)
class World:
    """Scene with its drawn disturbances."""

    scene: Scene
    """Scene from which the disturbances were drawn. Its rig is nominal."""
    seed: int
    """Random seed."""
    cameras: tuple[TrueCamera, ...]
    """True camera of each view of the capture plan, in order."""
    n_water: float
    """True refractive index of the water."""
    canister: Canister
    """True canister with its manufacturing errors. The canister of ``scene`` is nominal."""
    oval_rad: float
    """Azimuth of the canister's largest radius, rad."""
    seam_rad: float
    """Azimuth of the canister's seam, rad."""
    sway_mm: tuple[tuple[float, float], ...]
    """Displacement of the specimen's lowest tip along x and y in each view, mm, canister frame."""
    dirt: OuterDirt
    """Dust and scratches on the outside of the canister."""
    highlight: NDArray[np.float64] | None
    """Light that a reflection adds to the picture (H, W), as a fraction of full scale. It is None if there is no
    reflection."""
    table_from_canister: frames.Array
    """Transform (4, 4) from the canister frame to the table's frame, mm."""
    canister_from_strip: frames.Array
    """Transform (4, 4) from the frame of the marker strip to the canister frame, mm."""
    distortion: tuple[float, float, float, float, float]
    """Distortion coefficients k1, k2, p1, p2, k3 of the true lens."""
    backlight: NDArray[np.float64] | None
    """Radiance of the panel, relative to its maximum. Rows begin at the top of the panel, and columns at its -y side.
    It is None if the radiance is uniform."""
    algae: tuple[Patch, ...]
    """Algae films on the inner wall."""
    fibres: tuple[Fibre, ...]
    """Felt fibres in the water."""
    bubbles: tuple[Bubble, ...]
    """Air bubbles at the wall."""

    def drawn(self) -> dict[str, Any]:
        """Return the random values that have no field in `scenes.truth.Truth`, as a JSON object."""
        return {
            "table_from_canister": self.table_from_canister.tolist(),
            "distortion": list(self.distortion),
            "canister": vars(self.canister),
            "oval_rad": self.oval_rad,
            "seam_rad": self.seam_rad,
            "sway_mm": [list(one) for one in self.sway_mm],
            "backlight": None if self.backlight is None else self.backlight.round(4).tolist(),
            "algae": [vars(patch) for patch in self.algae],
            "fibres": [{"radius_mm": fibre.radius_mm, "points_mm": fibre.points_mm.round(4).tolist()} for fibre in self.fibres],
            "bubbles": [vars(bubble) for bubble in self.bubbles],
        }


def draw_world(scene: Scene, *, seed: int) -> World:
    """Draw the disturbances of a scene.

    Parameters
    ----------
    scene : Scene
        Scene with standard deviations and amounts in its ``disturbances``.
    seed : int
        Random seed, at least 0.

    Returns
    -------
    World
        World with its drawn disturbances. ``cam_from_canister`` of view k is ``arm error(ring) @ commanded(k) @
        table(angle + error(k)) @ table_from_canister``. The offset of the canister is that of its rim's centre, about
        which the canister is tilted.
    """
    wrong = scene.disturbances
    table_from_canister = _draw_seat(wrong.canister_offset_mm, wrong.canister_tilt_deg, _rng(seed, _CANISTER))
    cameras = tuple(_true_camera(scene, view, table_from_canister, seed) for view in plan.views(scene, seed=seed))
    return World(
        scene=scene,
        seed=seed,
        cameras=cameras,
        n_water=scene.water.n_water + wrong.n_water_error,
        canister=true_canister(scene),
        oval_rad=float(_rng(seed, _OVAL).uniform(0.0, 2.0 * np.pi)),
        seam_rad=float(_rng(seed, _SEAM).uniform(0.0, 2.0 * np.pi)),
        sway_mm=tuple(_draw_sway(wrong.sway_mm, _rng(seed, _SWAY, k)) for k in range(len(cameras))),
        dirt=draw_outer_dirt(scene, _rng(seed, _OUTER)),
        highlight=_draw_highlight(scene, _rng(seed, _HIGHLIGHT)) if wrong.highlight else None,
        table_from_canister=table_from_canister,
        canister_from_strip=_draw_seat(wrong.strip_offset_mm, wrong.strip_tilt_deg, _rng(seed, _STRIP)),
        distortion=lens_distortion(scene),
        backlight=_uneven_backlight(wrong.backlight_unevenness, _rng(seed, _BACKLIGHT)) if wrong.backlight_unevenness else None,
        algae=draw_algae(scene, _rng(seed, _ALGAE)),
        fibres=draw_fibres(scene, _rng(seed, _FIBRES)),
        bubbles=draw_bubbles(scene, _rng(seed, _BUBBLES), wall_mm=narrowest_mm(scene)),
    )


def true_canister(scene: Scene) -> Canister:
    """Return the scene's canister with its manufacturing errors."""
    drawn, wrong = scene.canister, scene.disturbances
    return replace(
        drawn,
        outer_radius_mm=drawn.outer_radius_mm + wrong.canister_radius_error_mm,
        wall_mm=drawn.wall_mm * (1.0 + wrong.wall_error),
        n_wall=drawn.n_wall + wrong.n_wall_error,
    )


def narrowest_mm(scene: Scene) -> float:
    """Return the minimum inner radius of the true canister, mm."""
    return true_canister(scene).inner_radius_mm - scene.disturbances.canister_out_of_round_mm


def _draw_sway(spread_mm: float, rng: np.random.Generator) -> tuple[float, float]:
    x, y = rng.normal(0.0, 1.0, 2) * spread_mm
    return float(x), float(y)


def _draw_highlight(scene: Scene, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the picture (H, W) of a soft vertical streak of light at a random position in front of the canister.

    The streak is the reflection of a window. A convex mirror images a window as a line along its axis.
    """
    width, height = scene.camera.image_wh
    x, y = np.arange(width) / width, np.arange(height)[:, None] / height
    middle, below = rng.uniform(0.35, 0.65), rng.uniform(0.5, 0.8)
    across, along = (x - middle) / 0.006, (y - below) / 0.12
    return np.asarray(scene.disturbances.highlight * np.exp(-0.5 * (across**2 + along**4)))


def lens_distortion(scene: Scene) -> tuple[float, float, float, float, float]:
    """Return the distortion coefficients k1, k2, p1, p2, k3 of the true lens.

    They are the sums of those of the scene's camera and of the disturbance profile.
    """
    k1, k2, p1, p2, k3 = (a + b for a, b in zip(scene.camera.distortion, scene.disturbances.distortion, strict=True))
    return k1, k2, p1, p2, k3


def scene_for_reconstruction(scene: Scene) -> Scene:
    """Return the scene as it is known to the reconstruction.

    It contains the nominal rig, the calibrated lens and the positions of plants, but no specimen.
    """
    camera = replace(stored_camera(scene.camera, scene.disturbances), distortion=lens_distortion(scene))
    plants = tuple(replace(plant, specimen=None) for plant in scene.plants)
    return replace(scene, description="", camera=camera, specimen=None, plants=plants, shoot=None, disturbances=Disturbances())


def _rng(seed: int, effect: int, *keys: int) -> np.random.Generator:
    return np.random.default_rng([seed, effect, *keys])


def _true_camera(scene: Scene, view: plan.View, table_from_canister: frames.Array, seed: int) -> TrueCamera:
    wrong = scene.disturbances
    arm = _rng(seed, _ARM, view.ring)
    turn_rad = np.deg2rad(arm.normal(0.0, 1.0, 3) * wrong.arm_deg)
    shift_mm = arm.normal(0.0, 1.0, 3) * wrong.arm_mm
    table_deg = view.table_deg + float(_rng(seed, _TABLE, view.index).normal(0.0, 1.0)) * wrong.table_deg
    return TrueCamera(
        cam_from_rig=frames.from_rotvec(turn_rad, shift_mm) @ view.cam_from_rig,
        rig_from_canister=plan.rig_from_table(scene, table_deg) @ table_from_canister,
        table_deg=table_deg,
    )


def _draw_seat(offset_mm: float, tilt_deg: float, rng: np.random.Generator) -> frames.Array:
    """Return a transform (4, 4), mm, that displaces and tilts a part in random directions."""
    offset_rad, lean_rad = rng.uniform(0.0, 2.0 * np.pi, 2)
    shift_mm = offset_mm * np.array([np.cos(offset_rad), np.sin(offset_rad), 0.0])
    return frames.from_rotvec(np.deg2rad(tilt_deg) * np.array([np.cos(lean_rad), np.sin(lean_rad), 0.0]), shift_mm)


def _uneven_backlight(peak_to_peak: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a smooth random map of the panel's relative radiance (rows, columns).

    The values are from ``1 - peak_to_peak`` to 1.
    """
    columns, rows = BACKLIGHT_MAP_WH
    y, x = np.meshgrid(np.linspace(0.0, 1.0, rows), np.linspace(0.0, 1.0, columns), indexing="ij")
    field = np.zeros((rows, columns))
    for order_x in range(3):
        for order_y in range(3):
            amplitude, phase_x, phase_y = rng.normal(), *rng.uniform(0.0, 2.0 * np.pi, 2)
            if order_x or order_y:
                field += amplitude / (1 + order_x + order_y) * np.cos(np.pi * order_x * x + phase_x) * np.cos(np.pi * order_y * y + phase_y)
    span = float(np.ptp(field))
    return np.asarray(1.0 - peak_to_peak * (field - field.min()) / span)
