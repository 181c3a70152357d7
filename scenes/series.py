"""Series of scenes with a grown plant at different ages, with different treatments, and as replicates.

With the same seed, an older plant contains the younger plant. All radii of a series are scaled by the factor of the
scene's plant. Thus the volume at a different age is the scene's volume, multiplied by the ratio of the tube volumes of
both plants.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from rhizotwin.scenes import polyline
from rhizotwin.scenes.compounds import IONS
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.schema import Place
from rhizotwin.scenes.solution import check_solution
from rhizotwin.scenes.specimens import GrownSpecimen, RootOrder

SEEDS_APART = 1_000_003
"""Difference between the seeds of successive replicates. It is large enough that no replicate has the seed of another
plant in the library."""

Order = TypeVar("Order", bound=RootOrder)
Grow = Callable[[GrownSpecimen], Sequence[Root]]


def require_grown(scene: Scene) -> GrownSpecimen:
    """Return the grown plant of a scene.

    Raises
    ------
    UserError
        If the scene has no grown plant.
    """
    if not isinstance(scene.specimen, GrownSpecimen):
        raise UserError(f"scene {scene.name} has no grown plant, which is required for different days, replicates and treatments")
    return scene.specimen


def replicate(scene: Scene, number: int, *, seed: int | None = None) -> Scene:
    """Return a scene with a replicate of its plant.

    Replicate 0 is the plant of the scene itself, unless ``seed`` is given and is not 0.

    Parameters
    ----------
    scene : Scene
        Scene with a grown plant.
    number : int
        Number of the replicate, starting at 0.
    seed : int or None
        Random seed of the replicate; None to use its number.

    Returns
    -------
    Scene
        Scene with the replicate.
    """
    plant = require_grown(scene)
    told = replace(scene.subject, plant=f"{scene.subject.plant or scene.name}-{number + 1}", replicate=number + 1)
    return replace(scene, specimen=replace(plant, seed=plant.seed + SEEDS_APART * (number if seed is None else seed)), subject=told)


def apply_treatment(scene: Scene, name: str, growth: float, factors: Mapping[str, float] | None = None) -> Scene:
    """Return a scene with a different treatment.

    The treatment changes the growth of the roots by a factor, and the composition of the nutrient solution.

    Parameters
    ----------
    scene : Scene
        Scene with a grown plant.
    name : str
        Name of the treatment.
    growth : float
        Factor for the elongation rates and lengths of roots.
    factors : mapping of float or None
        Factors for concentrations of the scene's nutrient solution, by element or formula.

    Returns
    -------
    Scene
        Scene with the treated plant.

    Raises
    ------
    UserError
        If the nutrient solution has no compounds to which the factors apply.
    """
    plant = scale_growth(require_grown(scene), growth)
    told = replace(scene.subject, treatment=name, plant=f"{scene.subject.plant or scene.name} {name}".strip())
    solution = replace(scene.solution, factors={**scene.solution.factors, **(factors or {})})
    check_solution(solution, Place(f"treatment {name} of scene {scene.name}").at("solution"))
    return replace(scene, specimen=plant, subject=told, solution=solution)


def scale_growth(plant: GrownSpecimen, factor: float) -> GrownSpecimen:
    """Return a plant whose elongation rates and final lengths are multiplied by a factor."""

    def scaled(order: Order) -> Order:
        return replace(order, elongation_mm_per_day=order.elongation_mm_per_day * factor, max_length_mm=order.max_length_mm * factor)

    return replace(plant, orders=tuple(map(scaled, plant.orders)), basal=tuple(map(scaled, plant.basal)))


def limitation(plant: GrownSpecimen, ions_mmol_per_l: Mapping[str, float]) -> float:
    """Return the factor by which the nutrient solution limits the growth of a plant, between 0 and 1.

    It is the smallest factor of all ions (Liebig's law of the minimum). The factor of an ion is c / (c + K), where c is
    its concentration and K its half-saturation constant (Monod 1949, Annual Review of Microbiology 3:371).

    Parameters
    ----------
    plant : GrownSpecimen
        Plant with its half-saturation constants.
    ions_mmol_per_l : mapping of float
        Ion concentrations of the nutrient solution, mmol/l.

    Raises
    ------
    UserError
        If the plant has half-saturation constants of unknown ions, or the nutrient solution is unknown.
    """
    half = plant.half_growth_mmol_per_l
    if unknown := sorted(half.keys() - set(IONS)):
        raise UserError(f"specimen.half_growth_mmol_per_l: {unknown[0]} is not an ion; known ions are {', '.join(IONS)}")
    if half and not ions_mmol_per_l:
        raise UserError(
            'specimen.half_growth_mmol_per_l requires the concentrations of a nutrient solution; set recipe = "kliman_2022" in [solution]'
        )
    return min((ions_mmol_per_l[ion] / (ions_mmol_per_l[ion] + constant) for ion, constant in half.items()), default=1.0)


def at_day(scene: Scene, day: float, *, grow: Grow, like: GrownSpecimen | None = None) -> Scene:
    """Return a scene with the same plant at a different age.

    Parameters
    ----------
    scene : Scene
        Scene with a grown plant.
    day : float
        Age of the plant in days.
    grow : Grow
        Function that grows the centre lines of a plant (`sim.growth.grow`).
    like : GrownSpecimen or None
        Reference plant, whose volume at its age determines the scale of the radii; None for the scene's own plant.

    Returns
    -------
    Scene
        Scene with the plant at the given age.
    """
    plant = require_grown(scene)
    reference = like or plant
    other = replace(plant, age_days=day)
    before = tube_mm3(grow(reference))
    volume_ml = reference.volume_ml * tube_mm3(grow(other)) / before
    return replace(scene, specimen=replace(other, volume_ml=volume_ml), subject=replace(scene.subject, day=day))


def tube_mm3(roots: Sequence[Root]) -> float:
    """Return the sum of the volumes of all roots, mm3.

    Each segment is a truncated cone, and volumes in which roots overlap are counted repeatedly.
    """
    total = 0.0
    for root in roots:
        length = polyline.steps_mm(root.points_mm)
        a, b = root.diameters_mm[:-1] / 2.0, root.diameters_mm[1:] / 2.0
        total += float(np.sum(np.pi / 3.0 * length * (a**2 + a * b + b**2)))
    return total
