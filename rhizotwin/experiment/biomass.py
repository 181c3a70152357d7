"""Fit models that predict the mass of a plant from a trait.

The logarithm of the mass is a linear function of the logarithm of the trait, because plants vary by factors over a
fifty-fold range of mass. The line is fitted with errors in both variables (`experiment.york`). A model with slope 1 on
the volume is a density. The model is selected by leave-one-out cross-validation.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.experiment.masses import KINDS, Weighed
from rhizotwin.experiment.measured import Measured, exclusion_notes, one_species
from rhizotwin.experiment.york import Line, Points, fit_line
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.formatting import count
from rhizotwin.scenes.traits import density_note

Array = NDArray[np.float64]

TRAITS = ("volume", "total_length", "surface", "leaf_area", "shoot_projected_area", "shoot_volume")
"""Traits from which a mass may be predicted."""
LEAST_PLANTS = 4
"""Minimum number of plants for a fit. A line with two parameters needs three points for an uncertainty, and
leave-one-out cross-validation needs one more."""
SHARE = 0.9
"""Coverage probability of the prediction intervals."""
MIXED = 100.0
"""Maximum factor between the mass per volume of a plant and the median of all plants. If the factor is exceeded, the
unit of the mass is assumed to be wrong. Species differ by less than a factor of ten."""


@dataclass(frozen=True, kw_only=True)
class Relation:
    """Relation between a mass and a trait: ``ln(g) = intercept + slope * ln(trait)``."""

    kind: str
    """Kind of mass, one of `masses.KINDS`."""
    trait: str
    """Name of the trait, whose unit is defined in `scenes.trait_table`."""
    proportional: bool
    """Whether the slope is fixed at 1."""
    line: Line
    """Fitted line, which gives the logarithm of the mass in g as a function of the logarithm of the trait."""
    least: float
    """Minimum of the trait among the plants used in the fit."""
    most: float
    """Maximum of the trait among the plants used in the fit."""
    plants: int
    """Number of plants used in the fit."""
    error: float
    """Root mean square of the relative errors in leave-one-out cross-validation."""
    held: float
    """Fraction of masses within their prediction interval in leave-one-out cross-validation."""

    @property
    def name(self) -> str:
        """Description of the relation, such as ``root_fresh from volume``."""
        return f"{self.kind} from {self.trait}" + ("" if self.proportional else f" to the power {self.line.slope:.2f}")

    def predict(self, value: float, sigma: float) -> tuple[float, float, float]:
        """Predict the mass from a trait, and return it with the lower and the upper end of its 90 % interval, g.

        ``sigma`` is the standard deviation of the trait's logarithm.
        """
        (middle,), (spread,) = self.line.at(np.array([np.log(value)]), x_sigma=sigma)
        reach = self.line.reach(SHARE) * spread
        return float(np.exp(middle)), float(np.exp(middle - reach)), float(np.exp(middle + reach))


@dataclass(frozen=True, kw_only=True)
class Model:
    """Fitted mass model of a species."""

    species: str
    """Name of the species. It is empty if the species is unknown."""
    relations: tuple[Relation, ...]
    """Selected relation for each kind of mass."""
    tried: tuple[Relation, ...]
    """All relations that were compared."""
    notes: tuple[str, ...]
    """Sentences about excluded plants and values."""


@dataclass(frozen=True)
class Pair:
    """Measured traits and weighed masses of the same plant."""

    measured: Measured
    weighed: Weighed


def pairs(measured: Sequence[Measured], weighed: Sequence[Weighed]) -> tuple[list[Pair], list[str]]:
    """Match results with masses by plant, and by day if the table of masses contains days.

    Returns
    -------
    list of Pair, list of str
        Pairs of results and masses, and a sentence for each result or mass that could not be matched.

    Raises
    ------
    UserError
        If two results match the same weighed plant, a result without a day matches masses of two days, or masses have
        different units.
    """
    found: list[Pair] = []
    notes = []
    for one in weighed:
        of_plant = [m for m in measured if m.subject.plant == one.subject.plant]
        same = [m for m in of_plant if one.subject.day is None or m.subject.day is None or m.subject.day == one.subject.day]
        if len(same) > 1:
            raise UserError(
                f"{one.where}: plant {one.subject.plant} matches two results, {same[0].name} and {same[1].name}; "
                "add a column 'day' to the table"
            )
        if not same:
            notes.append(f"{one.where}: plant {one.subject.plant} has no result{'' if not of_plant else ' on this day'}")
        else:
            found.append(Pair(same[0], one))
    _check_days(found)
    met = {id(pair.measured) for pair in found}
    notes += [f"{m.who}: the table contains no mass that matches this result" for m in measured if id(m) not in met]
    notes += exclusion_notes([pair.measured for pair in found], TRAITS)
    _check_units(found)
    return found, [*notes, *_density_notes(found)]


def _check_days(found: Sequence[Pair]) -> None:
    """Raise an error if a result without a day is paired with masses of two days."""
    first: dict[int, Weighed] = {}
    for pair in found:
        own, mass = pair.measured, pair.weighed
        if own.subject.day is not None or mass.subject.day is None:
            continue
        before = first.setdefault(id(own), mass)
        if before.subject.day != mass.subject.day:
            raise UserError(
                f"{own.who}: the result {own.name} has no day, but masses of two days, {before.where} and {mass.where}; "
                "set the day of the result, or omit one of the masses"
            )


def ratios(found: Sequence[Pair], kind: str = "root_fresh") -> list[tuple[Pair, float]]:
    """Return each pair that has a mass and a volume, with the mass per volume, g/ml (thesis, table 4.1)."""
    with_both = [(pair, pair.measured.usable("volume")) for pair in found if kind in pair.weighed.grams]
    return [(pair, pair.weighed.grams[kind] / (volume / 1000.0)) for pair, volume in with_both if volume is not None]


def _density_notes(found: Sequence[Pair]) -> list[str]:
    """Return a sentence about the plants whose fresh root mass per volume is not plausible."""
    known = ratios(found)
    strange = [(pair, ratio) for pair, ratio in known if density_note(ratio)]
    if not strange:
        return []
    pair, ratio = sorted(strange, key=lambda one: one[1])[len(strange) // 2]
    share = f"{len(strange)} of {len(known)} plants"
    return [f"root_fresh: the mass per volume of {share} is not plausible: {pair.measured.who} has {density_note(ratio)}"]


def fit(found: Sequence[Pair], *, balance_g: float, notes: Sequence[str] = ()) -> Model:
    """Fit each kind of mass to each trait and select the best relation by leave-one-out cross-validation.

    Proportional and power-law relations are fitted. Among relations whose errors differ by less than one standard
    error, proportionality to the volume is preferred, then any proportional relation (Hastie et al. 2009, The elements
    of statistical learning, section 7.10).

    Parameters
    ----------
    balance_g : float
        Readability of the balance, g, used as the standard deviation of a mass.

    Raises
    ------
    UserError
        If too few plants have a mass, or the plants are of two species.
    """
    species = one_species([pair.measured for pair in found])
    tried: list[Relation] = []
    remarks = list(notes)
    for kind in KINDS:
        for trait in TRAITS:
            chosen = [pair for pair in found if kind in pair.weighed.grams and pair.measured.usable(trait) is not None]
            plants = len({pair.measured.subject.plant for pair in chosen})
            if plants >= LEAST_PLANTS:
                powers = (True, False) if _varies(chosen, trait) else (True,)
                tried += [_relation(chosen, kind, trait, held, balance_g) for held in powers]
            elif chosen and trait == "volume":
                remarks.append(f"{kind}: {plants} plants have a volume and a mass, but a fit needs at least {LEAST_PLANTS}")
    best = tuple(_best([relation for relation in tried if relation.kind == kind]) for kind in dict.fromkeys(r.kind for r in tried))
    if not best:
        why = remarks or ["check that results and table use the same plant names"]
        matched = count(len({pair.measured.subject.plant for pair in found}), "plant")
        raise UserError(
            f"a fit needs {LEAST_PLANTS} plants with a mass and reliable traits, but the table matches {matched}: {'; '.join(why)}"
        )
    return Model(species=species, relations=best, tried=tuple(tried), notes=tuple(remarks))


def _varies(chosen: Sequence[Pair], trait: str) -> bool:
    """Return whether a trait has two different values even if a plant is excluded, as the fit of a power law needs."""
    values = [(pair.measured.subject.plant, pair.measured.traits[trait]) for pair in chosen]
    return all(len({value for plant, value in values if plant != excluded}) > 1 for excluded, _ in values)


def _relation(chosen: Sequence[Pair], kind: str, trait: str, proportional: bool, balance_g: float) -> Relation:
    mass = np.array([pair.weighed.grams[kind] for pair in chosen])
    value = np.array([pair.measured.traits[trait] for pair in chosen])
    value_sigma = np.array([pair.measured.log_sigma(trait) for pair in chosen])
    plants = np.array([pair.measured.subject.plant for pair in chosen])
    points = Points(np.log(value), np.log(mass), value_sigma, balance_g / mass, plants)
    slope = 1.0 if proportional else None
    error = np.empty(len(plants))
    held = np.empty(len(plants), bool)
    for plant in np.unique(plants):  # all days of a plant are excluded together
        excluded = plants == plant
        out = points[excluded]
        line = fit_line(points[~excluded], slope=slope)
        middle, spread = line.at(out.x, x_sigma=out.x_sigma, y_sigma=out.y_sigma)
        error[excluded] = np.expm1(middle - out.y)
        held[excluded] = np.abs(middle - out.y) <= line.reach(SHARE) * spread
    return Relation(
        kind=kind,
        trait=trait,
        proportional=proportional,
        line=fit_line(points, slope=slope),
        least=float(value.min()),
        most=float(value.max()),
        plants=len(np.unique(plants)),
        error=float(np.sqrt(np.mean(error**2))),
        held=float(held.mean()),
    )


def _best(tried: Sequence[Relation]) -> Relation:
    """Return the simplest relation whose error is within one standard error of the minimum error.

    The relative standard error of the root mean square of n values is 1 / sqrt(2 n).
    """
    least = min(relation.error for relation in tried)
    near = [relation for relation in tried if relation.error <= least * (1.0 + (2.0 * relation.plants) ** -0.5)]
    return min(near, key=lambda relation: (not relation.proportional, relation.trait != "volume", relation.error))


def _check_units(found: Sequence[Pair]) -> None:
    """Raise an error if the mass per volume of a plant differs from the median by a factor of at least `MIXED`."""
    for kind in KINDS:
        known = ratios(found, kind)
        if len(known) < LEAST_PLANTS:
            continue
        middle = float(np.median([ratio for _, ratio in known]))
        for pair, ratio in known:
            if not 1.0 / MIXED < ratio / middle < MIXED:
                found_mass = f"{kind} of {pair.measured.who} is {pair.weighed.grams[kind]:g} g, {ratio / middle:.3g} times the value"
                raise UserError(f"{pair.weighed.where}: {found_mass} expected from its volume; check the unit of the mass")


def applicable_relations(model: Model, measured: Measured) -> tuple[Relation, ...]:
    """Return the relations of a model whose traits were measured in a result.

    Raises
    ------
    UserError
        If the plant's species is not that of the model.
    """
    if model.species and measured.subject.species and model.species != measured.subject.species:
        raise UserError(
            f"{measured.who} is of the species {measured.subject.species}, but "
            f"the model was fitted to {model.species}; fit a model for this species"
        )
    return tuple(relation for relation in model.relations if measured.traits.get(relation.trait, 0.0) > 0.0)
