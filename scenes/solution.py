"""Nutrient solutions: mass concentrations of compounds, and the resulting ion concentrations.

A compound is divided into the ions of `_IONS`. Atomic masses are taken from molmass (IUPAC). Phosphate and carbonate
are counted in the form that prevails between pH 5 and 7, and boron as boric acid. Of organic compounds, such as iron
chelates, only the metal is counted.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.schema import Place, from_plain

UNIT = "mmol/l"
Factors = tuple[tuple[str, float], ...]
"""Type of the factors by which concentrations are multiplied. They are pairs of the name of an element or compound, and
its factor."""

RECIPES: Mapping[str, Mapping[str, float]] = {
    "kliman_2022": {
        "MgSO4.7H2O": 0.2461,
        "Ca(NO3)2.4H2O": 0.4859,
        "NH4NO3": 0.038,
        "KH2PO4": 0.136,
        "KNO3": 0.442,
        "H3BO3": 0.0009,
        "MnSO4.H2O": 0.0008,
        "Na2MoO4.2H2O": 0.00006,
        "CuSO4.5H2O": 0.00009,
        "ZnSO4.7H2O": 0.0006,
        "C14H21FeN3O10": 0.01,
    }
}
"""Mass concentrations of the compounds in each recipe, g/l. ``kliman_2022`` is table 3.1 of the thesis."""

_IONS: Mapping[str, tuple[str, int, tuple[int, ...]]] = {
    "NO3": ("NO3", 1, (-1,)),
    "NH4": ("NH4", 1, (1,)),
    "H2PO4": ("H2PO4", 1, (-1,)),
    "HPO4": ("H2PO4", 1, (-2,)),
    "PO4": ("H2PO4", 1, (-3,)),
    "K": ("K", 1, (1,)),
    "Ca": ("Ca", 1, (2,)),
    "Mg": ("Mg", 1, (2,)),
    "SO4": ("SO4", 1, (-2,)),
    "Fe": ("Fe", 1, (2, 3)),
    "Mn": ("Mn", 1, (2,)),
    "Zn": ("Zn", 1, (2,)),
    "Cu": ("Cu", 1, (2,)),
    "H3BO3": ("H3BO3", 1, (0,)),
    "B4O7": ("H3BO3", 4, (-2,)),
    "MoO4": ("MoO4", 1, (-2,)),
    "Mo7O24": ("MoO4", 7, (-6,)),
    "Ni": ("Ni", 1, (2,)),
    "Co": ("Co", 1, (2,)),
    "Na": ("Na", 1, (1,)),
    "Cl": ("Cl", 1, (-1,)),
    "I": ("I", 1, (-1,)),
    "SiO3": ("SiO3", 1, (-2,)),
    "HCO3": ("HCO3", 1, (-1,)),
    "CO3": ("HCO3", 1, (-2,)),
    "H": ("", 0, (1,)),
    "OH": ("", 0, (-1,)),
}
"""Ions that correspond to the groups of a formula. The values are the name of the ion (empty for acid and alkali), the
number of ions per group, and the possible charges of the group."""
IONS = tuple(dict.fromkeys(name for name, _, _ in _IONS.values() if name))
"""Names of all ions, in the order in which they are listed in tables."""
_METALS = frozenset({"K", "Ca", "Mg", "Fe", "Mn", "Zn", "Cu", "Ni", "Co", "Na"})
_NUTRIENTS = _METALS | {"N", "P", "S", "B", "Mo", "Cl", "I", "Si", "C"}
"""Symbols of the elements for which a factor can be specified."""
_GROUP = re.compile(rf"({'|'.join(sorted(_IONS, key=len, reverse=True))})(\d*)|\(({'|'.join(sorted(_IONS, key=len, reverse=True))})\)(\d*)")
_MOST_LETTERS = 80
"""Maximum length of a formula in characters. The longest chelate in use has 25 characters."""


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Nutrient solution in which the plants grow. It is empty if the solution is unknown."""

    recipe: Literal["", "kliman_2022"] = ""
    """Recipe on which the solution is based. kliman_2022 is table 3.1 of the thesis."""
    grams_per_l: dict[str, float] = field(default_factory=dict, hash=False, metadata={"limits": (0.0, 1000.0)})
    """Mass concentrations of compounds in grams per litre. The keys are formulas, such as "Ca(NO3)2.4H2O" = 0.4859.
    These values replace those of the recipe."""
    factors: dict[str, float] = field(default_factory=dict, hash=False, metadata={"limits": (0.0, 100.0)})
    """Factors for concentrations. The keys are elements or formulas, such as K = 0.5. The concentration of every
    compound with an ion of the element is multiplied by the factor. If several factors apply to a compound, all of them
    are multiplied."""

    @property
    def known(self) -> bool:
        """Whether the solution is known, which requires at least one concentration or a recipe."""
        return bool(self.recipe or self.grams_per_l)

    @property
    def compounds_g_per_l(self) -> dict[str, float]:
        """Mass concentrations of the compounds after multiplication by the factors, g/l. The keys are formulas."""
        found = {**RECIPES.get(self.recipe, {}), **self.grams_per_l}
        for what, factor in self.factors.items():
            found = {name: grams * (factor if _holds(name, what) else 1.0) for name, grams in found.items()}
        return found

    @property
    def ions_mmol_per_l(self) -> dict[str, float]:
        """Concentrations of all ions in `IONS`, mmol/l. Concentrations of absent ions are 0.

        The result is empty if the solution is unknown.
        """
        if not self.known:
            return {}
        total = dict.fromkeys(IONS, 0.0)
        for formula, grams in self.compounds_g_per_l.items():
            mass, ions = _divide(formula)
            for name, count in ions.items():
                total[name] += 1000.0 * grams / mass * count
        return total

    def __str__(self) -> str:
        """Return the recipe, the added compounds and the factors on one line.

        The line is empty if the solution is unknown.
        """
        own = [f"{name} {grams:g} g/l" for name, grams in self.grams_per_l.items()]
        return ", ".join([*filter(None, [self.recipe]), *own, *(f"{what} x {factor:g}" for what, factor in self.factors.items())])


