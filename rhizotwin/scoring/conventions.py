"""Units and axes of the files of other programs, recognised by comparison with the true shape."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon import surface_sample
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.scenes.errors import UserError

Floats = NDArray[np.float64]

UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4, "um": 0.001}
"""Units of length in which programs write coordinates, mm."""
_QUERIES, _POINTS = 200, 4_000
"""Number of points whose distances are computed for each convention, and number of points among which their nearest
neighbours are searched. On a plant with a surface of 50 cm2, their mean distance is 0.6 mm. A search takes 0.5 s."""
_FITS, _FITS_WELL = 0.05, 0.01
"""Mean distances, relative to the true shape's diagonal, below which another and the expected convention fit."""
_BETTER = 4.0
"""Minimum ratio of the distances in the expected and in another convention. It is exceeded even by a young radish that
is turned upside down, most of whose surface is that of its thick hypocotyl."""
_UNIT_TOLERANCE = 1.5
"""Maximum ratio of two sizes that are equal but for the unit. A centimetre and an inch differ by a factor of 2.5."""


@dataclass(frozen=True)
class Convention:
    """Conversion of a file's coordinates to the canister frame: ``scale * (axes @ point) + shift_mm``."""

    scale: float = 1.0
    """Scale factor, which is not 1 if the file has another unit than its format."""
    axes: tuple[tuple[float, ...], ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    """Orthogonal matrix (3, 3) with elements 0, 1 and -1."""
    shift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Translation, which is not zero if the axes of an array are exchanged within its box."""

    def convert(self, points: Floats) -> Floats:
        """Convert points (N, 3) from the file to the canister frame, mm."""
        return np.asarray(self.scale * points @ np.transpose(self.axes) + self.shift_mm)

    def revert(self, points_mm: Floats) -> Floats:
        """Convert points (N, 3) from the canister frame, mm, to the coordinates of the file."""
        return np.asarray((points_mm - self.shift_mm) @ np.array(self.axes) / self.scale)

    def __str__(self) -> str:
        """Return the canister's x, y and z in terms of the file's axes, such as ``x, -z, y``."""
        return ", ".join(f"{'-' if min(row) < 0.0 else ''}{'xyz'[int(np.argmax(np.abs(row)))]}" for row in self.axes)


def convention_of(points: Floats, true_mm: Floats, *, box: tuple[Floats, Floats] | None = None, where: str) -> Convention:
    """Recognise the axes of a file whose points fit the true shape in no other way.

    Parameters
    ----------
    points : (N, 3) array
        Points on or in the shape, in the coordinates of the file.
    true_mm : (M, 3) array
        Points on the true shape, canister frame, mm.
    box : tuple of two (3,) arrays, optional
        Lowest corner and size of a voxel array, mm. Its axes may also be exchanged within the box.
    where : str
        Name of the file for the error message.

    Returns
    -------
    Convention
        Convention that fits at least four times better than the canister frame, which is returned otherwise.

    Raises
    ------
    UserError
        If the coordinates are in another unit.
    """
    rng = np.random.default_rng(0)
    points, true_mm = (rng.permutation(each)[:_POINTS] for each in (points, true_mm))
    tree = cKDTree(points)
    tree_true = cKDTree(true_mm)
    some = points[:_QUERIES]
    some_true = true_mm[:_QUERIES]

    def misfit_mm(candidate: Convention) -> float:
        ahead = tree_true.query(candidate.convert(some))[0]
        back = candidate.scale * tree.query(candidate.revert(some_true))[0]
        return float(ahead.mean() + back.mean()) / 2.0

    expected = Convention()
    diagonal_mm = float(np.linalg.norm(np.ptp(true_mm, axis=0)))
    expected_mm = misfit_mm(expected)
    if expected_mm < _FITS_WELL * diagonal_mm:
        return expected
    best = expected
    best_mm = min(_FITS * diagonal_mm, expected_mm / _BETTER)
    for candidate in _candidates(box, scales_of(where)):
        found_mm = misfit_mm(candidate)
        if found_mm < 0.9 * best_mm:  # symmetric shapes fit several orders equally well, of which the first is the most usual
            best, best_mm = candidate, found_mm
    if best.scale != 1.0:
        raise UserError(_wrong_unit(where, best.scale))
    return best


def note_on(convention: Convention) -> tuple[str, ...]:
    """Return a note on exchanged axes. It is empty if the file has the axes of the canister frame."""
    if convention == Convention():
        return ()
    return (
        f"axes were exchanged: x, y and z of the canister frame are {convention} in the file, so that {str(convention).split()[2]} is up",
    )


def check_unit(mesh: Mesh, true: Mesh, *, where: str) -> None:
    """Raise `UserError` if a mesh in any pose has the size and area of another in a unit other than the millimetre."""
    ratios = np.array(_size_and_area(true)) / np.array(_size_and_area(mesh))
    for scale in scales_of(where):
        if scale != 1.0 and (np.abs(np.log(ratios / scale)) < np.log(_UNIT_TOLERANCE)).all():
            raise UserError(_wrong_unit(where, scale))


def _size_and_area(mesh: Mesh) -> tuple[float, float]:
    """Return the root mean square distance of the surface from its centroid, and the square root of its area."""
    points = surface_sample.sample(mesh.vertices_mm, mesh.faces, count=_POINTS, rng=np.random.default_rng(0))[0]
    return float(np.linalg.norm(points.std(axis=0))), float(np.sqrt(mesh.areas_mm2.sum()))


def scales_of(where: str) -> dict[float, str]:
    """Return the names of the units that a file may have, keyed by the factor to the unit of its format.

    The unit of GLB files is the metre, of other files the millimetre.
    """
    of_format_mm = UNITS_MM["m" if where.lower().endswith(".glb") else "mm"]
    return {unit_mm / of_format_mm: unit for unit, unit_mm in UNITS_MM.items()}


def _wrong_unit(where: str, scale: float) -> str:
    units = scales_of(where)
    return f"{where}: the coordinates are probably in {units[scale]} instead of {units[1.0]}; scale them by {scale:g}"


def _candidates(box: tuple[Floats, Floats] | None, scales: Iterable[float]) -> Iterator[Convention]:
    """Yield all orders and signs of the axes in all units, usual ones first and mirrored ones last."""
    signed = [
        np.eye(3)[list(order)] * np.array(signs)[:, None] for order in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)
    ]
    usual: list[object] = [((1, 0, 0), (0, 0, -1), (0, 1, 0)), ((1, 0, 0), (0, 0, 1), (0, -1, 0)), ((-1, 0, 0), (0, -1, 0), (0, 0, 1))]
    signed.sort(key=lambda axes: (-np.linalg.det(axes), *(axes.tolist() != np.array(one).tolist() for one in (np.eye(3), *usual))))
    for axes, scale in product(signed, scales):
        rows = tuple(tuple(float(value) for value in row) for row in axes)
        yield Convention(scale, rows)
        if box is not None and scale == 1.0:
            corner_mm = box[0]
            half_mm = box[1] / 2.0
            shift_mm = corner_mm + np.abs(axes) @ half_mm - axes @ (corner_mm + half_mm)
            x, y, z = map(float, shift_mm)
            yield Convention(scale, rows, (x, y, z))
