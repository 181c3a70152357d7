"""Bright spots: a bubble before a thick root is one, a gap between roots or beside an outline is none."""

import numpy as np
import pytest

from rhizotwin.recon.coverage.evidence import bright_spots
from rhizotwin.recon.coverage.silhouettes import Silhouette


def disc(*, radius: float = 30.0, at: tuple[float, float] = (50.0, 50.0)) -> np.ndarray:
    rows, columns = np.mgrid[:100, :100]
    return (np.hypot(rows - at[0], columns - at[1]) <= radius).astype(np.float32)


def spots_of(coverage: np.ndarray, seen: np.ndarray | None = None) -> np.ndarray:
    return bright_spots(Silhouette(coverage, np.ones(coverage.shape, bool) if seen is None else seen))


@pytest.mark.parametrize(("away_px", "found"), [(0.0, True), (18.0, True), (26.0, False)])
def test_a_spot_counts_where_enough_is_full_about_it(away_px: float, found: bool) -> None:
    coverage = disc()
    hole = disc(radius=2.0, at=(50.0, 50.0 + away_px)) > 0.0
    coverage[hole] = 0.2
    assert spots_of(coverage).any() == found
    assert not found or (spots_of(coverage) == hole).all()


def test_gaps_between_crossing_roots_and_open_ones_are_none() -> None:
    crossing = np.zeros((100, 100), np.float32)
    for k in (30, 42):  # four roots of 6 px about a gap of 6 px
        crossing[k : k + 6] = 1.0
        crossing[:, k : k + 6] = 1.0
    assert not spots_of(crossing).any()
    ring = disc() - disc(radius=12.0)
    assert not spots_of(ring).any()
    assert not spots_of(disc()).any()
    assert not spots_of(np.zeros((50, 50), np.float32)).any()


def test_two_spots_beside_each_other_are_a_gap_and_what_is_not_seen_is_no_spot() -> None:
    pair = disc()
    for column in (48, 53):
        pair[49:52, column - 1 : column + 2] = 0.0
    assert not spots_of(pair).any()
    blind = disc()
    blind[48:52, 48:52] = 0.0
    seen = np.ones(blind.shape, bool)
    seen[46:54, 46:54] = False
    assert not spots_of(blind, seen).any()
