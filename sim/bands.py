"""Scenes in one band of the camera: light, leaves, roots and water at the band's wavelength."""

from dataclasses import replace

import numpy as np

from rhizotwin.scenes.bands import Band, bands_by_range, vegetation_indices
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.shoots import Shoot

WATER_PER_M = (
    (400.0, 0.007),
    (450.0, 0.009),
    (500.0, 0.020),
    (550.0, 0.057),
    (600.0, 0.22),
    (650.0, 0.34),
    (700.0, 0.62),
    (750.0, 2.6),
    (800.0, 2.0),
    (850.0, 4.3),
    (900.0, 6.5),
    (950.0, 39.0),
    (975.0, 45.0),
    (1000.0, 36.0),
)
"""Absorption of pure water by wavelength (nm): Pope and Fry 1997 (Appl. Opt. 36:8710) up to 700 nm, Kou et al. 1993
(Appl. Opt. 32:3531) beyond, rounded."""
MU_NM = 550.0
"""Wavelength of the profile's ``root_mu_per_mm``."""
MU_POWER = -1.0
"""Exponent of the wavelength dependence of root attenuation, which is caused by scattering (soft tissue has -0.7 to
-1.5: Jacques 2013, Phys. Med. Biol. 58:R37, table 1)."""


def scene_in_band(scene: Scene, name: str) -> Scene:
    """Return the scene in the band of that name, as a scene with a single band; for an empty name the scene itself.

    Pictures of a band are grey, so that white-balance variations are disabled.
    """
    if not name:
        return scene
    band = next(band for band in scene.camera.bands if band.name == name)
    wrong = scene.disturbances
    mu = wrong.root_mu_per_mm
    return replace(
        scene,
        camera=replace(scene.camera, bands=()),
        plan=replace(scene.plan, rings=tuple(replace(ring, bands=()) for ring in scene.plan.rings)),
        lights=scene.lights_in(name),
        water=replace(scene.water, absorption_per_mm=scene.water.absorption_per_mm + _at(WATER_PER_M, band.wavelength_nm) / 1000.0),
        shoot=None if scene.shoot is None else replace(scene.shoot, reflectance=reflectance(scene.shoot, band)),
        disturbances=replace(
            wrong,
            root_mu_per_mm=None if mu is None else mu * (band.wavelength_nm / MU_NM) ** MU_POWER,
            white_balance_wander=0.0,
        ),
    )


def reflectance(shoot: Shoot, band: Band) -> float:
    """Return the reflectance of leaves at a band's centre."""
    return _at(shoot.spectrum, band.wavelength_nm)


def true_colour(scene: Scene) -> dict[str, float]:
    """Return the true colour of a scene's shoot: reflectances by range and vegetation indices."""
    if scene.shoot is None:
        return {}
    known = {band.name: band for band in scene.camera.bands}
    by_name = {name: reflectance(scene.shoot, known[band]) for name, band in bands_by_range(scene.camera.bands).items()}
    return {f"reflectance_{name}": value for name, value in by_name.items()} | vegetation_indices(by_name)


def _at(table: tuple[tuple[float, float], ...], wavelength_nm: float) -> float:
    """Interpolate a table by wavelength, with constant extrapolation."""
    return float(np.interp(wavelength_nm, *np.array(table).T))
