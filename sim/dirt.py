"""Contamination of the canister with algae films, felt fibres, air bubbles, dust and scratches.

They are drawn at random.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.model import Scene


@dataclass(frozen=True, kw_only=True)
class Patch:
    """Round algae film on the inner wall."""

    azimuth_rad: float
    """Azimuth of the film's centre, rad."""
    z_mm: float
    """Height of the film's centre, mm, canister frame."""
    radius_mm: float
    """Mean radius of the film, mm."""
    opacity: float
    """Opacity in the middle of the film, 0 to 1."""
    lobes_rad: tuple[float, ...]
    """Phases of the sinusoidal variations of the outline, rad. They have 2, 3, 4, ... periods around the film."""


@dataclass(frozen=True, kw_only=True)
class Fibre:
    """Black fibre that hangs from the felt of the net pot."""

    points_mm: NDArray[np.float64]
    """Centre line (N, 3) from the felt downwards, mm, canister frame."""
    radius_mm: float
    """Radius of the fibre, mm."""


@dataclass(frozen=True, kw_only=True)
class Bubble:
    """Air bubble in the water at the wall."""

    x_mm: float
    """x coordinate of the centre, mm, canister frame."""
    y_mm: float
    """y coordinate of the centre, mm, canister frame."""
    z_mm: float
    """z coordinate of the centre, mm, canister frame."""
    radius_mm: float
    """Radius of the bubble, mm."""


@dataclass(frozen=True, kw_only=True)
class OuterDirt:
    """Dust and scratches on the outside of the canister, which rotate with it.

    Positions are given on the unrolled wall, as azimuth (rad) and height z (mm).
    """

    specks: NDArray[np.float64]
    """Azimuth (rad), height (mm) and radius (mm) of each dust speck (N, 3)."""
    scratches: NDArray[np.float64]
    """Azimuth (rad) and height (mm) of the two ends of each scratch (M, 4)."""


SPECK_MM = 0.05, 0.25
"""Minimum and maximum radius of dust specks, mm. They represent settled airborne dust that is not wiped off. Household
dust has sizes of up to about 0.5 mm."""
SCRATCH_MM, SCRATCH_WIDE_MM, SCRATCH_OPACITY = (5.0, 30.0), 0.1, 0.5
"""Range of lengths (mm), width (mm) and opacity of scratches, in this order. The values are assumed for fine scratches
from wiping, which are half a pixel wide."""
SEAM_WIDE_MM = 1.0
"""Width of the seam, mm. It is part of the definition of the scene key ``seam_opacity``."""


def draw_outer_dirt(scene: Scene, rng: np.random.Generator) -> OuterDirt:
    """Draw dust specks and scratches.

    They are at random positions on the outside of the canister, below the skirt of the net pot.
    """
    wrong, canister = scene.disturbances, scene.canister
    low_mm, high_mm = canister.floor_z_mm, scene.net_pot.skirt_bottom_mm
    count = wrong.dust_specks
    specks = np.stack(
        [rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(low_mm, high_mm, count), rng.uniform(*SPECK_MM, count)], axis=1
    ).reshape(-1, 3)
    azimuth, z_mm = rng.uniform(0.0, 2.0 * np.pi, wrong.scratches), rng.uniform(low_mm, high_mm, wrong.scratches)
    heading, length_mm = rng.uniform(0.0, np.pi, wrong.scratches), rng.uniform(*SCRATCH_MM, wrong.scratches)
    other = azimuth + length_mm * np.cos(heading) / canister.outer_radius_mm, z_mm + length_mm * np.sin(heading)
    return OuterDirt(specks=specks, scratches=np.stack([azimuth, z_mm, *other], axis=1).reshape(-1, 4))


