"""Checks of trust: what passes, what is said, and what takes the trust away; the width of roots, and what coarse pictures cause."""

import math
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from rhizotwin.recon.calibration.exposure import Exposures
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.read_pictures import CurveFound
from rhizotwin.recon.uncertainty import checks, picture_checks, root_width, scattered_light, shape_checks
from rhizotwin.recon.uncertainty.budget import Budget, Term, Volume
from rhizotwin.recon.uncertainty.shape_checks import check_agreement, check_dirt, check_motion
from rhizotwin.scenes import transfer
from rhizotwin.scenes.dataset import Frame
from rhizotwin.scenes.model import Scene, Tank
from rhizotwin.scenes.transfer import LINEAR, SRGB, Curve

FRAMES = [Frame(file=f"images/{k}.png", sha256="") for k in range(3)]


def curve(used: Curve, bend: float | None, stated: Curve = LINEAR) -> checks.Check:
    return picture_checks.check_curve(CurveFound(curve=used, stated=stated, bend=bend, stated_bend=bend, markers=30))


def exposed(*gain: float, clipped: float = 0.0, level: float = 0.7, uneven: float = 0.0) -> checks.Check:
    each = {name: np.full(len(gain), value) for name, value in {"clipped": clipped, "level": level, "uneven": uneven}.items()}
    return picture_checks.check_exposure(Exposures(gain=np.array(gain), measured=True, **each))


CHECKS: dict[str, tuple[Callable[[], checks.Check], str, str]] = {
    "scan, finished": (lambda: picture_checks.check_scan({"complete": True, "planned_views": 3}, FRAMES), "good", "complete (3 pictures)"),
    "scan, stopped": (lambda: picture_checks.check_scan({"complete": False, "planned_views": 40}, FRAMES), "bad", "stopped after 3 of 40"),
    "scan, sketch": (
        lambda: picture_checks.check_scan({"complete": True, "settings": {"twin": {"fidelity": "sketch"}}}, FRAMES),
        "bad",
        "sketches",
    ),
    "curve, as stated": (lambda: curve(LINEAR, 0.001), "good", ""),
    "curve, corrected": (lambda: curve(SRGB, 0.001), "fair", ""),
    "curve, unknown gamma": (lambda: curve(transfer.power(1.5), 0.001), "bad", ""),
    "exposure, wanders": (lambda: exposed(0.9, 1.1), "fair", "10 %"),
    "exposure, clipped": (lambda: exposed(1.0, 1.0, clipped=0.1), "bad", "10 % of the panel is at full scale"),
    "exposure, uneven": (lambda: exposed(1.0, 1.0, uneven=0.07), "bad", "across the panel"),
    "exposure, no panel": (lambda: picture_checks.check_exposure(None), "unknown", "no empty panel"),
    "views, all round": (lambda: picture_checks.check_views(list(range(0, 360, 9)), 40), "good", ""),
    "views, half a turn": (lambda: picture_checks.check_views(list(range(0, 180, 9)), 20), "bad", ""),
    "sight, unexplained": (lambda: check_agreement(missed=0.01, unexplained=0.3, fill=0.1), "bad", "30.0 %"),
    "sight, not a number": (lambda: check_agreement(missed=0.01, unexplained=0.0, fill=math.nan), "bad", "nan %"),
    "sight, fair twice": (lambda: check_agreement(missed=0.01, unexplained=0.09, fill=0.39), "fair", "39 %"),
    "sharpness, alike": (lambda: picture_checks.check_sharpness(0.4, 0.1), "good", ""),
    "motion, no roots": (lambda: check_motion(None), "unknown", ""),
    "motion, they sway": (lambda: check_motion(0.3), "bad", ""),
    "wall, clear": (lambda: check_dirt(0.0), "good", ""),
    "wall, dirty": (lambda: check_dirt(0.9), "bad", "90.0 % of the visible wall"),
    "sharpness, slightly apart and blurred": (lambda: picture_checks.check_sharpness(3.0, 0.6), "bad", "3.00 px"),
    "markers, slightly apart and too large": (lambda: picture_checks.check_markers(0.077, 0.31), "bad", "0.077 px larger"),
    "views, a few left out and half a turn": (lambda: picture_checks.check_views(list(range(0, 180, 9)), 23), "bad", "largest step"),
    "canister, no edges in a tank": (lambda: picture_checks.check_canister(None, Scene(tank=Tank())), "bad", ""),
}


@pytest.mark.parametrize(("check", "state", "says"), CHECKS.values(), ids=CHECKS.keys())
def test_findings_are_judged_and_bad_ones_come_with_advice(check: Callable[[], checks.Check], state: str, says: str) -> None:
    found = check()
    assert found.state == state
    assert says in found.found
    assert found.advice if state == "bad" else not found.advice or state != "good"


def volume(mm3: float = 100.0, more_mm3: float = 2.0) -> Volume:
    term = Term(name="outlines", less_mm3=2.0, more_mm3=more_mm3, why="outlines")
    return Budget(volume_mm3=mm3, terms=(term,), views=40).volume((90.0, 110.0))


