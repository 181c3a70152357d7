"""Nutrient solutions: ions against hand-computed values, factors, and what is refused."""

from pathlib import Path

import pytest

from rhizotwin.scenes import files
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.schema import Place
from rhizotwin.scenes.solution import IONS, Solution, check_solution, read_solution

KLIMAN = {
    # molar masses by hand: IUPAC 2021 atomic weights, H 1.008, N 14.007, O 15.999, P 30.974, S 32.06, K 39.098, Ca 40.078, Mg 24.305
    "K": 1000 * (0.442 / 101.102 + 0.136 / 136.084),
    "NO3": 1000 * (0.442 / 101.102 + 2 * 0.4859 / 236.146 + 0.038 / 80.043),
    "NH4": 1000 * 0.038 / 80.043,
    "H2PO4": 1000 * 0.136 / 136.084,
    "Ca": 1000 * 0.4859 / 236.146,
    "Mg": 1000 * 0.2461 / 246.466,
    "Fe": 1000 * 0.01 / 447.18,
    "MoO4": 1000 * 0.00006 / 241.95,
}


def test_ions_of_the_thesis_recipe() -> None:
    found = Solution(recipe="kliman_2022").ions_mmol_per_l
    assert {ion: found[ion] for ion in KLIMAN} == pytest.approx(KLIMAN, rel=2e-4)
    charge = {"K": 1, "NH4": 1, "Ca": 2, "Mg": 2, "Na": 1, "Mn": 2, "Zn": 2, "Cu": 2, "NO3": -1, "H2PO4": -1, "SO4": -2, "MoO4": -2}
    assert sum(found[ion] * charge.get(ion, 0) for ion in IONS) == pytest.approx(0.0, abs=1e-9)


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
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(wrong: Solution, said: str) -> None:
    with pytest.raises(UserError, match=said) as caught:
        check_solution(wrong, Place("x.toml").at("solution"))
    assert "\n" not in str(caught.value)


def test_a_scene_file_holds_it_and_the_command_line_reads_it(tmp_path: Path) -> None:
    own = Solution(recipe="kliman_2022", grams_per_l={"Ca(NO3)2.4H2O": 0.5}, factors={"K": 0.25})
    plain = {"recipe": "kliman_2022", "grams_per_l": own.grams_per_l, "factors": {"K": 0.25}}
    scene = files.scene_from_dict({"solution": plain}, where="x")
    assert scene.solution == own
    files.save_scene(scene, tmp_path / "a.toml")
    (tmp_path / "s.toml").write_text('recipe = "kliman_2022"\n[grams_per_l]\n"Ca(NO3)2.4H2O" = 0.5\n')
    assert read_solution(f"{tmp_path / 's.toml'},K=0.25") == own
    assert {scene: 1}[files.load_scene(tmp_path / "a.toml")] == 1, "scenes with solutions can be keys"
    assert scene != files.scene_from_dict({"solution": {"recipe": "kliman_2022"}}, where="x")
