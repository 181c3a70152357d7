"""Light that is spread about roots is told, noise and thin roots that nobody found are not taken for it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.uncertainty import scattered_light


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


@pytest.mark.parametrize(("spread", "wide_px"), [(0.1, 8.0), (0.25, 20.0), (-0.1, 12.0), (0.12, 28.0), (0.12, 60.0)])
def test_what_is_spread_is_found(spread: float, wide_px: float) -> None:
    assert 0.75 < scattered_light.scattered_fraction(views(spread, wide_px), [(0, 0)] * 6) / spread < 1.15


def test_thin_roots_and_a_backlight_that_is_known_worse_where_roots_often_pass_are_no_halo() -> None:
    """Half a percent too bright where roots are in most views: the views that have none there tell it apart."""
    drawn = views(0.0, 20.0)
    often = cv2.GaussianBlur(np.mean([one.coverage for one in drawn], axis=0), (0, 0), 12.0)
    for made in (views(0.0, 20.0, fine=True), [replace(one, opacity=(one.opacity + 0.05 * often).astype(np.float16)) for one in drawn]):
        assert abs(scattered_light.scattered_fraction(made, [(0, 0)] * 6)) < 0.012


def test_empty_pictures_tell_nothing() -> None:
    empty = np.zeros((100, 100), np.float32)
    assert scattered_light.scattered_fraction([Silhouette(empty, np.ones((100, 100), bool), empty.astype(np.float16))], [(0, 0)]) is None
    assert scattered_light.scattered_fraction([Silhouette(empty, np.ones((100, 100), bool))], [(0, 0)]) is None


@pytest.mark.parametrize(("share", "sides"), [(0.2, (0.0, 20.0)), (-0.2, (20.0, 0.0)), (0.0, (0.0, 0.0))])
def test_thin_roots_lose_the_share_that_is_scattered(share: float, sides: tuple[float, float]) -> None:
    term = scattered_light.scattered_term(share, 100.0)
    assert (term.less_mm3, term.more_mm3) == sides
    assert f"{'increased' if share < 0 else 'reduced'} by {100 * abs(share):.1f} %" in term.why
