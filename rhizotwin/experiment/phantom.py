"""Measure a phantom of copper wires with known cross-sections.

It shows which root diameters a rig can measure. The upper end of a wire is hidden by its holder. The wire's volume is
therefore divided by its visible length, and the resulting cross-section is compared with the known cross-section. The
cross-section of a real wire is computed from the mass of a measured length and the density of copper.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import log, pi
from pathlib import Path

from rhizotwin.scenes import rsml
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.rsml_reader import read_rsml
from rhizotwin.scenes.series import tube_mm3
from rhizotwin.stored import result_files

COPPER_MG_PER_MM3 = 8.96
"""Density of copper at 20 degrees Celsius, mg/mm3 (CRC Handbook of Chemistry and Physics)."""
TOLERANCE = 0.03
"""Maximum relative error of the measured cross-section at which a wire counts as measured successfully."""
LEAST_MM = 10.0
"""Minimum detected length, mm, at which a wire counts as measured successfully. Errors at the ends dominate shorter
lengths."""
NEAREST = 1.35
"""Maximum factor between the diameter of a centre line and the diameter of the wire to which it is assigned. For wires
whose diameters double, the midpoint between two wires is at a factor of 1.41."""


@dataclass(frozen=True, kw_only=True)
class Wire:
    """Measured length and volume of a wire in the phantom."""

    diameter_mm: float
    """Known diameter of the wire, mm."""
    length_mm: float
    """Detected length of the wire, mm."""
    volume_mm3: float
    """Measured volume of the detected part of the wire, computed from its centre line and diameters, mm3."""

    @property
    def true_mm3(self) -> float:
        """True volume of the detected part of the wire, computed from the known diameter, mm3."""
        return pi / 4.0 * self.diameter_mm**2 * self.length_mm

    @property
    def error(self) -> float:
        """Relative error of the measured cross-section. It is zero if the wire was not detected."""
        return self.volume_mm3 / self.true_mm3 - 1.0 if self.length_mm > 0.0 else 0.0

    @property
    def is_measured(self) -> bool:
        """Whether the wire was measured successfully. Roots of the same diameter can then be measured as well."""
        return self.length_mm >= LEAST_MM and abs(self.error) <= TOLERANCE

    @property
    def verdict(self) -> str:
        """Text that states whether the wire was measured successfully, and the reason if it was not."""
        if self.length_mm < LEAST_MM:
            return f"not measurable: less than {LEAST_MM:g} mm of the wire were detected"
        return f"{'measured' if self.is_measured else 'not measurable'} within {100.0 * TOLERANCE:g} %"


def diameter_of(mg_per_m: float) -> float:
    """Return the diameter of a round copper wire in mm. ``mg_per_m`` is its mass per metre in mg/m."""
    return float((4.0 / pi * mg_per_m / 1000.0 / COPPER_MG_PER_MM3) ** 0.5)


def measure_wires(result: Path, diameters_mm: Sequence[float]) -> list[Wire]:
    """Measure the wires in a scan of the phantom.

    Each centre line of the result is assigned to the wire with the most similar diameter. Centre lines whose diameter
    differs from all wires by more than the factor `NEAREST` are ignored.

    Parameters
    ----------
    result : Path
        Result folder.
    diameters_mm : sequence of float
        Known diameters of the wires, mm.

    Raises
    ------
    UserError
        If the folder is not a result, the result has no centre lines, or two diameters are too similar.
    """
    ordered = sorted(diameters_mm)
    least = NEAREST**2
    for thin, thick in pairwise(ordered):
        if thick / thin < least:
            raise UserError(
                f"wire diameters {thin:g} and {thick:g} mm are too similar; use diameters that differ by a factor of at least {least:.2f}"
            )
    result_files.read_summary(result)  # checks that the folder is an undamaged result
    file = result / "roots.rsml"
    if not file.is_file():
        raise UserError(f"{file} does not exist, because the reconstruction found no centre lines; no wire can be measured")
    lengths, volumes = dict.fromkeys(ordered, 0.0), dict.fromkeys(ordered, 0.0)
    for root in read_rsml(file):
        length = rsml.length_mm([root])
        volume = tube_mm3([root])
        if length <= 0.0 or volume <= 0.0:
            continue
        own = (4.0 / pi * volume / length) ** 0.5
        nearest = min(ordered, key=lambda diameter: abs(log(diameter / own)))
        if abs(log(own / nearest)) <= log(NEAREST):
            lengths[nearest] += length
            volumes[nearest] += volume
    return [Wire(diameter_mm=one, length_mm=lengths[one], volume_mm3=volumes[one]) for one in ordered]
