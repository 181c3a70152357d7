"""Copper wires of known section as a phantom: how well a rig measures roots of each diameter.

A wire's upper end is hidden by its holder, so that its volume is compared per visible length, which is its section. The
section of a real wire follows from the mass of a measured length of it and the density of copper.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import log, pi
from pathlib import Path

from rhizotwin.scenes import rsml
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.series import tube_mm3

COPPER_MG_PER_MM3 = 8.96
"""Density of copper at 20 degrees Celsius: CRC Handbook of Chemistry and Physics."""
TOLERANCE = 0.03
"""Largest error of a section that counts as measured."""
LEAST_MM = 10.0
"""A wire of which less is found is not measured: its ends have too much weight."""
NEAREST = 1.35
"""Largest factor between the diameter of a root and that of its wire; wires that double in diameter are 1.41 apart."""


@dataclass(frozen=True, kw_only=True)
class Wire:
    """A wire as it was measured."""

    diameter_mm: float
    """Diameter that is known."""
    length_mm: float
    """Length that was found."""
    volume_mm3: float
    """Volume of that length, from its centre line and diameters."""

    @property
    def true_mm3(self) -> float:
        """Volume that the known diameter gives for the length that was found."""
        return pi / 4.0 * self.diameter_mm**2 * self.length_mm

    @property
    def error(self) -> float:
        """Relative error of the section; 0 if nothing was found."""
        return self.volume_mm3 / self.true_mm3 - 1.0 if self.length_mm > 0.0 else 0.0

    @property
    def is_measured(self) -> bool:
        """Whether roots of this diameter are measured."""
        return self.length_mm >= LEAST_MM and abs(self.error) <= TOLERANCE

    @property
    def verdict(self) -> str:
        """`is_measured` in words, with the reason."""
        if self.length_mm < LEAST_MM:
            return "not measurable: too little of it was found"
        return f"{'measured' if self.is_measured else 'not measurable'} within {100.0 * TOLERANCE:g} %"


def diameter_of(mg_per_m: float) -> float:
    """Return the diameter of a round copper wire from its mass per metre, mm."""
    return float((4.0 / pi * mg_per_m / 1000.0 / COPPER_MG_PER_MM3) ** 0.5)


def measure_wires(result: Path, diameters_mm: Sequence[float]) -> list[Wire]:
    """Return each wire of a scan of the phantom, from the centre lines of its result.

    Every centre line belongs to the wire whose diameter is nearest to its own; lines that are far from all of them are
    left out.

    Parameters
    ----------
    result : Path
        Folder of the result.
    diameters_mm : sequence of float
        Known diameters.

    Raises
    ------
    UserError
        If the result has no centre lines, or two diameters are too similar.
    """
    ordered = sorted(diameters_mm)
    least = NEAREST**2
    for thin, thick in pairwise(ordered):
        if thick / thin < least:
            raise UserError(
                f"wire diameters {thin:g} and {thick:g} mm are too similar; use diameters that differ by a factor of at least {least:.2f}"
            )
    file = result / "roots.rsml"
    if not file.is_file():
        raise UserError(f"{file} does not exist: no centre lines were found, so that no wire is measured")
    lengths, volumes = dict.fromkeys(ordered, 0.0), dict.fromkeys(ordered, 0.0)
    for root in rsml.read_rsml(file):
        length, volume = rsml.length_mm([root]), tube_mm3([root])
        if length <= 0.0 or volume <= 0.0:
            continue
        own = (4.0 / pi * volume / length) ** 0.5
        nearest = min(ordered, key=lambda diameter: abs(log(diameter / own)))
        if abs(log(own / nearest)) <= log(NEAREST):
            lengths[nearest] += length
            volumes[nearest] += volume
    return [Wire(diameter_mm=one, length_mm=lengths[one], volume_mm3=volumes[one]) for one in ordered]
