"""Shoot above the net pot, modelled as a rosette of leaves on petioles."""

from dataclasses import dataclass

from rhizotwin.scenes.limits import bounded

GREEN_LEAF = (
    (450.0, 0.05),
    (500.0, 0.06),
    (550.0, 0.12),
    (600.0, 0.08),
    (650.0, 0.06),
    (675.0, 0.05),
    (700.0, 0.13),
    (720.0, 0.28),
    (750.0, 0.43),
    (800.0, 0.47),
    (900.0, 0.48),
    (1000.0, 0.47),
)
"""Wavelengths (nm) and reflectances of a healthy leaf. They are typical rounded values from Gates et al. 1965 (Appl.
Opt. 4:11)."""


@dataclass(frozen=True, kw_only=True)
class Shoot:
    """Shoot whose leaves are arranged in a spiral.

    The parameters are those of the oldest leaf. Younger leaves are smaller and steeper.

    The defaults describe a radish of two weeks, with blades of 40 by 24 mm and 0.3 mm thickness, and petioles of 35 mm
    (leaves of Raphanus sativus are 0.25 to 0.35 mm thick).
    """

    seed: int = bounded(0, 0, 2**63 - 1)
    """Random seed of the shoot."""
    leaves: int = bounded(6, 1, 60)
    """Number of leaves of the shoot."""
    divergence_deg: float = bounded(137.508, 0.0, 360.0)
    """Difference in azimuth between successive leaves. The default is the golden angle of spiral phyllotaxis."""
    youngest: float = bounded(0.35, 0.05, 1.0)
    """Ratio of the size of the youngest leaf to that of the oldest leaf."""
    size_sd: float = bounded(0.08, 0.0, 0.5)
    """Standard deviation of the size of a leaf, as a fraction of its mean size."""
    stem_mm: float = bounded(12.0, 2.0, 500.0)
    """Height of the stem above the upper edge of the net pot. The petioles are attached to the stem."""
    stem_diameter_mm: float = bounded(3.0, 0.2, 50.0)
    """Diameter of the stem."""
    petiole_mm: float = bounded(35.0, 1.0, 500.0)
    """Length of the petiole of the oldest leaf."""
    petiole_diameter_mm: float = bounded(2.0, 0.2, 50.0)
    """Diameter of the petiole of the oldest leaf."""
    elevation_deg: float = bounded(35.0, -60.0, 90.0)
    """Angle of the petiole of the oldest leaf above the horizon."""
    youngest_elevation_deg: float = bounded(75.0, -60.0, 90.0)
    """Angle of the petiole of the youngest leaf above the horizon."""
    elevation_sd_deg: float = bounded(6.0, 0.0, 45.0)
    """Standard deviation of the petiole angles."""
    blade_mm: float = bounded(40.0, 2.0, 1000.0)
    """Length of the blade of the oldest leaf along its midrib."""
    blade_width_mm: float = bounded(24.0, 1.0, 1000.0)
    """Maximum width of the blade of the oldest leaf."""
    thickness_mm: float = bounded(0.3, 0.05, 5.0)
    """Thickness of every blade."""
    droop_deg: float = bounded(50.0, -90.0, 170.0)
    """Downward bend of a blade between its base and its tip."""
    fold_deg: float = bounded(12.0, -60.0, 60.0)
    """Angle by which the two halves of a blade rise from its midrib."""
    reflectance: float = bounded(0.12, 0.0, 1.0)
    """Fraction of visible light that a green leaf reflects. It is 0.05 in blue and red, and 0.15 to 0.2 in green."""
    spectrum: tuple[tuple[float, float], ...] = GREEN_LEAF
    """Pairs of wavelength (nm) and reflectance of the leaves. Reflectances are interpolated linearly. They are only
    used for a camera with bands."""