def test_what_is_no_number_or_fails_a_check_is_not_trusted() -> None:
    assert [one.trusted for one in (volume(), volume(mm3=math.nan), volume(more_mm3=math.nan))] == [True, False, False]
    distrusted = volume().distrust(checks.failure_reasons([picture_checks.check_scan({"complete": False}, FRAMES), check_motion(0.01)]))
    assert not distrusted.trusted
    assert distrusted.verdict.startswith(checks.NO_VOLUME)
    assert "stopped after 3 pictures" in distrusted.verdict
    again = distrusted.distrust(["another reason"])
    assert again.verdict.count(checks.NO_VOLUME) == 1
    assert again.verdict.endswith("another reason")
    assert "its rotation is unknown" in checks.failure_reasons([picture_checks.check_canister(None, Scene(tank=Tank()))])[0]


def lines(width_px: float) -> Silhouette:
    """Draw lines of a width in eight directions, sampled sixteen times a pixel."""
    fine = np.zeros((1600, 1600), np.uint8)
    for k in range(8):
        along = np.array([np.cos(k * np.pi / 8 + 0.1), np.sin(k * np.pi / 8 + 0.1)])
        ends = [tuple((800.0 + side * 700.0 * along).astype(int).tolist()) for side in (0.15, 1.0)]
        cv2.line(fine, *ends, 1, max(1, round(16 * width_px)))
    coverage = cv2.resize(fine.astype(np.float32), (100, 100), interpolation=cv2.INTER_AREA)
    return Silhouette(coverage, np.ones(coverage.shape, bool))


def test_width_of_lone_lines() -> None:
    assert [root_width.thin_width_px([lines(px)]) for px in (0.5, 1.0, 2.0)] == [pytest.approx(px, rel=0.2) for px in (0.5, 1.0, 2.0)]
    assert root_width.thin_width_px([Silhouette(np.zeros((20, 20), np.float32), np.ones((20, 20), bool))]) is None
    assert [picture_checks.check_resolution(px, (400, 300)).state for px in (0.61, 0.75, None)] == ["fair", "good", "unknown"]


def test_coarse_pictures_are_the_cause_of_views_that_disagree() -> None:
    thin = picture_checks.check_resolution(0.6, (400, 300))
    disagree = shape_checks.check_agreement(missed=0.345, unexplained=0.0, fill=0.1)
    sharp = picture_checks.check_resolution(2.0, (400, 300))
    said = checks.failure_reasons(checks.name_cause((thin, disagree)))
    assert len(said) == 1
    assert "thinner than 0.6 px, so that the views disagree on 34.5 %" in said[0]
    assert "nothing moved" not in said[0]
    assert checks.name_cause((sharp, disagree)) == (sharp, disagree)


def views(spread: float, wide_px: float, *, noise: float = 0.02, fine: bool = False) -> list[Silhouette]:
    """Draw trees of a trunk with branches, whose darkness is spread."""
    made = []
    for k in range(6):
        rng = np.random.default_rng(k)
        root = np.zeros((200, 260), np.uint8)
        cv2.line(root, (130, 10), (130, 170), 255, 14)
        for _ in range(8):
            row, reach = int(rng.integers(40, 160)), int(rng.integers(-90, 90))
            cv2.line(root, (130, row), (130 + reach, min(195, row + 40)), 255, 4)
        coverage = (root / 255.0).astype(np.float32)
        opacity = (1.0 - spread) * coverage + spread * cv2.GaussianBlur(coverage, (0, 0), wide_px)
        if fine:  # thin roots near the others
            for _ in range(30):
                row = int(rng.integers(30, 170))
                thin = np.zeros_like(root)
                cv2.line(thin, (130, row), (130 + int(rng.integers(-60, 60)), row + int(rng.integers(-20, 25))), 80, 1)
                opacity = np.maximum(opacity, thin / 255.0)
        opacity = opacity + rng.normal(0.0, noise, opacity.shape)
        made.append(Silhouette(coverage, np.ones(root.shape, bool), opacity.astype(np.float16)))
    return made


@pytest.mark.parametrize(("spread", "wide_px"), [(0.1, 8.0), (0.25, 20.0), (-0.1, 12.0)])
def test_what_is_spread_is_found(spread: float, wide_px: float) -> None:
    assert 0.75 < scattered_light.scattered_fraction(views(spread, wide_px), [(0, 0)] * 6) / spread < 1.15


def test_thin_roots_and_a_backlight_known_worse_are_no_halo() -> None:
    """Half a percent too bright where roots are in most views: the views that have none there tell it apart."""
    drawn = views(0.0, 20.0)
    often = cv2.GaussianBlur(np.mean([one.coverage for one in drawn], axis=0), (0, 0), 12.0)
    worse = [replace(one, opacity=(one.opacity + 0.05 * often).astype(np.float16)) for one in drawn]
    assert max(abs(scattered_light.scattered_fraction(made, [(0, 0)] * 6)) for made in (views(0.0, 20.0, fine=True), worse)) < 0.012
    empty = Silhouette(np.zeros((100, 100), np.float32), np.ones((100, 100), bool))
    untold = [scattered_light.scattered_fraction([replace(empty, opacity=of)], [(0, 0)]) for of in (None, np.zeros((100, 100), np.float16))]
    assert untold == [None, None]
