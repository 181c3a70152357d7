"""Masses from what pictures measure.

A power law whose errors are on both sides, chosen by leaving out one plant at a time.

The logarithm of a mass is a straight line in the logarithm of a trait (`experiment.york`): plants differ by factors,
not by grams, over fifty times of mass. A slope of one on the volume is a density.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.experiment.masses import KINDS, Weighed
from rhizotwin.experiment.measured import Measured, left_out, one_species
from rhizotwin.experiment.york import Line, fit_line
from rhizotwin.scenes.errors import UserError

Array = NDArray[np.float64]

TRAITS = ("volume", "total_length", "surface", "leaf_area", "shoot_projected_area", "shoot_volume")
"""Traits that a mass may be told by."""
LEAST_PLANTS = 4
"""Leaving one out must leave a line of two parameters with an uncertainty."""
SHARE = 0.9
"""Of the plants that an interval holds."""
MIXED = 100.0
"""A plant whose mass over volume is so many times off the others' was weighed in another unit: species differ by less
than ten times."""


@dataclass(frozen=True, kw_only=True)
class Relation:
    """How a mass follows from a trait: ``ln(g) = intercept + slope * ln(trait)``."""

    kind: str
    """Of `masses.KINDS`."""
    trait: str
    """In the unit of `scenes.trait_table`."""
    proportional: bool
    """The slope is one."""
    line: Line
    least: float
    """Smallest and ..."""
    most: float
    """... largest value of the trait that it was fitted to."""
    plants: int
    error: float
    """Root of the mean square of the relative error of plants that were left out."""
    held: float
    """Share of the plants that were left out whose mass lay in the interval."""

    @property
    def name(self) -> str:
        """Say what it is."""
        return f"{self.kind} from {self.trait}" + ("" if self.proportional else f" to the power {self.line.slope:.2f}")

    def predict(self, value: float, sigma: float) -> tuple[float, float, float]:
        """Return grams with the ends of the 90 % interval for a trait and the standard deviation of its logarithm."""
        (middle,), (spread,) = self.line.at(np.array([np.log(value)]), x_sigma=sigma)
        reach = self.line.reach(SHARE) * spread
        return float(np.exp(middle)), float(np.exp(middle - reach)), float(np.exp(middle + reach))


@dataclass(frozen=True, kw_only=True)
class Model:
    """What a fit leaves."""

    species: str
    relations: tuple[Relation, ...]
    """The best of each kind."""
    tried: tuple[Relation, ...]
    """All that were compared."""
    notes: tuple[str, ...]
    """What was left out, a sentence each."""


@dataclass(frozen=True)
class Pair:
    """A plant that was measured and weighed."""

    measured: Measured
    weighed: Weighed


def pairs(measured: Sequence[Measured], weighed: Sequence[Weighed]) -> tuple[list[Pair], list[str]]:
    """Bring results and masses together by plant, and by day where the masses have one.

    Returns
    -------
    list of Pair, list of str
        And a sentence for each that has no partner.

    Raises
    ------
    UserError
        Where two results are of one weighed plant, or a unit was mixed up.
    """
    found: list[Pair] = []
    notes = []
    for one in weighed:
        of_plant = [m for m in measured if m.subject.plant == one.subject.plant]
        same = [m for m in of_plant if one.subject.day is None or m.subject.day is None or m.subject.day == one.subject.day]
        if len(same) > 1:
            raise UserError(f"{one.where}: fits two results of plant {one.subject.plant}, {same[0].name} and {same[1].name}; give its day")
        if not same:
            notes.append(f"{one.where}: there is no result of plant {one.subject.plant}{'' if not of_plant else ' on its day'}")
        else:
            found.append(Pair(same[0], one))
    met = {id(pair.measured) for pair in found}
    notes += [f"{m.who}: was not weighed" for m in measured if id(m) not in met]
    notes += left_out([pair.measured for pair in found], TRAITS)
    _refuse_mixed(found)
    return found, notes


def ratios(found: Sequence[Pair], kind: str = "root_fresh") -> list[tuple[Pair, float]]:
    """Return mass over volume of each plant in g/ml, as table 4.1 of the thesis has it."""
    with_both = [(pair, pair.measured.usable("volume")) for pair in found if kind in pair.weighed.grams]
    return [(pair, pair.weighed.grams[kind] / (volume / 1000.0)) for pair, volume in with_both if volume is not None]


def fit(found: Sequence[Pair], *, balance_g: float, notes: Sequence[str] = ()) -> Model:
    """Fit every kind of mass to every trait, and choose by leaving out one plant at a time.

    In proportion and as a power.

    Of relations whose errors differ by less than one standard error, the one in proportion to the volume is taken, and
    otherwise the one in proportion (Hastie et al. 2009, The elements of statistical learning, section 7.10).

    Parameters
    ----------
    balance_g : float
        Readability of the balance, taken as the standard deviation of a mass.

    Raises
    ------
    UserError
        Where too few plants have a mass, or plants of two species are there.
    """
    species = one_species([pair.measured for pair in found])
    tried: list[Relation] = []
    told = list(notes)
    for kind in KINDS:
        for trait in TRAITS:
            chosen = [pair for pair in found if kind in pair.weighed.grams and pair.measured.usable(trait) is not None]
            plants = len({pair.measured.subject.plant for pair in chosen})
            if plants >= LEAST_PLANTS:
                values = {pair.measured.traits[trait] for pair in chosen}  # with one left out, two must differ to give a power
                powers = (True, False) if len(values) > 2 else (True,)
                tried += [_relation(chosen, kind, trait, held, balance_g) for held in powers]
            elif chosen and trait == "volume":
                told.append(f"{kind}: only {plants} plants were measured and weighed, at least {LEAST_PLANTS} are needed")
    best = tuple(_best([relation for relation in tried if relation.kind == kind]) for kind in dict.fromkeys(r.kind for r in tried))
    if not best:
        why = told or ["are the plants named alike?"]
        raise UserError(
            f"{len(found)} plants were measured and weighed, and a fit needs {LEAST_PLANTS} with reliable traits: {'; '.join(why)}"
        )
    return Model(species=species, relations=best, tried=tuple(tried), notes=tuple(told))


def _relation(chosen: Sequence[Pair], kind: str, trait: str, proportional: bool, balance_g: float) -> Relation:
    mass = np.array([pair.weighed.grams[kind] for pair in chosen])
    value = np.array([pair.measured.traits[trait] for pair in chosen])
    value_sigma = np.array([pair.measured.log_sigma(trait) for pair in chosen])
    plants = np.array([pair.measured.subject.plant for pair in chosen])
    x, y, y_sigma = np.log(value), np.log(mass), balance_g / mass
    slope = 1.0 if proportional else None
    error, held = np.empty(len(x)), np.empty(len(x), bool)
    for plant in np.unique(plants):  # all days of a plant are left out together
        out = plants == plant
        line = fit_line(x[~out], y[~out], value_sigma[~out], y_sigma[~out], slope=slope)
        middle, spread = line.at(x[out], x_sigma=value_sigma[out], y_sigma=y_sigma[out])
        error[out] = np.expm1(middle - y[out])
        held[out] = np.abs(middle - y[out]) <= line.reach(SHARE) * spread
    return Relation(
        kind=kind,
        trait=trait,
        proportional=proportional,
        line=fit_line(x, y, value_sigma, y_sigma, slope=slope),
        least=float(value.min()),
        most=float(value.max()),
        plants=len(np.unique(plants)),
        error=float(np.sqrt(np.mean(error**2))),
        held=float(held.mean()),
    )


def _best(tried: Sequence[Relation]) -> Relation:
    """Return the simplest relation within one standard error of the best.

    That of a root of a mean square of n values is 1 / sqrt(2 n).
    """
    least = min(relation.error for relation in tried)
    near = [relation for relation in tried if relation.error <= least * (1.0 + (2.0 * relation.plants) ** -0.5)]
    return min(near, key=lambda relation: (not relation.proportional, relation.trait != "volume", relation.error))


def _refuse_mixed(found: Sequence[Pair]) -> None:
    """Refuse a plant whose mass over volume is a hundred times off: its mass is in another unit than the others'."""
    for kind in KINDS:
        known = ratios(found, kind)
        if len(known) < LEAST_PLANTS:
            continue
        middle = float(np.median([ratio for _, ratio in known]))
        for pair, ratio in known:
            if not 1.0 / MIXED < ratio / middle < MIXED:
                told = f"{kind} of {pair.measured.who} is {pair.weighed.grams[kind]:g} g, {ratio / middle:.3g} times what the others have"
                raise UserError(f"{pair.weighed.where}: {told} for their volume; is it in another unit?")


def known_for(model: Model, measured: Measured) -> tuple[Relation, ...]:
    """Return the relations of a model that a result has the trait for.

    Raises
    ------
    UserError
        When the plant is of another species.
    """
    if model.species and measured.subject.species and model.species != measured.subject.species:
        raise UserError(
            f"{measured.who} is of the species {measured.subject.species}, the model was fitted to {model.species}; fit one for it"
        )
    return tuple(relation for relation in model.relations if measured.traits.get(relation.trait, 0.0) > 0.0)
