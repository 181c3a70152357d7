"""Errors of a real rig, as parameters of a scene."""

from dataclasses import dataclass, field
from typing import Literal

from rhizotwin.scenes.limits import bounded


@dataclass(frozen=True, kw_only=True)
class Disturbances:
    """Errors of a real rig.

    A value of zero or None means that there is no error. Profiles are files with these values and their reasons.
    """

    full_well_e: float | None = field(default=None, metadata={"limits": (100.0, 1e6)})
    """Full-well capacity, which is the number of electrons at full scale. The photon (Poisson) noise is computed from
    it. If it is None, there is no photon noise."""
    read_noise_e: float = bounded(0.0, 0.0, 1000.0)
    """Standard deviation of the read noise of a pixel, in electrons."""
    aperture_mm: float = bounded(0.0, 0.0, 50.0)
    """Diameter of the lens aperture. It is 0 for a pinhole camera. Otherwise, objects outside the focus distance are
    blurred."""
    focus_error_mm: float = bounded(0.0, -200.0, 200.0)
    """Error of the focus distance (focus distance minus the distance from the camera to the table's axis)."""
    focal_error: float = bounded(0.0, -0.05, 0.05)
    """Relative error of the focal length (true over nominal, minus 1), for example after refocusing a calibrated lens.
    It is unknown to the reconstruction."""
    distortion: tuple[float, float, float, float, float] = bounded((0.0, 0.0, 0.0, 0.0, 0.0), -10.0, 10.0)
    """Lens distortion that is added to the distortion of the camera. It is known to the reconstruction, as for a
    calibrated lens."""
    arm_deg: float = bounded(0.0, 0.0, 10.0)
    """Standard deviation of the error of the camera's orientation about each axis. One error is drawn per ring, and is
    unknown to the reconstruction."""
    arm_mm: float = bounded(0.0, 0.0, 50.0)
    """Standard deviation of the error of the camera's position along each axis. One error is drawn per ring, and is
    unknown to the reconstruction."""
    table_deg: float = bounded(0.0, 0.0, 10.0)
    """Standard deviation of the error of the table angle. One error is drawn per view, and is unknown to the
    reconstruction."""
    canister_offset_mm: float = bounded(0.0, 0.0, 20.0)
    """Distance between the axis of the canister (with net pot, strip and plant) and the axis of the table. The
    direction is random."""
    canister_tilt_deg: float = bounded(0.0, 0.0, 10.0)
    """Tilt of the canister. The direction is random."""
    strip_offset_mm: float = bounded(0.0, 0.0, 10.0)
    """Distance between the axis of the net pot (with the strip) and the axis of the canister. The direction is
    random."""
    strip_tilt_deg: float = bounded(0.0, 0.0, 5.0)
    """Tilt of the net pot (with the strip) relative to the axis of the canister. The direction is random."""
    backlight_unevenness: float = bounded(0.0, 0.0, 0.9)
    """Relative difference between the brightest and the darkest part of the panel. The brightness varies smoothly and
    randomly."""
    n_water_error: float = bounded(0.0, -0.1, 0.1)
    """Error of the refractive index of the water (true minus nominal)."""
    transfer: Literal["linear", "srgb"] = "linear"
    """Transfer curve of the camera from light to pixel values. It is known to the reconstruction."""
    stored_bits: int | None = field(default=None, metadata={"limits": (8, 16)})
    """Bit depth of the stored pictures. If it is None, the value ``bits`` of the camera is used."""
    jpeg_quality: int | None = field(default=None, metadata={"limits": (1, 100)})
    """JPEG quality of the stored pictures. If it is None, they are stored as PNG."""
    exposure_wander: float = bounded(0.0, 0.0, 0.9)
    """Maximum relative deviation of the exposure. One deviation is drawn per picture from a uniform distribution, and
    is unknown to the reconstruction."""
    white_balance_wander: float = bounded(0.0, 0.0, 0.9)
    """Maximum relative deviation of the gains of red and blue. One deviation per gain and picture is drawn from a
    uniform distribution. If the value is above 0, the pictures are in colour."""
    vignetting: float = bounded(0.0, 0.0, 0.95)
    """Fraction of the light that the lens loses in the corners of the picture. The loss is proportional to the squared
    distance from the centre."""
    root_mu_per_mm: float | None = field(default=None, metadata={"limits": (0.01, 1000.0)})
    """Attenuation coefficient of root tissue. If it is None, roots are opaque."""
    root_n: float | None = field(default=None, metadata={"limits": (1.0, 2.0)})
    """Refractive index of root tissue, which then refracts light and attenuates it (``root_mu_per_mm``). If it is None,
    roots only attenuate light."""
    root_hair_mm: float = bounded(0.0, 0.0, 10.0)
    """Length of the root hairs, which surround every root like a grey sleeve."""
    root_hair_mu_per_mm: float = bounded(0.0, 0.0, 100.0)
    """Attenuation coefficient of the sleeve of root hairs."""
    sway_mm: float = bounded(0.0, 0.0, 20.0)
    """Standard deviation of the displacement of the lowest root tip in a view, in each horizontal direction. The
    displacement decreases towards the top of the roots, which does not move."""
    canister_radius_error_mm: float = bounded(0.0, -10.0, 10.0)
    """Error of the outer radius of the canister (true minus nominal). It is unknown to the reconstruction."""
    canister_out_of_round_mm: float = bounded(0.0, 0.0, 10.0)
    """Half the difference between the largest and the smallest outer radius of the canister. The cross-section is an
    oval that rotates with the canister. It is unknown to the reconstruction."""
    wall_error: float = bounded(0.0, -0.5, 0.5)
    """Relative error of the wall thickness of the canister (true over nominal, minus 1). It is unknown to the
    reconstruction."""
    n_wall_error: float = bounded(0.0, -0.1, 0.1)
    """Error of the refractive index of the canister's wall (true minus nominal). It is unknown to the
    reconstruction."""
    seam_opacity: float = bounded(0.0, 0.0, 1.0)
    """Fraction of light that the seam of a rolled tube absorbs. The seam is 1 mm wide, has a random azimuth, and
    rotates with the canister."""
    dust_specks: int = bounded(0, 0, 100000)
    """Number of opaque specks on the outside of the canister."""
    scratches: int = bounded(0, 0, 10000)
    """Number of scratches on the outside of the canister. Each scratch absorbs half of the light."""
    highlight: float = bounded(0.0, 0.0, 1.0)
    """Light that a lamp adds by its reflection in the wall, as a fraction of full scale. The reflection is a streak
    that does not move when the canister rotates."""
    algae_patches: int = bounded(0, 0, 1000)
    """Number of algae films on the inside of the wall. They rotate with the canister."""
    algae_opacity: float = bounded(0.0, 0.0, 1.0)
    """Maximum fraction of light that an algae film absorbs in its middle. Films absorb 50 to 100 % of it."""
    turbidity_per_mm: float = bounded(0.0, 0.0, 0.1)
    """Extinction coefficient of the water."""
    felt_fibres: int = bounded(0, 0, 10000)
    """Number of black fibres that hang from the net pot into the water."""
    bubbles: int = bounded(0, 0, 10000)
    """Number of air bubbles in the water at the wall."""
