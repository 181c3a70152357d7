"""Readings of the nutrient solution, and the uptake per root length, against values computed by hand."""

from math import e, exp, log
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.experiment import uptake
from rhizotwin.experiment.compare import Observation
from rhizotwin.experiment.measured import IN_90
from rhizotwin.experiment.readings import Reading, merge, read_readings
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.subject import Subject
from tests.command import Command

Roots = list[tuple[float, float]]


def table(folder: Path, text: str) -> Path:
    """Write a table."""
    path = folder / "solution.csv"
    path.write_text(text)
    return path


def measure(path: Path, roots: Roots, log_sigma: float = 0.0) -> list[uptake.Uptake]:
    """Measure the uptake of P1, whose root length in mm is known on some days."""
    lengths = [Observation(plant="P1", treatment="", day=day, value=value, log_sigma=log_sigma) for day, value in roots]
    return uptake.measure(merge(read_readings(path)), lengths)


def reading(day: float, values: dict[str, float], sds: dict[str, float]) -> Reading:
    """Return a reading of P1."""
    return Reading(where="", subject=Subject(plant="P1", day=day), renewed=False, values=values, sds=sds)


def test_units_are_converted(tmp_path: Path) -> None:
    """Molar masses by hand: K 39.098, NO3 62.004, N 14.007, PO4 94.970, Fe 55.845."""
    head = "plant;day;EC_uS_per_cm;volume_ml;volume_sd_ml;K_mg_per_l;NO3_mg_N_per_l;PO4_mg_per_l;Fe_ug_per_l;Ca_umol_per_l"
    (one,) = read_readings(table(tmp_path, f"{head}\nP1;7;1850;1400;10;39,098;14,007;94,97;558,45;2050\n"))
    assert one.values == pytest.approx({"EC": 1.85, "volume": 1.4, "K": 1.0, "NO3": 1.0, "H2PO4": 1.0, "Fe": 0.01, "Ca": 2.05}, rel=1e-4)
    assert one.sds == pytest.approx({"volume": 0.01})


def test_uptake_over_the_logarithmic_mean_length(tmp_path: Path) -> None:
    """5 mmol/l in 1.4 l and 4 mmol/l in 1.25 l are 7 and 5 mmol. Roots that grow from 10 to 10 e m have the mean 10 (e - 1) m."""
    path = table(tmp_path, "plant,day,volume_ml,K_mmol_per_l,K_sd_mmol_per_l,volume_sd_ml\nP1,5,1400,5,0.1,10\nP1,9,1250,4,0.1,10\n")
    (one,) = measure(path, [(5.0, 1e4), (9.0, 1e4 * e)], log_sigma=0.05)
    assert one.depletion_umol == pytest.approx(2000.0)
    assert one.length_m == pytest.approx(10.0 * (e - 1.0))
    assert one.rate == pytest.approx(2000.0 / (10.0 * (e - 1.0) * 4.0))
    sd_umol = 1000.0 * ((1.4 * 0.1) ** 2 + (5.0 * 0.01) ** 2 + (1.25 * 0.1) ** 2 + (4.0 * 0.01) ** 2) ** 0.5
    assert one.depletion_sd_umol == pytest.approx(sd_umol)
    assert one.rate_interval is not None
    relative = ((sd_umol / 2000.0) ** 2 + 0.05**2) ** 0.5
    assert np.array(one.rate_interval) / one.rate == pytest.approx([1.0 - IN_90 * relative, 1.0 + IN_90 * relative])


def test_evaporation_is_no_uptake_and_renewals_end_intervals(tmp_path: Path) -> None:
    rows = "P1,1,no,1500,2\nP1,4,no,1000,3\nP1,4,yes,1500,2\nP1,8,,1500,1\n"
    found = measure(table(tmp_path, f"plant,day,renewed,volume_ml,NO3_mmol_per_l\n{rows}"), [(4.0, 1e4), (6.0, 2e4), (10.0, 2e4)])
    assert [(one.days, one.depletion_umol) for one in found] == [((1.0, 4.0), pytest.approx(0.0)), ((4.0, 8.0), pytest.approx(1500.0))]
    assert found[0].rate is None, "the root length before day 4 is unknown"
    mean_m = (2.0 * 10.0 / log(2.0) + 2.0 * 20.0) / 4.0  # 10 to 20 m in two days, then constant
    assert found[1].rate == pytest.approx(1500.0 / (mean_m * 4.0))
    assert found[1].rate_interval is None


