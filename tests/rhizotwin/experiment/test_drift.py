"""Control charts against hand-computed limits, and the caution beside an effect."""

from itertools import product

import numpy as np
import pytest

from rhizotwin.experiment.drift import BY_NAME, RIG_NUMBERS, chart_of, effect_of, rig_numbers
from rhizotwin.experiment.growth import measure
from rhizotwin.experiment.growth_page import drift_cautions, sentences
from rhizotwin.experiment.measured import read_all

DAYS = range(10)


def test_limits_by_hand():
    """Moving ranges 2, 1, 1, 2: mean 1.5, over 1.128."""
    chart = chart_of([3.0, 0.0, 1.0, 2.0, 4.0], [12.0, 10.0, 12.0, 11.0, 14.0])
    assert chart.times == (0.0, 1.0, 2.0, 3.0, 4.0)
    assert chart.values == (10.0, 12.0, 11.0, 12.0, 14.0)
    assert chart.centre == pytest.approx(11.8)
    assert chart.sigma == pytest.approx(1.5 / 1.128)
    assert chart.limits == pytest.approx((11.8 - 3.0 * 1.5 / 1.128, 11.8 + 3.0 * 1.5 / 1.128))
    few = chart_of([0.0, 1.0, 2.0], [1.0, 5.0, 1.0])
    assert (few.limits, few.outside, few.has_trend, few.change) == (None, (), False, 0.0)
    # the mean of ten times 1.0003 is 1.0002999999999997
    equal = [chart_of(range(count), [value] * count) for value in (0.1, 0.7, 1.0003) for count in range(4, 11)]
    assert {(one.outside, one.change) for one in equal} == {((), 0.0)}


def test_steady_rig_raises_few_alarms():
    """Of normal values about 0.3 % lie beyond 3 standard deviations; limits from twenty ranges are less sure."""
    rng = np.random.default_rng(43)
    charts = [chart_of(range(20), rng.normal(1.0, 0.001, 20)) for _ in range(300)]
    assert sum(len(one.outside) for one in charts) / 6000 < 0.01
    assert sum(one.has_trend for one in charts) / 300 < 0.08


def test_a_step_and_a_trend_are_found():
    rng = np.random.default_rng(1)
    step = chart_of(range(20), rng.normal(1.0, 0.0005, 20) + 0.01 * (np.arange(20) >= 15))
    assert step.outside
    trend = chart_of(range(20), rng.normal(1.0, 0.0005, 20) + 0.001 * np.arange(20))
    assert trend.has_trend
    assert trend.change == pytest.approx(0.019, rel=0.2)


def test_caution_only_beside_effects_as_small_as_the_drift():
    chart = chart_of(DAYS, [1.0 + 0.002 * day for day in DAYS])
    assert effect_of(chart, BY_NAME["focal_left"], "total_length") == pytest.approx(1.018, abs=1e-3)
    assert effect_of(chart, BY_NAME["focal_left"], "volume") == pytest.approx(1.018**3, abs=2e-3)
    assert effect_of(chart, BY_NAME["blur_px"], "volume") == 1.0
    (caution,) = drift_cautions({"focal_left": chart}, "volume", 1.04)
    assert "the focal length changed by 1.8 % during the experiment, which could change the volume by 5.4 %" in caution
    assert drift_cautions({"focal_left": chart}, "volume", 0.8) == drift_cautions({"focal_left": chart}, "tips", 1.001) == []


def test_rig_numbers_of_a_result():
    tilted = [[1.0, 0.0, 0.0, 0.0], [0.0, np.cos(0.01), 0.0, 0.0], [0.0, 0.0, np.cos(0.01), 0.0], [0.0, 0.0, 0.0, 1.0]]
    rig, sharpness = {"table_from_canister": tilted, "focal_scale_found": None}, {"name": "sharpness", "value": 0.4}
    found = rig_numbers({"rig": rig, "checks": [sharpness]})
    assert found == {"table_tilt_deg": pytest.approx(np.rad2deg(0.01)), "blur_px": 0.4}
    assert set(found) <= {one.name for one in RIG_NUMBERS}
    assert rig_numbers({}) == {}
    corrected = rig_numbers({"rig": {"focal_scale_found": 1.02, "focal_scale": 1.02}})
    assert corrected == {"focal_scale": 1.02, "focal_left": 1.0}


def test_growth_says_so_beside_a_small_effect(ball_result):
    """Plants of two treatments differ by 2 % while the focal length rises by 2 %, which is 6 % of volume."""
    folders, rng = [], np.random.default_rng(43)
    for treatment, number, day in product(("control", "low N"), range(3), range(5, 10)):
        whose = {"plant": f"{treatment} {number}", "treatment": treatment, "day": float(day)}
        volume = 900.0 * (1.0 if treatment == "control" else 0.98) * 1.1**day * float(rng.normal(1.0, 0.002))
        rig, span = {"focal_scale_found": 1.0 + 0.005 * (day - 5) + 1e-5 * number}, [0.98 * volume, 1.02 * volume]
        folders.append(ball_result(f"{whose['plant']}_{day}", subject=whose, volume_mm3=volume, volume_interval_mm3=span, rig=rig))
    growth = measure(read_all(folders))
    assert growth.drift["focal_left"].has_trend
    (caution,) = [one for one in sentences(growth) if "caution" in one]
    assert "the focal length changed by 2 % during the experiment" in caution
    assert "as much as the treatments differ" in caution


def test_scans_of_a_day_keep_their_order(ball_result):
    """Sorted by value, the moving ranges of five scans on each of two days were too small."""
    values = [1.0, 5.0, 2.0, 6.0, 3.0, 4.0, 1.0, 5.0, 2.0, 6.0]
    subjects = [{"plant": f"P{number % 5}", "day": 1.0 + number // 5} for number in range(10)]
    rigs = [{"table_correction_deg": value} for value in values]
    folders = [ball_result(f"scan_{k}", subject=own, rig=rig) for k, (own, rig) in enumerate(zip(subjects, rigs, strict=True))]
    assert measure(read_all(folders)).drift["table_steps_deg"].values == tuple(values)
