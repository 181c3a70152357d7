"""Traits of a result, computed from its roots, surface and volume, and written as CSV and JSON files."""

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.recon.results import assessments, by_plant
from rhizotwin.recon.results.by_plant import PlantResult
from rhizotwin.recon.results.parts import Json, Mesh
from rhizotwin.scenes import root_table, solution, subject, trait_table, tube_surface
from rhizotwin.scenes.assessment import Assessment
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.schema import to_plain
from rhizotwin.scenes.subject import Subject
from rhizotwin.scenes.traits import Traits, measure_traits

Floats = NDArray[np.float64]

THICK_CELLS = 3.0
"""Minimum radius of roots whose surface area is measured on the mesh, in voxels of the finest size. On the mesh, the
area of thinner roots is underestimated, by 10 % for roots of 0.3 mm."""


def measure_shape(
    surface: Mesh,
    roots: Sequence[Root],
    *,
    volume_mm3: float,
    finest_mm: float,
    mass_g: float | None = None,
    extents_mm: tuple[Sequence[float], Sequence[float]],
) -> Traits:
    """Measure the traits of a reconstructed shape.

    Parameters
    ----------
    surface : Mesh
        Surface of the shape, which may be empty.
    roots : sequence of Root
        Roots of the shape. Without roots, the traits of centre lines are None.
    finest_mm : float
        Edge length of the voxels from which the surface was extracted, mm.
    extents_mm : tuple of (3,) sequences of float
        Lowest and highest corner of the shape, mm, used if surface and roots are empty.
    """
    some = len(surface.vertices_mm) or roots
    points = np.concatenate([surface.vertices_mm, *(root.points_mm for root in roots)]) if some else np.array(extents_mm)
    surface_mm2 = _area_mm2(surface, roots, THICK_CELLS * finest_mm)
    return measure_traits(roots, points, volume_mm3=volume_mm3, surface_mm2=surface_mm2, mass_g=mass_g)


def to_json(traits: Traits, summary: Json, *, mass_g: float | None) -> Json:
    """Return the contents of ``traits.json``."""
    plants = by_plant.from_summary(summary, "result.json")
    return {
        "scene": summary["scene"],
        "subject": to_plain(subject.from_summary(summary, "result.json")),
        **({"ions_mmol_per_l": ions} if (ions := solution.from_summary(summary, "result.json").ions_mmol_per_l) else {}),
        "volume_interval_mm3": list(summary["volume_interval_mm3"]),
        "mass_g": mass_g,
        **({"edits": edits} if (edits := describe_edits(summary)) else {}),
        **trait_table.to_json(traits, assessments.assess(summary, traits)),
        **({"shoot": trait_table.shoot_numbers(summary["shoot"])} if summary.get("shoot") else {}),
        **({"plants": [_plant(one, summary) for one in plants]} if plants else {}),
        "warnings": list(summary["warnings"]),
    }


def _plant(one: PlantResult, summary: Json) -> Json:
    """Return the entry of one plant in ``traits.json``."""
    assessed = assessments.assess(summary, one.traits, volume_interval_mm3=one.volume_interval_mm3)
    return {
        "subject": to_plain(one.subject),
        "volume_interval_mm3": list(one.volume_interval_mm3),
        "open_length_mm": one.open_mm,
        **trait_table.to_json(one.traits, assessed),
    }


def describe_edits(summary: Json) -> str:
    """Return a summary of the manual corrections of a result, or an empty string if there are none."""
    edits = summary.get("edits")
    if not edits:
        return ""
    count, moved = int(edits["count"]), 100.0 * float(edits["volume_share"])
    who = ", ".join(str(name) for name in edits["who"])
    return f"{count} edit{'' if count == 1 else 's'} by {who}, {moved:+.1f} % of volume"


@dataclass(frozen=True, kw_only=True)
class PlantTraits:
    """Traits of one plant in a result, with their assessments."""

    subject: Subject
    traits: Traits
    assessed: dict[str, Assessment]
    """Assessment of each trait, keyed by its field in `Traits`."""


def traits_by_plant(where: str, summary: Json, traits: Traits) -> list[PlantTraits]:
    """Return subject, traits and assessments of each plant in a result.

    Parameters
    ----------
    where : str
        Name of the result, for error messages.
    summary : Json
        Contents of ``result.json``.
    traits : Traits
        Traits of the whole result.
    """
    plants = [
        PlantTraits(
            subject=one.subject,
            traits=one.traits,
            assessed=assessments.assess(summary, one.traits, volume_interval_mm3=one.volume_interval_mm3),
        )
        for one in by_plant.from_summary(summary, where)
    ]
    return plants or [
        PlantTraits(subject=subject.from_summary(summary, where), traits=traits, assessed=assessments.assess(summary, traits))
    ]


def trait_files(traits: Traits, summary: Json, roots: Sequence[Root], *, mass_g: float | None) -> dict[str, str]:
    """Return the contents of ``traits.csv``, ``traits.json``, and of ``roots.csv`` and ``leaves.csv`` if there are any.

    The keys are the names of the files.

    Parameters
    ----------
    traits : Traits
        Traits of the result.
    summary : Json
        Contents of ``result.json``.
    roots : sequence of Root
        Roots of the result.
    mass_g : float or None
        Mass of the roots, g.
    """
    content = json.dumps(to_json(traits, summary, mass_g=mass_g), indent=1, allow_nan=False)
    whole = assessments.assess(summary, traits)
    table = trait_table.to_csv(traits, whole)
    if summary.get("plants"):
        plants = [(one.subject.plant, one.traits, one.assessed) for one in traits_by_plant("result.json", summary, traits)]
        table = trait_table.by_plant_csv([("", traits, whole), *plants])
    single = {"roots.csv": root_table.to_csv(roots, verdict=whole["total_length_mm"].verdict)} if roots else {}
    leaves = {"leaves.csv": trait_table.leaves_csv(summary["shoot"])} if (summary.get("shoot") or {}).get("blades_mm2") else {}
    return {"traits.csv": table, "traits.json": f"{content}\n", **single, **leaves}


def _area_mm2(surface: Mesh, roots: Sequence[Root], thick_mm: float) -> float:
    """Return the surface area, mm2. Thin roots are measured as tubes, and all other parts on the mesh."""
    area = surface.areas_mm2
    if not roots:
        return float(area.sum())
    tubes = tube_surface.stations(roots)
    a, b, c = surface.corners_mm
    thin, middle = tubes.radius_mm < thick_mm, (a + b + c) / 3.0
    to_thin, to_thick = (height_mm(middle, tubes.centre_mm[chosen], tubes.radius_mm[chosen]) for chosen in (thin, ~thin))
    meshed = (to_thick <= to_thin) | (to_thin > thick_mm)
    return float(area[meshed].sum() + tube_surface.exposed_area_mm2(tubes)[thin].sum())


def height_mm(points_mm: Floats, centre_mm: Floats, radius_mm: Floats) -> Floats:
    """Return the distance (P,) of points (P, 3) from the root surface, mm.

    The distance is that from the nearest centre-line point minus the root radius at this point. It is infinite if there
    are no centre-line points.
    """
    if not len(centre_mm):
        return np.full(len(points_mm), np.inf)
    away, near = cKDTree(centre_mm).query(points_mm, workers=-1)
    height: Floats = away - radius_mm[near]
    return height
