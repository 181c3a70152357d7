"""Split conformal calibration gives its nominal coverage, the committed factors follow from the table, and random scans draw as said."""

import json
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from benchmarks import __main__ as command
from benchmarks import conformal, intervals, intervals_page, intervals_table, random_scans, worker
from benchmarks.cases import Case, Pictures
from benchmarks.intervals_table import TRAITS
from benchmarks.random_scans import PROFILES, SIGNED, TROUBLES, VIEWS, RandomScan
from rhizotwin.recon.settings import TrustSettings
from rhizotwin.recon.uncertainty import calibration
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.files import load_profile

COMMITTED = Path(intervals_table.__file__).with_name("intervals.csv")


def scans(count: int, *, seed: int, true_sigma: float = 0.02, half: float = 0.1) -> pd.DataFrame:
    """Return volumes of 100 with normal errors, and intervals of one half-width."""
    true = 100.0 * (1.0 + true_sigma * np.random.default_rng(seed).standard_normal(count))
    about = {"profile": "clean", "family": "sphere", "troubles": "", "views": "24", "width_px": 400, "regime": "clear", "reasons": ""}
    found = {"true": true, "value": 100.0, "low": 100.0 * (1.0 - half), "high": 100.0 * (1.0 + half), "reliable": True}
    of_traits = {f"{trait}.{name}": value for trait in TRAITS for name, value in found.items()}
    return pd.DataFrame({"number": np.arange(count)} | about | of_traits)


def test_factors_make_narrow_intervals_nominal() -> None:
    factors = conformal.calibrate(scans(2000, seed=1, half=0.005), widest=0.25)
    assert factors["clear"]["volume_mm3"] == pytest.approx(1.645 * 0.02 / 0.005, rel=0.06)
    fresh = conformal.apply(scans(4000, seed=2, half=0.005), factors, widest=0.25)
    assert conformal.holds(fresh, "volume_mm3").mean() == pytest.approx(0.9, abs=0.02)


def test_coverage_over_repeated_small_calibrations_is_nominal() -> None:
    rng, held = np.random.default_rng(4), []
    for _ in range(400):
        factor = conformal.conformal_quantile(np.abs(rng.standard_normal(19)))
        held.append((np.abs(rng.standard_normal(200)) <= factor).mean())
    assert np.mean(held) == pytest.approx(0.9, abs=0.01)


@pytest.mark.parametrize(("crashed", "code"), [(0, 0), (2, 1), (24, 1)])
def test_failed_scans_are_counted_and_set_the_exit_code(
    crashed: int, code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    table = scans(24, seed=2).astype(object)
    if crashed:
        monkeypatch.setattr(intervals_page, "draw", lambda *_, **__: None)
        table.loc[: crashed - 1, "error"] = "MemoryError: too large"
        table.loc[: crashed - 1, [name for name in table if name not in ("number", "error")]] = None
    table.to_csv(tmp_path / "table.csv", index=False)
    words = ["intervals", "--table", str(tmp_path / "table.csv"), "-o", str(tmp_path / "out.csv")]
    assert command.main(words) == code
    said = f"{crashed} of 24 random scans failed; the first error is: scan 0: MemoryError"
    assert (said in capsys.readouterr().out) == bool(crashed)


def test_a_random_scan_is_measured_by_jobs_of_the_worker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, record_of: Callable[..., dict[str, Any]]
) -> None:
    jobs = []

    def start(arguments: list[str], *, device: str) -> dict[str, Any]:
        jobs.append(worker.parser().parse_args(["--device", device, "--working", str(tmp_path), *arguments]).job)
        score = record_of(Case(pictures=Pictures(scene="bean")))["score"]
        return {"cpu_s": 50.0} if jobs[-1] == "reconstruct" else {"score": score, "summary": {}, "derived": {}}

    monkeypatch.setattr(worker, "start", start)
    monkeypatch.setenv("RHIZOTWIN_CACHE", str(tmp_path))
    (record,) = intervals.measure([3], processes=1, device="cpu", say=lambda _: None)
    assert jobs == ["dataset", "reconstruct", "score"]
    assert record["cpu_s"] == 50.0
    assert intervals.measure([3], processes=1, device="cpu", say=lambda _: None)[0]["number"] == 3
    assert len(jobs) == 3


def test_a_factor_is_one_unless_coverage_is_significantly_lower() -> None:
    assert conformal.calibrate(scans(60, seed=1, half=0.1), widest=0.25)["clear"]["tips"] == 1.0  # all hold: not narrowed
    assert conformal.calibrate(scans(12, seed=1, half=0.025), widest=0.25)["clear"]["tips"] == 1.0
    assert conformal.calibrate(scans(12, seed=1, half=0.004), widest=0.25)["clear"]["tips"] > 2.0