def outer_opacity(
    dirt: OuterDirt, *, seam_rad: float, seam_opacity: float, radius_mm: float, z_range_mm: tuple[float, float], mm_per_texel: float
) -> NDArray[np.float32]:
    """Paint dust, scratches and the seam on an unrolled wall.

    The layout is that of `opacity_map`.

    Parameters
    ----------
    dirt : OuterDirt
        Dust and scratches.
    seam_rad, seam_opacity : float
        Azimuth of the seam, rad, and fraction of light that the seam absorbs.
    radius_mm, z_range_mm : float, tuple of float
        Radius of the wall, and its lowest and highest z, mm.
    mm_per_texel : float
        Edge of a texel, mm.

    Returns
    -------
    (rows, columns) float32 array
        Opacity, 0 to 1.
    """
    low_mm, high_mm = z_range_mm
    columns, rows = round(2.0 * np.pi * radius_mm / mm_per_texel), max(8, round((high_mm - low_mm) / mm_per_texel))
    fine = 16  # OpenCV rounds coordinates to a sixteenth of a texel
    picture = np.zeros((rows, 3 * columns), np.uint8)  # three copies of the wall side by side, for shapes that cross the edge

    def place(azimuth: float, z_mm: float) -> tuple[int, int]:
        column = (np.mod(azimuth, 2.0 * np.pi) / (2.0 * np.pi) + 1.0) * columns - 0.5
        return round(fine * column), round(fine * ((high_mm - z_mm) / mm_per_texel - 0.5))

    for one, z_one, other, z_other in dirt.scratches:
        start, end = place(one, z_one), place(one, z_other)
        end = (end[0] + round(fine * (other - one) * radius_mm / mm_per_texel), end[1])
        wide = max(1, round(SCRATCH_WIDE_MM / mm_per_texel))
        cv2.line(picture, start, end, round(255 * SCRATCH_OPACITY), wide, cv2.LINE_AA, shift=4)
    for azimuth, z_mm, speck_mm in dirt.specks:
        cv2.circle(picture, place(azimuth, z_mm), round(fine * speck_mm / mm_per_texel), 255, -1, cv2.LINE_AA, shift=4)
    turns = picture.reshape(rows, 3, columns).max(axis=1) / 255.0
    across_mm = radius_mm * (np.mod((np.arange(columns) + 0.5) * 2.0 * np.pi / columns - seam_rad + np.pi, 2.0 * np.pi) - np.pi)
    seam = seam_opacity * (np.abs(across_mm) < 0.5 * SEAM_WIDE_MM)
    return np.asarray(np.maximum(turns, seam[None, :]), np.float32)


def dilate_opacity(opacity: NDArray[np.float32], *, reach_texels: int) -> NDArray[np.float32]:
    """Dilate the painted texels of an opacity map (rows, columns).

    A texel of the result is 1 if a texel within ``reach_texels`` of it along rows and columns is painted, and 0
    otherwise.
    """
    side = np.ones((2 * reach_texels + 1, 2 * reach_texels + 1), np.uint8)
    painted = np.pad((opacity > 0.0).astype(np.uint8), ((0, 0), (reach_texels, reach_texels)), mode="wrap")
    return np.asarray(cv2.dilate(painted, side)[:, reach_texels : reach_texels + opacity.shape[1]], np.float32)


def draw_algae(scene: Scene, rng: np.random.Generator) -> tuple[Patch, ...]:
    """Draw algae films on the wetted wall.

    Their radii are 2 to 8 mm, and their opacities are 50 to 100 % of the profile's opacity.
    """
    wrong = scene.disturbances
    low_mm, high_mm = scene.canister.floor_z_mm, min(scene.net_pot.grid_z_mm, scene.water.level_mm)
    return tuple(
        Patch(
            azimuth_rad=float(rng.uniform(0.0, 2.0 * np.pi)),
            z_mm=float(rng.uniform(low_mm, high_mm)),
            radius_mm=float(rng.uniform(2.0, 8.0)),
            opacity=float(wrong.algae_opacity * rng.uniform(0.5, 1.0)),
            lobes_rad=tuple(float(phase) for phase in rng.uniform(0.0, 2.0 * np.pi, 5)),
        )
        for _ in range(wrong.algae_patches)
    )