def test_interval_contains_the_true_rate() -> None:
    """In 90 % of 4000 simulated experiments; the lengths of a plant have a common error."""
    rng = np.random.default_rng(5)
    inside = []
    for _ in range(4000):
        volumes, amounts = np.array([1.5, 1.2]), np.array([6.0, 4.8])
        sds = {"K": 0.1, "volume": 0.02}
        values = [{"K": rng.normal(a / v, 0.1), "volume": rng.normal(v, 0.02)} for a, v in zip(amounts, volumes, strict=True)]
        scale = exp(rng.normal(0.0, 0.1))
        readings = [reading(day, own, sds) for day, own in zip((0.0, 3.0), values, strict=True)]
        roots = [Observation(plant="P1", treatment="", day=d, value=v * scale, log_sigma=0.1) for d, v in ((0.0, 5e3), (3.0, 8e3))]
        (one,) = uptake.measure(readings, roots)
        assert one.rate_interval is not None
        low, high = one.rate_interval
        inside.append(low <= 1200.0 / (3.0 / log(1.6) * 3.0) <= high)
    assert 0.88 < np.mean(inside) < 0.92


WRONG = {
    "unknown column": ("plant,day,ph\nP1,1,5\n", "column 'ph' is unknown (did you mean 'pH'?)"),
    "no unit": ("plant,day,K\nP1,1,5\n", "such as mmol_per_l"),
    "wrong unit": ("plant,day,K_kg_per_l\nP1,1,5\n", "the unit must be mmol, umol, mg, ug"),
    "element": ("plant,day,K_mg_N_per_l\nP1,1,5\n", "such as mg_K"),
    "unit of EC": ("plant,day,EC_S_per_m\nP1,1,5\n", "must be mS_per_cm, uS_per_cm, dS_per_m"),
    "twice": ("plant,day,K_mmol_per_l,K_mg_per_l\nP1,1,5,5\n", "contain the same quantity"),
    "sd alone": ("plant,day,pH,K_sd_mmol_per_l\nP1,1,5,5\n", "no column with the values of K"),
    "pH": ("plant,day,pH\nP1,1,55\n", "line 2: pH is 55, but must be between 0 and 14"),
    "EC in the wrong unit": ("plant,day,EC_mS_per_cm\nP1,1,1850\n", "must be between 0 and 250"),
    "negative": ("plant,day,K_mmol_per_l\nP1,1,-1\n", "must be at least 0"),
    "volume": ("plant,day,pH,volume_ml\nP1,1,5,0\n", "must be above 0"),
    "text": ("plant,day,pH\nP1,1,acid\n", "not a number"),
    "day": ("plant,day,pH\nP1,,5\n", "the day is missing"),
    "plant": ("plant,day,pH\n,1,5\n", "the plant is missing"),
    "renewed": ("plant,day,renewed,pH\nP1,1,maybe,5\n", "must be yes or no"),
    "same day": ("plant,day,pH\nP1,1,5\nP1,1,6\n", "the pH of plant P1 on day 1 is listed twice"),
    "treatment": ("plant,day,treatment,pH\nP1,1,a,5\nP1,2,b,6\n", "has two treatments, 'a' and 'b'"),
}


@pytest.mark.parametrize(("text", "said"), WRONG.values(), ids=WRONG)
def test_wrong_tables_are_refused_in_one_sentence(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(UserError) as caught:
        merge(read_readings(table(tmp_path, text)))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_growth_writes_the_uptake(tmp_path: Path, command: Command) -> None:
    """The readings of a laboratory and of a meter are in two tables, whose treatments are those of the results."""
    traits = tmp_path / "traits.csv"
    head = "plant,day,treatment,total_length (mm),total_length_low,total_length_high,total_length_verdict\n"
    rows = [
        f"{plant},{day},{how},{length},{0.9 * length},{1.1 * length},reliable\n"
        for plant, how in (("P1", "control"), ("P2", "low K"))
        for day, length in ((5, 1000.0), (10, 3000.0))
    ]
    traits.write_text(head + "".join(rows))
    meter = table(tmp_path, "plant,day,pH,volume_ml,volume_sd_ml\nP1,5,5.8,1400,5\nP1,10,6.4,1300,5\nP2,5,5.8,1400,5\nP2,10,6.1,1350,5\n")
    ions = tmp_path / "laboratory.csv"
    ions.write_text("plant,day,K_mmol_per_l,K_sd_mmol_per_l\nP1,5,5.4,0.05\nP1,10,5.2,0.05\nP2,5,2.7,0.05\nP2,10,2.6,0.05\n")
    out = command.works("growth", traits, meter, ions, "-o", tmp_path / "growth").out
    assert "uptake of K: 29.7 to 87.9 umol per metre of root and day (2 intervals of 2 plants)" in out
    lines = (tmp_path / "growth" / "uptake.csv").read_text().splitlines()
    assert lines[1].startswith("P1,control,K,5,10,800,")
    assert (tmp_path / "growth" / "solution.png").stat().st_size > 10_000
    assert "Nutrient solution" in (tmp_path / "growth" / "growth.html").read_text()
    alone = command.works("growth", meter, "-o", tmp_path / "alone").out
    assert "uptake of" not in alone
