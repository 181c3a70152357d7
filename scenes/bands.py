"""Bands of a camera: each view of a scene as several pictures, one for each range of wavelengths.

A band is chosen by a filter, by coloured lamps or by a channel of a colour camera; `rig.rig_file.BandPart` says how.
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
"""Lowest, usual and highest centre of each range in nm: those of multispectral cameras for plants (Sentinel-2's bands
B2 to B8 lie in them)."""


@dataclass(frozen=True, kw_only=True)
class Band:
    """One band of a camera."""

    name: str = ""
    """One lower-case word; it ends the names of the band's pictures."""
    wavelength_nm: float = bounded(550.0, 300.0, 2500.0)
    """Centre of the band; it decides which index the band is used for, and what the twin renders."""
    panel_level: float | None = field(default=None, metadata={"limits": (0.0, 1.0)})
    """Fraction of full scale that the bare panel reaches in this band; 0: it is off. None: as in ``[lights]``."""
    front_level: float | None = field(default=None, metadata={"limits": (0.0, 1.0)})
    """Fraction of full scale that white paper on the strip reaches in this band. None: as in ``[lights]``."""


def by_range(bands: Sequence[Band]) -> dict[str, str]:
    """Return the name of the band that stands for each range of `RANGES_NM` which has one, by the range's name.

    Of several in one range it is the nearest to the usual wavelength.
    """
    found = {}
    for name, (low, usual, high) in RANGES_NM.items():
        within = [band for band in bands if low <= band.wavelength_nm < high]
        if within:
            found[name] = min(within, key=lambda band: abs(band.wavelength_nm - usual)).name
    return found


def normalised_difference(one: float, other: float) -> float:
    """Return ``(one - other) / (one + other)``.

    Of near infrared and red it is the NDVI (Rouse et al. 1974, NASA SP-351), of near infrared and red edge the NDRE
    (Barnes et al. 2000, Proc. 5th Int. Conf. Precision Agriculture).
    """
    return (one - other) / max(one + other, 1e-12)


def vegetation_indices(reflectances: Mapping[str, float]) -> dict[str, float]:
    """Return ``ndvi`` and ``ndre`` as far as the reflectances, by range, allow."""
    pairs = {"ndvi": "red", "ndre": "red_edge"}
    return {
        name: normalised_difference(reflectances["nir"], reflectances[other])
        for name, other in pairs.items()
        if {"nir", other} <= reflectances.keys()
    }
