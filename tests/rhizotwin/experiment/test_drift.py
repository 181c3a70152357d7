"""Control charts against hand-computed limits, and the caution beside an effect."""

from itertools import product

import numpy as np
import pytest

from rhizotwin.experiment.drift import BY_NAME, chart_of, effect_of
from rhizotwin.experiment.growth import measure
from rhizotwin.experiment.growth_page import drift_cautions, sentences
from rhizotwin.experiment.measured import read_all

DAYS = range(10)


def test_limits_by_hand():
    """Moving ranges 2, 1, 1, 2: mean 1.5, over 1.128."""
    chart = chart_of([3.0, 0.0, 1.0, 2.0, 4.0], [12.0, 10.0, 12.0, 11.0, 14.0])
    assert chart.centre == pytest.approx(11.8)
    assert chart.sigma == pytest.approx(1.5 / 1.128)
    assert chart.limits == pytest.approx((11.8 - 3.0 * 1.5 / 1.128, 11.8 + 3.0 * 1.5 / 1.128))
    few = chart_of([0.0, 1.0, 2.0], [1.0, 5.0, 1.0])
    assert (few.limits, few.outside, few.has_trend, few.change) == (None, (), False, 0.0)
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