def draw_fibres(scene: Scene, rng: np.random.Generator, *, points: int = 7) -> tuple[Fibre, ...]:
    """Draw felt fibres that hang from the grid.

    They are 20 to 60 um thick, 2 to 10 mm long and randomly bent.

    Parameters
    ----------
    scene : Scene
        Scene with the number of fibres, the grid and the water.
    rng : np.random.Generator
        Random generator.
    points : int
        Number of points per fibre.

    Returns
    -------
    tuple of Fibre
        Fibres with centre lines and radii.
    """
    reach_mm = 0.9 * scene.canister.inner_radius_mm
    fibres = []
    for _ in range(scene.disturbances.felt_fibres):
        azimuth, radius_mm = rng.uniform(0.0, 2.0 * np.pi), reach_mm * np.sqrt(rng.uniform())
        step_mm = rng.uniform(2.0, 10.0) / (points - 1)
        heading = np.cumsum(np.concatenate([[[0.0, 0.0, -1.0]], rng.normal(0.0, 0.35, (points - 2, 3))]), axis=0)
        heading /= np.linalg.norm(heading, axis=1, keepdims=True)
        start = np.array([radius_mm * np.cos(azimuth), radius_mm * np.sin(azimuth), scene.net_pot.grid_z_mm])
        centreline = np.concatenate([start[None], start + np.cumsum(step_mm * heading, axis=0)])
        centreline[:, 2] = np.minimum(centreline[:, 2], scene.net_pot.grid_z_mm)
        fibres.append(Fibre(points_mm=centreline, radius_mm=float(rng.uniform(0.01, 0.03))))
    return tuple(fibres)


def draw_bubbles(scene: Scene, rng: np.random.Generator, *, wall_mm: float, gap_mm: float = 0.05) -> tuple[Bubble, ...]:
    """Draw air bubbles with radii of 0.2 to 1 mm.

    A layer of water of thickness ``gap_mm`` separates them from the wall.

    Parameters
    ----------
    scene : Scene
        Scene with the number of bubbles and the water.
    rng : np.random.Generator
        Random generator.
    wall_mm : float
        Minimum radius of the wall, mm.
    gap_mm : float
        Distance between a bubble and the wall, mm.

    Returns
    -------
    tuple of Bubble
        Bubbles with centres and radii.
    """
    low_mm, high_mm = scene.canister.floor_z_mm + 2.0, min(scene.net_pot.grid_z_mm, scene.water.level_mm) - 2.0
    bubbles = []
    for _ in range(scene.disturbances.bubbles):
        azimuth, z_mm, radius_mm = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(low_mm, high_mm), rng.uniform(0.2, 1.0)
        axis_mm = wall_mm - gap_mm - radius_mm
        bubbles.append(
            Bubble(
                x_mm=float(axis_mm * np.cos(azimuth)), y_mm=float(axis_mm * np.sin(azimuth)), z_mm=float(z_mm), radius_mm=float(radius_mm)
            )
        )
    return tuple(bubbles)


def opacity_map(
    patches: tuple[Patch, ...], *, radius_mm: float, z_range_mm: tuple[float, float], mm_per_texel: float
) -> NDArray[np.float32]:
    """Paint the opacity of algae films on an unrolled wall.

    Parameters
    ----------
    patches : tuple of Patch
        Algae films.
    radius_mm, z_range_mm : float, tuple of float
        Radius of the wall, and its lowest and highest z, mm.
    mm_per_texel : float
        Edge of a texel, mm.

    Returns
    -------
    (rows, columns) float32 array
        Opacity, 0 to 1, with row 0 at the top and column 0 at azimuth 0. The azimuth increases with the column. The
        edge of a film fades over a quarter of the film's radius.
    """
    low_mm, high_mm = z_range_mm
    columns = max(8, round(2.0 * np.pi * radius_mm / mm_per_texel))
    rows = max(8, round((high_mm - low_mm) / mm_per_texel))
    azimuth = (np.arange(columns) + 0.5) * 2.0 * np.pi / columns
    z_mm = high_mm - (np.arange(rows) + 0.5) * (high_mm - low_mm) / rows
    clear = np.ones((rows, columns))
    for patch in patches:
        across_mm = radius_mm * (np.mod(azimuth - patch.azimuth_rad + np.pi, 2.0 * np.pi) - np.pi)[None, :]
        up_mm = (z_mm - patch.z_mm)[:, None]
        heading = np.arctan2(up_mm, across_mm)
        outline = sum(0.2 / wave * np.sin(wave * heading + phase) for wave, phase in enumerate(patch.lobes_rad, start=2))
        inside = 1.0 + outline - np.hypot(across_mm, up_mm) / patch.radius_mm
        clear *= 1.0 - patch.opacity * np.clip(inside / 0.25, 0.0, 1.0)
    return (1.0 - clear).astype(np.float32)
