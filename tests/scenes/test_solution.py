"""Nutrient solutions: ions against hand-computed values, factors, and what is refused."""

from pathlib import Path

import pytest

from rhizotwin.scenes import files
from rhizotwin.scenes.compounds import IONS
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.schema import Place
from rhizotwin.scenes.solution import Solution, check_solution, read_solution
from tests.command import Command

KLIMAN = {
    # molar masses by hand: IUPAC 2021 atomic weights, H 1.008, N 14.007, O 15.999, P 30.974, S 32.06, K 39.098, Ca 40.078, Mg 24.305
    "K": 1000 * (0.442 / 101.102 + 0.136 / 136.084),
    "NO3": 1000 * (0.442 / 101.102 + 2 * 0.4859 / 236.146 + 0.69872 / 18 / 80.043),
    "NH4": 1000 * 0.69872 / 18 / 80.043,
    "H2PO4": 1000 * 0.136 / 136.084,
    "Ca": 1000 * 0.4859 / 236.146,
    "Mg": 1000 * 0.2461 / 246.466,
    "Fe": 1000 * 0.01 / 447.18,
    "MoO4": 1000 * 0.00006 / 241.95,
}


CATIONS = {"K": 1, "NH4": 1, "Ca": 2, "Mg": 2, "Na": 1, "Mn": 2, "Zn": 2, "Cu": 2}
CHARGE = {**CATIONS, "NO3": -1, "H2PO4": -1, "SO4": -2, "MoO4": -2, "Cl": -1}


def test_ions_of_the_thesis_recipe() -> None:
    found = Solution(recipe="kliman_2022").ions_mmol_per_l
    assert {ion: found[ion] for ion in KLIMAN} == pytest.approx(KLIMAN, rel=2e-4)
    assert sum(found[ion] * CHARGE.get(ion, 0) for ion in IONS) == pytest.approx(0.0, abs=1e-9)


def test_portions_are_those_of_table_3_1() -> None:
    made = Solution(recipe="kliman_2022").portions(18.0)
    volumes_ml = {"MgSO4": 44.93, "Ca(NO3)2": 51.42, "KH2PO4": 45.00, "Fe chelate": 45.17, "Micronutrient Mix": 4.50}
    assert made.stocks_ml == pytest.approx(volumes_ml, rel=0.01)
    assert made.salts_g == pytest.approx({"NH4NO3": 0.69872, "KNO3": 7.9553}, rel=0.01)


def test_what_a_stock_solution_does_not_supply_is_weighed() -> None:
    """Twice the zinc of the mix (10.8 mg in 18 l) requires 10.8 mg more, without zinc the mix cannot be used."""
    more = Solution(recipe="kliman_2022", factors={"Zn": 2.0}).portions(18.0)
    assert more.stocks_ml["Micronutrient Mix"] == pytest.approx(4.5)
    assert more.salts_g["ZnSO4.7H2O"] == pytest.approx(0.0108)
    without = Solution(recipe="kliman_2022", factors={"Zn": 0.0}).portions(18.0)
    assert "Micronutrient Mix" not in without.stocks_ml
    assert without.salts_g["H3BO3"] == pytest.approx(0.0162)
    assert "ZnSO4.7H2O" not in without.salts_g
    own = Solution(grams_per_l={"KNO3": 0.5}, stocks_g_per_l={"K": {"KNO3": 100.0}}).portions(4.0)
    assert (dict(own.stocks_ml), dict(own.salts_g)) == (pytest.approx({"K": 20.0}), {})


@pytest.mark.parametrize("factor", [0.0, 0.5, 3.0])
@pytest.mark.parametrize(
    ("element", "ions"), [("K", {"K"}), ("N", {"NO3", "NH4"}), ("P", {"H2PO4"}), ("S", {"SO4"}), ("Fe", {"Fe"}), ("Mo", {"MoO4"})]
)
def test_element_is_changed_alone_with_balanced_charge(element: str, ions: set[str], factor: float) -> None:
    whole = Solution(recipe="kliman_2022").ions_mmol_per_l
    found = read_solution(f"kliman_2022,{element}={factor},only").ions_mmol_per_l
    expected = {ion: amount * (factor if ion in ions else 1.0) for ion, amount in whole.items() if ion not in ("Na", "Cl")}
    assert {ion: found[ion] for ion in expected} == pytest.approx(expected, rel=1e-3)
    assert sum(found[ion] * CHARGE.get(ion, 0) for ion in IONS) == pytest.approx(0.0, abs=1e-9)


