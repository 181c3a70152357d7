"""Light that is spread about roots is told, noise and thin roots that nobody found are not taken for it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.uncertainty import halo, shape_checks


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


@pytest.mark.parametrize(("spread", "wide_px"), [(0.1, 20.0), (0.1, 8.0), (0.25, 20.0), (-0.1, 12.0)])
def test_what_is_spread_is_found(spread: float, wide_px: float) -> None:
    found = halo.spread(views(spread, wide_px), [(0, 0)] * 6)
    assert found is not None
    assert 0.4 * abs(spread) < abs(found) < 1.6 * abs(spread)
    assert np.sign(found) == np.sign(spread)


@pytest.mark.parametrize("fine", [False, True])
def test_nothing_is_found_where_nothing_is_spread(fine: bool) -> None:
    found = halo.spread(views(0.0, 20.0, fine=fine), [(0, 0)] * 6)
    assert found is not None
    assert abs(found) < 0.012


def test_a_backlight_that_is_known_worse_where_roots_often_pass_is_no_halo() -> None:
    """Half a percent too bright where roots are in most views: the views that have none there tell it apart."""
    drawn = [(one, one.opacity) for one in views(0.0, 20.0) if one.opacity is not None]
    often = cv2.GaussianBlur(np.mean([one.coverage for one, _ in drawn], axis=0), (0, 0), 12.0)
    found = halo.spread([replace(one, opacity=(opacity + 0.05 * often).astype(np.float16)) for one, opacity in drawn], [(0, 0)] * 6)
    assert found is not None
    assert abs(found) < 0.012


def test_empty_pictures_tell_nothing() -> None:
    empty = np.zeros((100, 100), np.float32)
    assert halo.spread([Silhouette(empty, np.ones((100, 100), bool), empty.astype(np.float16))], [(0, 0)]) is None
    assert halo.spread([Silhouette(empty, np.ones((100, 100), bool))], [(0, 0)]) is None


def test_milky_water_takes_the_trust_away() -> None:
    assert shape_checks.of_dirt(0.0, 0.001).state == "good"
    found = shape_checks.of_dirt(0.0, 0.05)
    assert found.state == "bad"
    assert "5.0 %" in found.found
    assert "too bright" in shape_checks.of_dirt(0.0, -0.05).found
    assert shape_checks.of_dirt(None, None).state == "untold"
