"""Spectral bands of a camera.

A view can consist of several pictures, one per range of wavelengths. A band is selected by a filter, by coloured lamps,
or by a channel of a colour camera, see `rig.rig_file.BandPart`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from rhizotwin.scenes.limits import bounded

RANGES_NM = {
    "blue": (430.0, 470.0, 500.0),
    "green": (500.0, 550.0, 590.0),
    "red": (620.0, 670.0, 700.0),
    "red_edge": (700.0, 720.0, 760.0),
    "nir": (760.0, 850.0, 1100.0),
}
"""Minimum, typical and maximum centre wavelength of each range, nm. The ranges are those of multispectral cameras for
plants, and include bands B2 to B8 of Sentinel-2."""


@dataclass(frozen=True, kw_only=True)
class Band:
    """Spectral band of a camera."""

    name: str = ""
    """Name of the band: one lower-case word, which is the suffix of the band's picture names."""
    wavelength_nm: float = bounded(550.0, 300.0, 2500.0)
    """Centre wavelength of the band, nm. It determines the vegetation index for which the band is used, and the
    rendering in the twin."""
    panel_level: float | None = field(default=None, metadata={"limits": (0.0, 1.0)})
    """Brightness of the bare panel in this band, as a fraction of full scale. It is 0 if the panel is off. If it is
    None, the brightness in ``[lights]`` is used."""
    front_level: float | None = field(default=None, metadata={"limits": (0.0, 1.0)})
    """Brightness of white paper on the strip in this band, as a fraction of full scale. If it is None, the brightness
    in ``[lights]`` is used."""


def bands_by_range(bands: Sequence[Band]) -> dict[str, str]:
    """Return the name of the band in each range of `RANGES_NM`. A range without a band has no entry.

    If several bands are in one range, the band nearest to the typical wavelength is used.
    """
    found = {}
    for name, (low, usual, high) in RANGES_NM.items():
        within = [band for band in bands if low <= band.wavelength_nm < high]
        if within:
            found[name] = min(within, key=lambda band: abs(band.wavelength_nm - usual)).name
    return found


def normalised_difference(one: float, other: float) -> float:
    """Return the normalised difference ``(one - other) / (one + other)``.

    For near infrared and red, the normalised difference is the NDVI (Rouse et al. 1974, NASA SP-351). For near infrared
    and red edge, it is the NDRE (Barnes et al. 2000, Proc. 5th Int. Conf. Precision Agriculture).
    """
    return (one - other) / max(one + other, 1e-12)


def vegetation_indices(reflectances: Mapping[str, float]) -> dict[str, float]:
    """Return the vegetation indices ``ndvi`` and ``ndre``.

    An index is omitted if the reflectances that it requires are unknown.
    """
    pairs = {"ndvi": "red", "ndre": "red_edge"}
    return {
        name: normalised_difference(reflectances["nir"], reflectances[other])
        for name, other in pairs.items()
        if {"nir", other} <= reflectances.keys()
    }