def test_half_of_the_potassium_is_replaced_by_sodium() -> None:
    """1 mmol/l of each salt; Na2HPO4 has 141.958 g/mol and NaNO3 84.994 g/mol."""
    found = Solution(grams_per_l={"K2HPO4": 0.174176, "KNO3": 0.101102}, factors={"K": 0.5}, only=True).compounds_g_per_l
    assert found == pytest.approx({"K2HPO4": 0.087088, "Na2HPO4": 0.070979, "KNO3": 0.050551, "NaNO3": 0.042497}, rel=1e-4)


@pytest.mark.parametrize(
    ("formula", "ions"),
    [
        ("K2HPO4", {"K": 2, "H2PO4": 1}),
        ("Na2B4O7*10H2O", {"Na": 2, "H3BO3": 4}),
        ("(NH4)6Mo7O24.4H2O", {"NH4": 6, "MoO4": 7}),
        ("C10H12FeN2NaO8", {"Fe": 1, "Na": 1}),
        ("C12H22O11", {}),
    ],
)
def test_compounds_are_divided_into_ions(formula: str, ions: dict[str, int]) -> None:
    found = Solution(grams_per_l={formula: 1.0}).ions_mmol_per_l
    scale = max(found.values()) / max(ions.values()) if ions else 1.0
    assert {ion: amount / scale for ion, amount in found.items() if amount} == pytest.approx(ions)


def test_factors_scale_every_salt_of_the_element() -> None:
    whole, half = Solution(recipe="kliman_2022"), Solution(recipe="kliman_2022", factors={"potassium": 0.5})
    assert half.ions_mmol_per_l["K"] == pytest.approx(0.5 * whole.ions_mmol_per_l["K"])
    assert half.ions_mmol_per_l["Ca"] == whole.ions_mmol_per_l["Ca"]
    nitrogen = Solution(recipe="kliman_2022", factors={"N": 0.5}).ions_mmol_per_l
    assert nitrogen["NO3"] == pytest.approx(0.5 * whole.ions_mmol_per_l["NO3"])
    assert nitrogen["Fe"] == whole.ions_mmol_per_l["Fe"]  # the chelate's nitrogen is no nutrient


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (Solution(grams_per_l={"K2NO3": 1.0}), "with zero net charge"),
        (Solution(grams_per_l={"kno3": 1.0}), "must be a formula"),
        (Solution(recipe="kliman_2022", factors={"Xy": 2.0}), "must be an element"),
        (Solution(recipe="kliman_2022", factors={"Na": 2.0}, only=True), "other than sodium and chlorine"),
        (Solution(recipe="kliman_2022", factors={"KNO3": 2.0}, only=True), "to be changed alone, not KNO3"),
        (Solution(grams_per_l={"C10H12FeKN2O8": 0.1}, factors={"K": 0.5}, only=True), "also contains Fe; use another chelate"),
        (Solution(recipe="kliman_2022", stocks_g_per_l={"A": {"K2NO3": 1.0}}), "with zero net charge"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(wrong: Solution, said: str) -> None:
    with pytest.raises(UserError, match=said) as caught:
        check_solution(wrong, Place("x.toml").at("solution"))
    assert "\n" not in str(caught.value)


def test_a_scene_file_holds_it_and_the_command_line_reads_it(tmp_path: Path) -> None:
    stocks = {"my mix": {"KNO3": 100.0}}
    own = Solution(recipe="kliman_2022", grams_per_l={"Ca(NO3)2.4H2O": 0.5}, factors={"K": 0.25}, only=True, stocks_g_per_l=stocks)
    plain = {"recipe": "kliman_2022", "only": True, "grams_per_l": own.grams_per_l, "factors": {"K": 0.25}, "stocks_g_per_l": stocks}
    scene = files.scene_from_dict({"solution": plain}, where="x")
    assert scene.solution == own
    files.save_scene(scene, tmp_path / "a.toml")
    (tmp_path / "s.toml").write_text(
        'recipe = "kliman_2022"\n[grams_per_l]\n"Ca(NO3)2.4H2O" = 0.5\n[stocks_g_per_l."my mix"]\nKNO3 = 100.0\n'
    )
    assert read_solution(f"{tmp_path / 's.toml'},K=0.25,only") == own
    assert {scene: 1}[files.load_scene(tmp_path / "a.toml")] == 1, "scenes with solutions can be keys"
    assert scene != files.scene_from_dict({"solution": {"recipe": "kliman_2022"}}, where="x")


def test_command_prints_portions(command: Command) -> None:
    out = command.works("scenes", "--solution", "kliman_2022", "--litres", "18").out
    assert [line.split()[:3] for line in out.splitlines() if line.startswith(("KNO3", "Micronutrient"))] == [
        ["KNO3", "0.442", "7.956"],
        ["Micronutrient", "Mix", "4.5"],
        ["KNO3", "7.956"],
    ]
    command.fails("scenes", "--litres", "18", named=["add --solution"])
