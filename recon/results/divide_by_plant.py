"""Division of a shape among several plants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.results import result_traits
from rhizotwin.recon.results.by_plant import Pair, PlantResult
from rhizotwin.recon.results.parts import Leaves, Mesh
from rhizotwin.recon.roots.plants import PlantedRoots
from rhizotwin.recon.uncertainty.budget import Term, part_interval
from rhizotwin.recon.uncertainty.calibration import NOT_CALIBRATED, Calibration
from rhizotwin.scenes import rsml, tube_surface
from rhizotwin.scenes.plants import Plant
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.subject import Subject

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Shape:
    """Reconstructed shape of all plants together."""

    leaves: Leaves
    surface: Mesh
    finest_mm: float
    """Edge length of the voxels from which the surface was extracted, mm."""
    volume_mm3: float
    terms: tuple[Term, ...]
    """Error budget of the volume."""
    calibration: Calibration = NOT_CALIBRATED
    """Calibration of the scan's intervals."""


def measure(shape: Shape, planted: PlantedRoots, plants: Sequence[Plant], whole: Subject) -> tuple[PlantResult, ...]:
    """Divide a shape among plants. Each part is assigned to the plant with the nearest root surface.

    Parameters
    ----------
    shape : Shape
        Shape of all plants, with voxels, surface and volume.
    planted : PlantedRoots
        Roots assigned to plants.
    plants : sequence of Plant
        Plants of the scene.
    whole : Subject
        Properties that all plants have in common.

    Returns
    -------
    tuple of PlantResult
        Results of the plants that have roots, in the given order.
    """
    names = [plant.plant for plant in plants if any(root.plant == plant.plant for root in planted.roots)]
    unsure = [root for root, is_open in zip(planted.roots, planted.open, strict=True) if is_open]
    sides = [[root for root in planted.roots if root.plant == name] for name in names]
    cell_mm = shape.leaves.voxel_mm * shape.leaves.size.astype(np.float64)
    middle = shape.leaves.origin_mm + shape.leaves.voxel_mm * shape.leaves.low + 0.5 * cell_mm[:, None]
    mm3 = shape.leaves.occupancy.astype(np.float64) * cell_mm**3
    height = np.stack([_height_mm(middle, side) for side in sides])
    owner, is_open = height.argmin(axis=0), _height_mm(middle, unsure) <= height.min(axis=0)
    scale = shape.volume_mm3 / float(mm3.sum())
    own = scale * np.bincount(owner, weights=mm3, minlength=len(names))
    loose = scale * np.bincount(owner[is_open], weights=mm3[is_open], minlength=len(names))
    vertices_mm, triangles = shape.surface.vertices_mm, shape.surface.faces
    corners = vertices_mm[triangles].mean(axis=1)
    face_of = np.stack([_height_mm(corners, side) for side in sides]).argmin(axis=0)
    found = []
    for k, name in enumerate(names):
        plant = next(one for one in plants if one.plant == name)
        roots, faces = rsml.plant_roots(planted.roots, name), triangles[face_of == k]
        used = np.unique(faces)
        points = np.concatenate([vertices_mm[used], *(root.points_mm for root in roots)])
        found.append(
            PlantResult(
                subject=plant.subject(whole),
                at_mm=plant.at_mm,
                volume_mm3=float(own[k]),
                volume_interval_mm3=_interval(shape, float(own[k] - loose[k]), float(own[k] + loose.sum() - loose[k])),
                open_mm=rsml.length_mm(root for root in unsure if root.plant == name),
                traits=result_traits.measure_shape(
                    Mesh(vertices_mm=vertices_mm[used], faces=np.searchsorted(used, faces)),
                    roots,
                    volume_mm3=float(own[k]),
                    finest_mm=shape.finest_mm,
                    extents_mm=(points.min(axis=0).tolist(), points.max(axis=0).tolist()),
                ),
            )
        )
    return tuple(found)


def _interval(shape: Shape, least_mm3: float, most_mm3: float) -> Pair:
    """Return the 90 % interval of a plant's volume, mm3.

    Its limits are computed from two volumes. ``least_mm3`` excludes the plant's parts that may belong to another plant.
    ``most_mm3`` includes the parts of other plants that may belong to this plant.
    """
    (low, _), (_, high) = (
        part_interval(shape.terms, whole_mm3=shape.volume_mm3, part_mm3=part, calibration=shape.calibration)
        for part in (least_mm3, most_mm3)
    )
    return low, high


def warnings(planted: PlantedRoots, found: Sequence[PlantResult]) -> tuple[str, ...]:
    """Return warnings about plants for which no root base was found, and about roots with an uncertain plant."""
    texts = [
        f"plant {name}: no root base was found near its position; its roots may have been assigned to another plant"
        for name in planted.missing
    ]
    total, open_mm = rsml.length_mm(planted.roots), sum(one.open_mm for one in found)
    if open_mm > 0.0:
        texts.append(
            f"{100.0 * open_mm / total:.0f} % of the root length cannot be assigned to a plant with certainty; the nearest plant was chosen"
        )
    return tuple(texts)


def _height_mm(points_mm: Floats, roots: Sequence[Root]) -> Floats:
    """Return the signed distance (P,) of points (P, 3) from the surface of the nearest root, mm.

    It is positive outside the roots, and infinite if there are no roots.
    """
    if not roots:
        return np.full(len(points_mm), np.inf)
    tubes = tube_surface.stations(roots)
    return result_traits.height_mm(points_mm, tubes.centre_mm, tubes.radius_mm)
