"""Roots that sway from picture to picture are followed, and roots that stand still stay."""

from dataclasses import replace

import numpy as np

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.optics import projection
from rhizotwin.recon.tubes import root_sway, tube_fit
from tests.recon.tubes.test_root_calibration import evidence, rig, sure_rig, system

PX_A_MM = 1.9
"""Of the rig's small pictures, about."""


def test_swaying_roots_are_followed() -> None:
    views, optics = rig()
    rng = np.random.default_rng(5)
    truth = rng.normal(0.0, 0.006, (len(views), 3)) * [1.0, 1.0, 0.02]
    true = [replace(view, sway=(float(x), float(y), float(turn))) for view, (x, y, turn) in zip(views, truth, strict=True)]
    seen = replace(evidence(true, optics), bank=projection.ViewBank.of(views, optics))
    fixed = np.zeros(len(system().radius_mm), bool)
    start, _ = tube_fit.fit(seen, system(), fixed, blur_px=0.0, steps=4)
    given = Cameras.given(views, optics, sure_rig(len(views)))
    followed, cameras, fitted = root_sway.follow(seen, given, start, fixed, blur_px=0.0, px_a_mm=PX_A_MM)
    exact = replace(seen, bank=projection.ViewBank.of(true, optics)).project(system().centre_mm)
    still = seen.project(start.centre_mm)

    def off_px(at: np.ndarray) -> float:
        away = np.where(exact.seen[..., None], at - exact.px, np.nan)
        moves = away - np.nanmean(away, axis=0)  # a sway that all views share is none
        return float(np.sqrt(np.nanmean(np.square(moves))))

    before, after = off_px(still.px), off_px(followed.project(fitted.centre_mm).px)
    assert before > 0.2
    assert after < 0.5 * before
    assert any(view.sway != (0.0, 0.0, 0.0) for view in cameras.views)


def test_still_roots_stay() -> None:
    views, optics = rig()
    seen, fixed = evidence(views, optics), np.zeros(len(system().radius_mm), bool)
    given = Cameras.given(views, optics, sure_rig(len(views)))
    same, cameras, fitted = root_sway.follow(seen, given, system(), fixed, blur_px=0.0, px_a_mm=PX_A_MM)
    assert same is seen
    assert cameras is given
    assert fitted is system()
