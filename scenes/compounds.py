"""Formulas of compounds: their molar masses, and the ions into which they dissolve.

A formula is divided into the groups of `GROUPS`. Atomic masses are taken from molmass (IUPAC). Phosphate and carbonate
are counted in the form that prevails between pH 5 and 7, and boron as boric acid. Of organic compounds, such as iron
chelates, only the metal is counted.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

from rhizotwin.scenes.errors import UserError

GROUPS: Mapping[str, tuple[str, int, tuple[int, ...]]] = {
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
"""Groups of which formulas consist. The values are the name of the ion (empty for acid and alkali), the number of ions
per group, and the possible charges of the group."""
IONS = tuple(dict.fromkeys(name for name, _, _ in GROUPS.values() if name))
"""Names of all ions, in the order in which they are listed in tables."""
_METALS = frozenset({"K", "Ca", "Mg", "Fe", "Mn", "Zn", "Cu", "Ni", "Co", "Na"})
NUTRIENTS = _METALS | {"N", "P", "S", "B", "Mo", "Cl", "I", "Si", "C"}
"""Symbols of the elements for which a factor can be specified."""
BALANCING = frozenset({"Na", "Cl"})
"""Ions that may change if the concentration of a single element is changed."""
_NAMES = "|".join(sorted(GROUPS, key=len, reverse=True))
_GROUP = re.compile(rf"({_NAMES})(\d*)|\(({_NAMES})\)(\d*)")
_MOST_LETTERS = 80
"""Maximum length of a formula in characters. The longest chelate in use has 25 characters."""
_SIZES = {"mmol": 1.0, "umol": 1e-3, "mg": 1.0, "ug": 1e-3}
"""Units of an amount (mmol) and of a mass (mg), with their sizes."""


@dataclass(frozen=True)
class Divided:
    """Compound that is divided into groups."""

    g_per_mol: float
    """Molar mass."""
    groups: Mapping[str, int]
    """Number of each group, keyed by the names in `GROUPS`. Of organic compounds, only metals are counted."""
    is_organic: bool
    """Whether the compound is organic, such as a chelate."""

    @property
    def ions(self) -> dict[str, int]:
        """Number of each ion, keyed by the names in `IONS`."""
        found: dict[str, int] = {}
        for group, count in self.groups.items():
            name, times, _ = GROUPS[group]
            if name:
                found[name] = found.get(name, 0) + count * times
        return found


@lru_cache(maxsize=256)
def divide(formula: str) -> Divided:
    """Divide a compound into groups.

    Raises
    ------
    UserError
        If the text is not a formula, or the compound cannot be divided into groups with zero net charge.
    """
    mass, elements = _atoms(formula)
    body = re.sub(r"\.\d*H2O$", "", _plain(formula))
    charges, groups, end = {0}, dict[str, int](), 0
    while match := _GROUP.match(body, end):
        end = match.end()
        count = int(match[2] or match[4] or 1)
        name = match[1] or match[3]
        charges = {charge + count * choice for charge in charges for choice in GROUPS[name][2]}
        groups[name] = groups.get(name, 0) + count
    if end == len(body) and 0 in charges:
        return Divided(mass, groups, is_organic=False)
    if {"C", "H"} <= elements.keys():
        return Divided(mass, {name: count for name, count in elements.items() if name in _METALS}, is_organic=True)
    raise UserError(f"cannot be divided into the ions {', '.join(IONS)} with zero net charge")


def contains(formula: str, element: str) -> bool:
    """Return whether a group or an ion of a compound contains an element, given by its symbol."""
    return element in NUTRIENTS and any(element in elements(group) for group in divide(formula).groups)


def elements(formula: str) -> frozenset[str]:
    """Return the symbols of the elements in a formula."""
    return frozenset(_atoms(formula)[1])


def symbol(element: str) -> str:
    """Return the symbol of an element, which is given by its symbol or its English name.

    Other texts are returned unchanged.
    """
    from molmass import ELEMENTS

    return next((str(one.symbol) for one in ELEMENTS if one.name.lower() == element.lower()), element)


def balanced_salt(group: str) -> str:
    """Return the formula of the compound of one group with sodium or chloride, such as ``CaCl2`` for ``Ca``."""
    charge = GROUPS[group][2][0]
    number = "" if abs(charge) == 1 else str(abs(charge))
    if charge == 0:
        return group
    return f"{group}Cl{number}" if charge > 0 else f"Na{number}{group}"


def replace_alone(formula: str, element: str, factor: float) -> dict[str, float]:
    """Replace a compound by compounds in which only the amount of one element is changed.

    If the factor is below 1, part of the compound is removed, and its other ions are added as salts with sodium or
    chloride. Otherwise, such a salt of the element's ion is added to the compound.

    Parameters
    ----------
    formula : str
        Formula of the compound.
    element : str
        Symbol of the element.
    factor : float
        Factor for the amount of the element.

    Returns
    -------
    dict of float
        Mass of each compound in grams per gram of the replaced compound.

    Raises
    ------
    UserError
        If the compound is a chelate that contains another metal.
    """
    whole = divide(formula)
    mine = {group: count for group, count in whole.groups.items() if element in elements(group)}
    others = {group: count for group, count in whole.groups.items() if group not in mine and group not in BALANCING}
    if not others:
        return {formula: factor}
    if whole.is_organic:
        raise UserError(f"{element} cannot be changed alone, because {formula} also contains {', '.join(others)}; use another chelate")
    found = {formula: min(factor, 1.0)}
    for group, count in (others if factor < 1.0 else mine).items():
        salt = balanced_salt(group)
        found[salt] = found.get(salt, 0.0) + abs(1.0 - factor) * count * divide(salt).g_per_mol / whole.g_per_mol
    return found


def mmol_per_unit(group: str, unit: str) -> float:
    """Return the amount of an ion, in mmol, that corresponds to one unit of a group.

    Parameters
    ----------
    group : str
        Name of a group with an ion, such as ``PO4``.
    unit : str
        ``mmol`` or ``umol`` of the group, ``mg`` or ``ug`` of the group, or such a mass of one of its elements, such as
        ``mg_P``.

    Raises
    ------
    UserError
        If the unit is unknown.
    """
    size, _, element = unit.partition("_")
    mass, counts = _atoms(group)
    is_mass = size in ("mg", "ug")
    if size not in _SIZES or (element and not (is_mass and element in counts)):
        raise UserError(f"the unit must be {', '.join(_SIZES)}, or the mass of an element, such as mg_{next(iter(counts))}")
    g_per_mol = _atoms(element)[0] * counts[element] if element else mass
    return _SIZES[size] * GROUPS[group][1] / (g_per_mol if is_mass else 1.0)


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


def _plain(formula: str) -> str:
    """Return a formula with a full stop instead of other symbols before the water of crystallisation."""
    return re.sub(r"\s*[.·*]\s*", ".", formula)
