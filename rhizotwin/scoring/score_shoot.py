"""Comparison of a shoot with the ground truth of a simulated dataset."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rhizotwin.recon.results.parts import picture_path
from rhizotwin.recon.shoots.shoot import Shoot
from rhizotwin.stored import result_files


@dataclass(frozen=True, kw_only=True)
class ShootScore:
    """Agreement of a shoot with the true shoot. Relative errors are (found / true - 1)."""

    height_mm: float
    """Height above the net pot, mm."""
    height_true_mm: float
    """True height above the net pot, mm."""
    height_error: float
    """Relative error of the height."""
    surface_area_mm2: float
    """One-sided surface area, mm2."""
    surface_area_true_mm2: float
    """Half of the true solid's surface area, mm2: one side of the blades and half of the stalks."""
    surface_area_error: float
    """Relative error of the surface area."""
    leaf_area_mm2: float | None
    """One-sided area of the blades, mm2. It is None if leaves enclose a space that is not visible in any picture."""
    leaf_area_true_mm2: float
    """True one-sided area of the blades, mm2."""
    leaf_area_error: float | None
    """Relative error of the leaf area. It is None if the leaf area was not determined."""
    leaves: int
    """Number of leaves."""
    leaves_true: int
    """True number of leaves."""
    projected_error: float
    """Relative error of the projected area of the shoot, as the median over the pictures."""
    projected_error_max: float
    """Relative error of the projected area of the shoot, as the maximum absolute value over the pictures."""
    hull_mm3: float
    """Volume of the visual hull of the shoot, mm3."""
    volume_mm3: float | None
    """Volume of the shoot, mm3. It is None if the leaf thickness was not measured."""
    volume_true_mm3: float
    """True volume of the shoot, mm3."""
    volume_error: float | None
    """Relative error of the volume. It is None if the volume was not determined."""
    colour: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Found and true values of the vegetation indices NDVI and NDRE, keyed by index name. It is empty if the shoot was
    imaged in a single band."""

    def rows(self) -> list[tuple[str, str]]:
        """Return the rows (name, text) of the score's text table."""
        return [
            ("shoot", ""),
            ("  height", f"{self.height_mm:.2f} mm, true {self.height_true_mm:.2f} mm: {100.0 * self.height_error:+.2f} %"),
            (
                "  surface, one side",
                f"{self.surface_area_mm2:.0f} mm2, true {self.surface_area_true_mm2:.0f} mm2: {100.0 * self.surface_area_error:+.2f} %",
            ),
            ("  leaf area", self._leaf_area()),
            ("  leaves", f"{self.leaves}, true {self.leaves_true}"),
            ("  projected area", f"median {100.0 * self.projected_error:+.2f} %, maximum {100.0 * self.projected_error_max:.2f} %"),
            ("  volume", self._volume()),
            *((f"  {name}", f"{found:.3f}, true {true:.3f}: {found - true:+.3f}") for name, (found, true) in self.colour.items()),
            ("  hull", f"{self.hull_mm3:.0f} mm3, {self.hull_mm3 / self.volume_true_mm3:.2f} times the true volume"),
        ]

    def _leaf_area(self) -> str:
        if self.leaf_area_mm2 is None or self.leaf_area_error is None:
            return (
                f"not determined, because leaves enclose a space that is not visible in any picture; true {self.leaf_area_true_mm2:.0f} mm2"
            )
        return f"{self.leaf_area_mm2:.0f} mm2, true {self.leaf_area_true_mm2:.0f} mm2: {100.0 * self.leaf_area_error:+.2f} %"

    def _volume(self) -> str:
        if self.volume_mm3 is None or self.volume_error is None:
            return f"not determined without leaf area and leaf thickness; true {self.volume_true_mm3:.0f} mm3"
        return f"{self.volume_mm3:.0f} mm3, true {self.volume_true_mm3:.0f} mm3: {100.0 * self.volume_error:+.2f} %"


def compare_shoot(found: Shoot | None, truth: dict[str, float], folder: Path) -> ShootScore | None:
    """Compare a shoot with the ``truth`` folder of a dataset. Return None if the result or the truth has no shoot."""
    if found is None or not truth:
        return None
    half_mm2 = 0.5 * float(result_files.read_mesh(folder / "shoot.ply").areas_mm2.sum())
    errors = []
    for file, pixels in found.covered_px.items():
        mask = result_files.read_grey(picture_path(folder / "masks", file))
        errors.append(pixels / max(float(mask.sum()), 1e-9) - 1.0)
    return ShootScore(
        height_mm=found.height_mm,
        height_true_mm=truth["height_mm"],
        height_error=found.height_mm / truth["height_mm"] - 1.0,
        surface_area_mm2=found.surface_area_mm2,
        surface_area_true_mm2=half_mm2,
        surface_area_error=found.surface_area_mm2 / half_mm2 - 1.0,
        leaf_area_mm2=found.leaf_area_mm2,
        leaf_area_true_mm2=truth["leaf_area_mm2"],
        leaf_area_error=None if found.leaf_area_mm2 is None else found.leaf_area_mm2 / truth["leaf_area_mm2"] - 1.0,
        leaves=found.leaves,
        leaves_true=round(truth["leaves"]),
        projected_error=float(np.median(errors)),
        projected_error_max=float(np.abs(errors).max()),
        hull_mm3=found.hull_mm3,
        volume_mm3=found.volume_mm3,
        volume_true_mm3=truth["volume_mm3"],
        volume_error=None if found.volume_mm3 is None else found.volume_mm3 / truth["volume_mm3"] - 1.0,
        colour={name: (found.colour[name], truth[name]) for name in ("ndvi", "ndre") if name in found.colour and name in truth},
    )