def test_rank_of_the_quantile_by_hand() -> None:
    assert conformal.conformal_quantile(np.arange(1.0, 20.0)) == 18.0  # ceil(20 * 0.9)
    assert conformal.conformal_quantile(np.arange(1.0, 6.0)) == 5.0  # too few: the largest


def test_interval_score_by_hand() -> None:
    """Widths of 20, and 2 / 0.1 times what is outside, relative to the truth."""
    some = scans(3, seed=0)
    for trait in TRAITS:
        some[f"{trait}.true"] = [100.0, 80.0, 112.0]
    expected = [0.2, (20.0 + 20.0 * 10.0) / 80.0, (20.0 + 20.0 * 2.0) / 112.0]
    assert conformal.interval_score(some, "volume_mm3").tolist() == pytest.approx(expected)


def test_probability_integral_of_right_intervals_is_uniform() -> None:
    found = conformal.probability_integral(scans(4000, seed=3, half=1.645 * 0.02), "tips")
    assert np.histogram(found, bins=4, range=(0.0, 1.0))[0] / 4000 == pytest.approx(np.full(4, 0.25), abs=0.03)


def test_a_scan_without_regime_counts_as_not_calibrated(tmp_path: Path) -> None:
    some = scans(24, seed=2)
    some.loc[3, "regime"] = None
    some.to_csv(tmp_path / "table.csv", index=False)
    read = intervals_table.read(tmp_path / "table.csv")
    assert conformal.is_reliable(read, "volume_mm3", 0.25).sum() == 23
    assert "| volume | clear | 1.00 | 23 |" in intervals_page.page(read, {"clear": {}}, widest=0.25)


def test_scans_that_a_check_refuses_are_not_calibrated_on() -> None:
    some = scans(40, seed=0)
    some.loc[:19, "reasons"] = "dirty_canister"
    some.loc[20:29, "reasons"] = "wide_interval high_occluded"
    assert conformal.is_reliable(some, "volume_mm3", 0.25).sum() == 20
    some.loc[30:34, "tips.reliable"] = False
    assert conformal.is_reliable(some, "tips", 0.25).sum() == 15


def test_the_committed_factors_follow_from_the_committed_table() -> None:
    table = intervals_table.read(COMMITTED)
    stored = json.loads(calibration.TABLE.read_text(encoding="utf-8"))
    assert conformal.calibrate(table, widest=TrustSettings.widest) == stored["factors"]
    text = intervals_page.page(table, stored["factors"], widest=TrustSettings.widest)
    documented = (Path(__file__).parents[2] / "docs" / "intervals.md").read_text(encoding="utf-8")
    assert all(line in documented for line in text.strip().splitlines() if line), (
        "run `./run bench intervals --table benchmarks/intervals.csv`"
    )


@pytest.mark.parametrize("number", [5, 11, 17, 23, 29, 35])
def test_a_mixture_has_its_troubles_and_no_others(number: int) -> None:
    mixture, camera, real = RandomScan(number=number), load_profile("camera"), load_profile("real")
    wrong = mixture.scene_to_render().disturbances
    assert wrong == mixture.scene_to_render().disturbances
    for trouble, names in TROUBLES.items():
        for name in names:
            value, most = getattr(wrong, name), getattr(real, name)
            if trouble in mixture.troubles():
                assert 0.2 * most <= abs(value) <= 1.51 * most + 1.0
                assert value >= 0 or name in SIGNED
            else:
                assert value == getattr(camera, name)


def test_a_mixture_may_contain_all_that_real_adds_to_camera() -> None:
    camera, real = load_profile("camera"), load_profile("real")
    for number, profile in enumerate(PROFILES[:-1]):
        assert RandomScan(number=number).scene_to_render().disturbances == load_profile(profile)
    mixed = {name for names in (*TROUBLES.values(), *random_scans.WITH.values()) for name in names}
    assert mixed == {one.name for one in fields(Disturbances) if getattr(camera, one.name) != getattr(real, one.name)}


def test_the_draw_covers_families_sizes_and_rings_in_range() -> None:
    scans = [RandomScan(number=number) for number in range(150)]
    assert {scan.family for scan in scans} == set(random_scans.FAMILIES)
    assert {scan.image_wh for scan in scans} == set(random_scans.SIZES)
    assert {len(scan.rings()) for scan in scans} == {1, 2}
    assert all(VIEWS[0] <= sum(ring.views for ring in scan.rings()) <= VIEWS[1] + 1 for scan in scans)
