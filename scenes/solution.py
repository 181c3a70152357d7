"""Nutrient solutions: mass concentrations of compounds, the resulting ion concentrations, and their preparation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from rhizotwin.scenes import compounds
from rhizotwin.scenes.compounds import IONS
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
        "NH4NO3": 0.03882,
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
"""Mass concentrations of the compounds in each recipe, g/l. ``kliman_2022`` is table 3.1 of the thesis. The mass of
NH4NO3 in this table (0.69872 g in 18 l) contradicts its concentration (0.038 g/l), and is used instead."""
STOCKS: Mapping[str, Mapping[str, Mapping[str, float]]] = {
    "kliman_2022": {
        "MgSO4": {"MgSO4.7H2O": 98.59},
        "Ca(NO3)2": {"Ca(NO3)2.4H2O": 170.1},
        "KH2PO4": {"KH2PO4": 54.4},
        "Fe chelate": {"C14H21FeN3O10": 3.985},
        "Micronutrient Mix": {
            "H3BO3": 3.6,
            "MnSO4.H2O": 3.2,
            "Na2MoO4.2H2O": 0.24,
            "CuSO4.5H2O": 0.36,
            "ZnSO4.7H2O": 2.4,
        },
    }
}
"""Stock solutions of each recipe: mass concentrations of their compounds, g/l. Those of ``kliman_2022`` are the ratio
of the concentration in table 3.1 to the volume of concentrate for 18 l."""
LITRES = (1e-3, 1e6)
"""Minimum and maximum volume of a solution to be prepared, l."""
_FLOAT_ROUNDING = 1e-9
"""Fraction of a compound up to which the part that is not supplied by stock solutions is regarded as zero."""


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
    only: bool = False
    """Whether factors change the ions of their element alone. The charge is balanced by sodium or chloride, and the
    other ions remain unchanged."""
    stocks_g_per_l: dict[str, dict[str, float]] = field(default_factory=dict, hash=False, metadata={"limits": (1e-6, 10000.0)})
    """Stock solutions with the mass concentrations of their compounds in grams per litre. The keys are names and
    formulas. These stock solutions are used in addition to those of the recipe, and replace those of the same name."""

    @property
    def known(self) -> bool:
        """Whether the solution is known, which requires at least one concentration or a recipe."""
        return bool(self.recipe or self.grams_per_l)

    @property
    def compounds_g_per_l(self) -> dict[str, float]:
        """Mass concentrations of the compounds after multiplication by the factors, g/l. The keys are formulas."""
        found = {**RECIPES.get(self.recipe, {}), **self.grams_per_l}
        for what, factor in self.factors.items():
            before, found = found, {}
            for name, grams in before.items():
                changed = {name: 1.0}
                if _holds(name, what):
                    changed = compounds.replace_alone(name, compounds.symbol(what), factor) if self.only else {name: factor}
                for formula, share in changed.items():
                    found[formula] = found.get(formula, 0.0) + share * grams
        return found

    @property
    def stocks(self) -> dict[str, Mapping[str, float]]:
        """Stock solutions of the recipe and of the user, with the mass concentrations of their compounds, g/l."""
        return {**STOCKS.get(self.recipe, {}), **self.stocks_g_per_l}

    @property
    def ions_mmol_per_l(self) -> dict[str, float]:
        """Concentrations of all ions in `IONS`, mmol/l. Concentrations of absent ions are 0.

        The result is empty if the solution is unknown.
        """
        if not self.known:
            return {}
        total = dict.fromkeys(IONS, 0.0)
        for formula, grams in self.compounds_g_per_l.items():
            divided = compounds.divide(formula)
            for name, count in divided.ions.items():
                total[name] += 1000.0 * grams / divided.g_per_mol * count
        return total

    def portions(self, litres: float) -> "Portions":
        """Return the volumes of stock solutions and the masses of salts in a volume of the solution.

        Of each stock solution, as much is used as none of its compounds exceeds. The rest is weighed as salt.

        Parameters
        ----------
        litres : float
            Volume of the nutrient solution, l.
        """
        needed = {formula: litres * grams for formula, grams in self.compounds_g_per_l.items()}
        left, stocks_ml = dict(needed), dict[str, float]()
        for name, contents in self.stocks.items():
            stock_l = min((left.get(formula, 0.0) / grams for formula, grams in contents.items()), default=0.0)
            if stock_l > 0.0:
                stocks_ml[name] = 1000.0 * stock_l
                left |= {formula: left[formula] - stock_l * grams for formula, grams in contents.items()}
        salts = {formula: grams for formula, grams in left.items() if grams > _FLOAT_ROUNDING * needed[formula]}
        return Portions(stocks_ml=stocks_ml, salts_g=salts)

    def __str__(self) -> str:
        """Return the recipe, the added compounds and the factors on one line.

        The line is empty if the solution is unknown.
        """
        own = [f"{name} {grams:g} g/l" for name, grams in self.grams_per_l.items()]
        alone = " only" if self.only else ""
        return ", ".join([*filter(None, [self.recipe]), *own, *(f"{what} x {factor:g}{alone}" for what, factor in self.factors.items())])


@dataclass(frozen=True, kw_only=True)
class Portions:
    """Portions from which a nutrient solution is prepared."""

    stocks_ml: Mapping[str, float]
    """Volume of each stock solution, ml."""
    salts_g: Mapping[str, float]
    """Mass of each salt that is weighed, g."""


def check_solution(solution: Solution, place: Place) -> None:
    """Reject compounds that cannot be divided into ions.

    Also reject factors for substances that are not in the solution, and factors for a single element that cannot be
    balanced.

    Raises
    ------
    UserError
        If a compound or factor is invalid; the message states the compound or factor and the condition.
    """
    named: list[tuple[str, ...]] = [("grams_per_l", formula) for formula in solution.grams_per_l]
    named += [("stocks_g_per_l", name, formula) for name, contents in solution.stocks_g_per_l.items() for formula in contents]
    for *section, formula in named:
        try:
            compounds.divide(formula)
        except UserError as error:
            raise place.at(*section, formula).error(str(error)) from None
    known = {**RECIPES.get(solution.recipe, {}), **solution.grams_per_l}
    for what in solution.factors:
        if not any(_holds(formula, what) for formula in known):
            has = ", ".join(known) or "none"
            raise place.at("factors", what).error(
                f"must be an element (K, N, potassium) or a compound of the solution, whose compounds are {has}"
            )
        if solution.only and (alone := compounds.symbol(what)) not in compounds.NUTRIENTS - compounds.BALANCING:
            raise place.at("factors", what).error(f"must be an element other than sodium and chlorine to be changed alone, not {alone}")
    try:
        solution.compounds_g_per_l  # noqa: B018
    except UserError as error:
        raise place.at("factors").error(str(error)) from None


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

    The word ``only`` after the factors changes their elements alone.

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
    alone = {"only": True} if "only" in changes else {}
    for change in (one for one in changes if one != "only"):
        what, _, factor = change.partition("=")
        try:
            factors[what.strip()] = float(factor)
        except ValueError:
            raise UserError(f"--solution {text}: {change!r} is not a factor; specify ELEMENT=FACTOR, such as K=0.5, and only") from None
    solution = from_plain(Solution, {**table, **({"factors": factors} if factors else {}), **alone}, place)
    check_solution(solution, place)
    return solution


def _holds(formula: str, what: str) -> bool:
    """Return whether a substance is in a compound.

    It can be the formula of the compound, or an element of one of its ions.
    """
    return formula == what or compounds.contains(formula, compounds.symbol(what))