def check_solution(solution: Solution, place: Place) -> None:
    """Reject compounds that cannot be divided into ions.

    Also reject factors for substances that are not in the solution.

    Raises
    ------
    UserError
        If a compound or factor is invalid; the message states the compound or factor and the condition.
    """
    for formula in solution.grams_per_l:
        try:
            _divide(formula)
        except UserError as error:
            raise place.at("grams_per_l", formula).error(str(error)) from None
    compounds = {**RECIPES.get(solution.recipe, {}), **solution.grams_per_l}
    for what in solution.factors:
        if not any(_holds(formula, what) for formula in compounds):
            has = ", ".join(compounds) or "none"
            raise place.at("factors", what).error(
                f"must be an element (K, N, potassium) or a compound of the solution, whose compounds are {has}"
            )


def from_summary(summary: Mapping[str, Any], where: str) -> Solution:
    """Return the solution recorded in a ``result.json``.

    It is empty for results of versions that did not record it.

    Raises
    ------
    UserError
        If the entry is invalid.
    """
    place = Place(where).at("solution")
    solution = from_plain(Solution, summary.get("solution") or {}, place)
    check_solution(solution, place)
    return solution


def headings(many: Sequence[Mapping[str, float]]) -> dict[str, str]:
    """Return the table headings of all ions that occur in at least one solution, such as ``K (mmol/l)``.

    Parameters
    ----------
    many : sequence of mapping
        Concentrations as returned by `Solution.ions_mmol_per_l`.
    """
    return {ion: f"{ion} ({UNIT})" for ion in IONS if any(own.get(ion) for own in many)}


def read_solution(text: str) -> Solution:
    """Parse a command-line solution: a recipe or TOML file, followed by factors, as in ``kliman_2022,K=0.5``.

    Raises
    ------
    UserError
        If the recipe is unknown, the file cannot be read, or a factor or the solution is invalid.
    """
    from rhizotwin.scenes.files import read_toml  # imported here, as that module imports this one

    name, *changes = (part.strip() for part in text.split(","))
    if name.endswith(".toml"):
        table, content = read_toml(Path(name))
        place = Place(name, content)
    else:
        table, place = {"recipe": name}, Place("--solution")
    factors = dict(table.get("factors", {})) if isinstance(table.get("factors", {}), Mapping) else {}
    for change in changes:
        what, _, factor = change.partition("=")
        try:
            factors[what.strip()] = float(factor)
        except ValueError:
            raise UserError(f"--solution {text}: {change!r} is not a factor; specify ELEMENT=FACTOR, such as K=0.5") from None
    solution = from_plain(Solution, {**table, **({"factors": factors} if changes else {})}, place)
    check_solution(solution, place)
    return solution


def _holds(formula: str, what: str) -> bool:
    """Return whether a substance is in a compound.

    It can be the formula of the compound, or an element of one of its ions.
    """
    return formula == what or (_symbol(what) in _NUTRIENTS and any(_symbol(what) in _atoms(ion)[1] for ion in _divide(formula)[1]))


def _symbol(element: str) -> str:
    """Return the symbol of an element, which is given by its symbol or its English name.

    Other texts are returned unchanged.
    """
    from molmass import ELEMENTS

    return next((str(one.symbol) for one in ELEMENTS if one.name.lower() == element.lower()), element)


@lru_cache(maxsize=256)
def _atoms(formula: str) -> tuple[float, Mapping[str, int]]:
    """Return the molar mass of a formula (g/mol), and the number of atoms of each element."""
    from molmass import Formula, FormulaError  # imported here, as loading it would slow down the start of every command

    if not formula or len(formula) > _MOST_LETTERS:
        raise UserError(f"must be a formula with 1 to {_MOST_LETTERS} characters, such as KNO3")
    try:
        found = Formula(_plain(formula))
        return float(found.mass), {str(one): item.count for one, item in found.composition().items()}
    except FormulaError as error:
        raise UserError(f"must be a formula such as KNO3 or Ca(NO3)2.4H2O: {str(error).splitlines()[0]}") from None


@lru_cache(maxsize=256)
def _divide(formula: str) -> tuple[float, Mapping[str, int]]:
    """Return the molar mass of a compound (g/mol), and the numbers of its ions. The keys are names of ions."""
    mass, atoms = _atoms(formula)
    body = re.sub(r"\.\d*H2O$", "", _plain(formula))
    charges, ions, end = {0}, dict[str, int](), 0
    while match := _GROUP.match(body, end):
        end = match.end()
        count = int(match[2] or match[4] or 1)
        name, times, choices = _IONS[match[1] or match[3]]
        charges = {charge + count * choice for charge in charges for choice in choices}
        if name:
            ions[name] = ions.get(name, 0) + count * times
    if end == len(body) and 0 in charges:
        return mass, ions
    if {"C", "H"} <= atoms.keys():  # in an organic compound, only the metals of a chelate are counted
        return mass, {name: count for name, count in atoms.items() if name in _METALS}
    raise UserError(f"cannot be divided into the ions {', '.join(IONS)} with zero net charge")


def _plain(formula: str) -> str:
    """Return a formula with a full stop instead of other symbols before the water of crystallisation."""
    return re.sub(r"\s*[.·*]\s*", ".", formula)
