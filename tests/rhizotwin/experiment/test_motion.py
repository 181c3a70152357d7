"""Motion of root tips: fit to pictures of the twin, rates with intervals, and circumnutation."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from rhizotwin.experiment import motion, tip_fit
from rhizotwin.experiment.smoothing import smooth
from rhizotwin.scenes import series
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.files import load_profile, load_scene
from rhizotwin.scenes.rsml_reader import read_rsml
from rhizotwin.scenes.specimens import GrownSpecimen, RootOrder
from rhizotwin.steps import front_door
from rhizotwin.stored import result_files

HOURS = np.linspace(0.0, 24.0, 49)


def test_rates_are_in_their_intervals():
    """The rate of a straight line, and that of an oscillation of six periods, with noise of a tenth of its amplitude."""
    rng, inside, wide = np.random.default_rng(1), list[float](), list[float]()
    for _ in range(5):
        wave = 2.0 * np.pi * HOURS / 4.0
        found = smooth(HOURS, 0.3 * np.sin(wave) + rng.normal(0.0, 0.03, 49))
        inside.append(float(np.mean(np.abs(found.rate - 0.3 * np.pi / 2.0 * np.cos(wave)) < 1.645 * found.rate_sigma)))
        wide.append(float(found.rate_sigma.mean()))
        line = smooth(HOURS, 0.04 * HOURS + rng.normal(0.0, 0.03, 49))
        assert abs(line.mean_rate - 0.04) < 4.0 * line.mean_rate_sigma < 0.006
    assert np.mean(inside) > 0.85
    assert np.mean(wide) < 0.1  # the rate is up to 0.47


def test_circumnutation_is_found_only_where_there_is_one():
    rng, phase = np.random.default_rng(2), 2.0 * np.pi * HOURS / 3.0
    path = np.stack([0.0 * HOURS, 0.01 * HOURS, -0.04 * HOURS], axis=1) + rng.normal(0.0, 0.02, (49, 3))
    assert motion.find_nutation(HOURS, path, wave_mm=0.01) is None
    circle = np.stack([np.cos(phase), -0.5 * np.sin(phase), 0.0 * phase], axis=1)
    found = motion.find_nutation(HOURS, path + 0.2 * circle, wave_mm=0.01)
    assert found is not None
    assert found.period_interval_h[0] < 3.0 < found.period_interval_h[1]
    assert found.radii_mm == pytest.approx((0.2, 0.1), abs=4.0 * found.sigma_mm)
    assert not found.is_counterclockwise
    assert motion.find_nutation(HOURS, path + 0.2 * circle, wave_mm=0.15) is None


def test_tips_are_fitted_to_few_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The roots of the first day are given; eight small pictures show their tips 12 h later."""
    tap = RootOrder(elongation_mm_per_day=1.0, max_length_mm=1000.0, length_sd=0.0, interlateral_mm=9.0, gravitropism_per_mm=0.1)
    plant = GrownSpecimen(seed=4, age_days=30.0, volume_ml=0.05, orders=(tap, replace(tap, diameter_mm=0.6)), step_mm=0.25)
    scene = load_scene("radish_day05a")
    scene = replace(scene, specimen=plant, camera=scene.camera.resized((500, 375)), disturbances=load_profile("bench"))
    from rhizotwin.sim.growth import grow

    roots = {}
    for day in (30.0, 30.5):
        now = series.at_day(scene, day, grow=grow)
        front_door.simulate(now, tmp_path / f"{day}", seed=1, device="cpu", views=8)
        roots[day] = read_rsml(tmp_path / f"{day}" / "truth" / "skeleton.rsml")
    monkeypatch.setattr(result_files, "read_summary", lambda _: {})
    monkeypatch.setattr(result_files, "finest_mm", lambda _: 0.15)
    fitter = tip_fit.TipFitter(tmp_path, tuple(roots[30.0]))
    first, last = (fitter.fit(load_dataset(tmp_path / f"{day}")) for day in roots)
    assert len(first) == len(last) == len(roots[30.0]) > 1
    for number in last:
        true = [tip_fit.tip_of(own[number].points_mm) for own in roots.values()]
        assert last[number].length_mm - first[number].length_mm == pytest.approx(true[1].length_mm - true[0].length_mm, abs=0.12)
        assert last[number].tip_mm == pytest.approx(true[1].tip_mm, abs=0.15)
        assert last[number].angle_deg == pytest.approx(true[1].angle_deg, abs=4.0)


def test_tables_have_intervals():
    down = np.array([0.6, 0.0, -0.8])
    ways = 0.04 * HOURS
    tips = [tip_fit.Tip(tip_mm=way * down, direction=down, curvature_per_mm=0.02, length_mm=9.0 + way) for way in ways]
    track = motion.TipTrack(plant="P", root="1", order=0, days=3.0 + HOURS / 24.0, tips=tuple(tips), px_mm=0.25)
    rows = [line.split(",") for line in motion.tips_csv(SimpleNamespace(tracks=(track,))).splitlines()]
    row = dict(zip(rows[0], rows[-1], strict=True))
    for name, value in (("speed_mm_per_h", 0.04), ("elongation_mm_per_h", 0.04), ("angle_deg", 36.87), ("curvature_per_mm", 0.02)):
        assert float(row[name]) == pytest.approx(value, rel=1e-3)
        assert float(row[f"{name}_low"]) < value < float(row[f"{name}_high"])
    assert all(len(one) == len(rows[0]) for one in rows)
    head, line = (text.split(",") for text in motion.tracks_csv(SimpleNamespace(tracks=(track,))).splitlines())
    assert len(head) == len(line)
    assert float(line[head.index("elongation_mm_per_day")]) == pytest.approx(0.96, rel=1e-3)
