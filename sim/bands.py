"""Convert a scene to a single band of the camera.

The lights, leaves, roots and water get their properties at the wavelength of the band.
"""

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
"""Absorption coefficient of pure water. Each entry contains a wavelength, nm, and the coefficient, 1/m. The values are
rounded from Pope and Fry 1997 (Appl. Opt. 36:8710) up to 700 nm, and from Kou et al. 1993 (Appl. Opt. 32:3531)
beyond."""
MU_NM = 550.0
"""Wavelength at which the attenuation coefficient of roots is ``root_mu_per_mm`` of the disturbance profile, nm."""
MU_POWER = -1.0
"""Exponent with which the attenuation coefficient of roots depends on the wavelength. The attenuation is caused by
scattering. Soft tissue has exponents from -0.7 to -1.5 (Jacques 2013, Phys. Med. Biol. 58:R37, table 1)."""


def scene_in_band(scene: Scene, name: str) -> Scene:
    """Return a scene with a single band, which is one of the bands of the given scene.

    If the name is empty, the scene is returned unchanged.

    White-balance variations are disabled, because pictures of a band are grey.
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
        water=replace(
            scene.water, absorption_per_mm=scene.water.absorption_per_mm + _interpolate(WATER_PER_M, band.wavelength_nm) / 1000.0
        ),
        shoot=None if scene.shoot is None else replace(scene.shoot, reflectance=reflectance(scene.shoot, band)),
        disturbances=replace(
            wrong,
            root_mu_per_mm=None if mu is None else mu * (band.wavelength_nm / MU_NM) ** MU_POWER,
            white_balance_wander=0.0,
        ),
    )


def reflectance(shoot: Shoot, band: Band) -> float:
    """Return the reflectance of leaves at a band's central wavelength, 0 to 1."""
    return _interpolate(shoot.spectrum, band.wavelength_nm)


def true_colour(scene: Scene) -> dict[str, float]:
    """Return the true reflectances and vegetation indices of a scene's shoot, keyed by name."""
    if scene.shoot is None:
        return {}
    known = {band.name: band for band in scene.camera.bands}
    by_name = {name: reflectance(scene.shoot, known[band]) for name, band in bands_by_range(scene.camera.bands).items()}
    return {f"reflectance_{name}": value for name, value in by_name.items()} | vegetation_indices(by_name)


def _interpolate(table: tuple[tuple[float, float], ...], wavelength_nm: float) -> float:
    """Interpolate a table of wavelengths, nm, and values.

    Beyond its ends, the first or last value is used.
    """
    return float(np.interp(wavelength_nm, *np.array(table).T))
