"""Checks of trust: what passes, what is said, and what takes the trust away."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from rhizotwin.recon.calibration.exposure import Exposures
from rhizotwin.recon.read_pictures import CurveFound
from rhizotwin.recon.uncertainty import checks, picture_checks
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
