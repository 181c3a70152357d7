"""Comparison of a result with a known solid or with a measured volume."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from rhizotwin.recon.results.parts import Json, Mesh
from rhizotwin.recon.results.result import Result, Triple, triple
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import interval_ml, ml
from rhizotwin.scoring.conventions import check_unit
from rhizotwin.scoring.registration import register
from rhizotwin.scoring.score_shape import SurfaceScore, compare_surfaces
from rhizotwin.stored.load import load_result


@dataclass(frozen=True, kw_only=True)
class VolumeScore:
    """Volume of a result compared with the true volume. Relative errors are (found / true - 1)."""

    scene: str
    """Name of the scene."""
    volume_mm3: float
    """Volume of the result, mm3."""
    volume_true_mm3: float
    """True volume of the specimen, mm3."""
    volume_error: float
    """Relative error of the volume."""
    volume_interval_mm3: tuple[float, float]
    """90 % interval of the result's volume, mm3."""
    interval_holds_truth: bool
    """Whether the interval contains the true volume."""
    volume_trusted: bool
    """Whether the volume is reliable according to the result."""
    volume_verdict: str
    """Sentence that states whether the volume is reliable."""

    def to_dict(self) -> Json:
        """Convert the score to values that the json module can write."""
        return asdict(self)

    def table(self) -> str:
        """Return the score as a text table."""
        return table_of(f"{self.scene}, compared with a known volume", volume_rows(self))


@dataclass(frozen=True, kw_only=True)
class SolidScore(VolumeScore):
    """Agreement of a result with a scanned solid that was registered to the result."""

    extents_mm: Triple
    """Size of the result's bounding box along x, y and z of the canister frame, mm."""
    extents_true_mm: Triple
    """Size of the registered solid's bounding box along x, y and z of the canister frame, mm."""
    extents_error: Triple
    """Relative errors of the bounding box along x, y and z."""
    surface: SurfaceScore
    """Distances between the surface of the result and the true surface."""
    result_from_solid: tuple[tuple[float, ...], ...]
    """Rigid transform (4, 4) from the frame of the solid to the frame of the result, mm."""

    def table(self) -> str:
        """Return the score as a text table."""
        rows = [*volume_rows(self), *extent_rows(self.extents_mm, self.extents_true_mm, self.extents_error), *surface_rows(self.surface)]
        return table_of(f"{self.scene}, compared with a registered solid", rows)


def score_volume(result: Result | Path | str, volume_mm3: float) -> VolumeScore:
    """Compare the volume of a result with a measured volume.

    Raises
    ------
    UserError
        If the volume is not positive, or the result folder cannot be read.
    """
    if not (np.isfinite(volume_mm3) and volume_mm3 > 0.0):
        raise UserError(f"the measured volume is {volume_mm3:g} mm3, but must be positive")
    found = result if isinstance(result, Result) else load_result(result)
    return VolumeScore(**volume_fields(found, volume_mm3))


def score_solid(result: Result | Path | str, solid: Mesh, *, volume_mm3: float) -> SolidScore:
    """Compare a result with a scanned solid, which is first registered to the result.

    Parameters
    ----------
    result : Result or path
        Result, or the result's folder.
    solid : Mesh
        Closed mesh, mm, in any pose.
    volume_mm3 : float
        Volume of the solid, mm3.

    Raises
    ------
    UserError
        If the result folder cannot be read, or the solid has the size of the result in another unit.
    """
    found = result if isinstance(result, Result) else load_result(result)
    shape = found.solid.surface
    check_unit(solid, shape, where="the mesh of the part")
    laid = register(solid, shape)
    extents_mm = np.subtract(found.solid.extents_max_mm, found.solid.extents_min_mm)
    true_mm = np.ptp(laid.moved.vertices_mm, axis=0)
    return SolidScore(
        **volume_fields(found, volume_mm3),
        extents_mm=triple(extents_mm),
        extents_true_mm=triple(true_mm),
        extents_error=triple(extents_mm / true_mm - 1.0),
        surface=compare_surfaces(shape, laid.moved),
        result_from_solid=tuple(tuple(float(value) for value in row) for row in laid.to_from_solid),
    )


def volume_fields(found: Result, volume_mm3: float) -> Json:
    """Return the values of the fields of a `VolumeScore`, keyed by field name."""
    low, high = found.interval_mm3
    return {
        "scene": found.scene,
        "volume_mm3": found.volume_mm3,
        "volume_true_mm3": volume_mm3,
        "volume_error": found.volume_mm3 / volume_mm3 - 1.0,
        "volume_interval_mm3": (low, high),
        "interval_holds_truth": bool(low <= volume_mm3 <= high),
        "volume_trusted": found.trusted,
        "volume_verdict": found.verdict,
    }


def volume_rows(score: "VolumeScore") -> list[tuple[str, str]]:
    """Return the table rows (name, text) that show the volume."""
    low, high = score.volume_interval_mm3
    verdict = "contains" if score.interval_holds_truth else "does not contain"
    found_ml, true_ml = (ml(value, half_mm3=0.5 * (high - low)) for value in (score.volume_mm3, score.volume_true_mm3))
    return [
        ("volume", f"{found_ml} ml, true {true_ml} ml: {percent(score.volume_error)}"),
        ("  90 % interval", f"{interval_ml(low, high)}, {verdict} the true volume"),
        ("  trusted", "yes" if score.volume_trusted else f"no, {score.volume_verdict}"),
    ]


def extent_rows(found_mm: Triple, true_mm: Triple, errors: Triple) -> list[tuple[str, str]]:
    """Return the table rows (name, text) that show the size of the bounding box."""
    each = zip("xyz", found_mm, true_mm, errors, strict=True)
    return [(f"extent {axis}", f"{found:.2f} mm, true {true:.2f} mm: {percent(error)}") for axis, found, true, error in each]


def surface_rows(s: SurfaceScore) -> list[tuple[str, str]]:
    """Return the table rows (name, text) that show the distances between the surfaces."""
    return [
        ("surface distance", f"median {s.median_mm:.3f} mm, 95 % {s.p95_mm:.3f} mm"),
        ("  result to truth", f"median {s.result_to_truth_median_mm:.3f} mm, 95 % {s.result_to_truth_p95_mm:.3f} mm"),
        ("  truth to result", f"median {s.truth_to_result_median_mm:.3f} mm, 95 % {s.truth_to_result_p95_mm:.3f} mm"),
    ]


def table_of(title: str, rows: Sequence[tuple[str, str]]) -> str:
    """Format rows of names and texts as a text table below a title."""
    width = max(len(name) for name, _ in rows) + 2
    return "\n".join([title, "=" * len(title), *(f"{name:<{width}}{text}".rstrip() for name, text in rows)])


def percent(fraction: float) -> str:
    """Format a fraction as a signed percentage."""
    return f"{100.0 * fraction:+.2f} %"
