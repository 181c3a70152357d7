"""Covariances of fits whose residuals belong together, against the scatter of many drawn fits."""

import numpy as np
import pytest
from numpy.typing import NDArray

from rhizotwin.recon.robust import sandwich, scatter

Array = NDArray[np.float64]

CLUSTERS, EACH = 24, 12
NUMBER = np.repeat(np.arange(CLUSTERS), EACH)
PLACE = np.tile(np.arange(EACH), CLUSTERS)


def design() -> Array:
    """Return (N, 3): a constant, something that changes within clusters, and something that changes between them."""
    rng = np.random.default_rng(1)
    within, between = rng.normal(size=CLUSTERS * EACH), np.repeat(rng.normal(size=CLUSTERS), EACH)
    return np.column_stack([np.ones(CLUSTERS * EACH), within, between])


def fit(noise: Array, *clusters: NDArray[np.int64]) -> tuple[Array, Array]:
    """Fit to noise alone; return the solution and its stated covariance, without a floor."""
    rows = design()
    parts = rows[:, :, None] * rows[:, None, :]
    normal = parts.sum(axis=0)
    found = np.linalg.solve(normal, rows.T @ noise)
    left = noise - rows @ found
    meat = scatter(rows * left[:, None], *clusters, curvatures=parts, normal=normal)
    return found, sandwich(normal, meat, np.zeros((3, 3)))


def drawn(kind: str, rng: np.random.Generator) -> Array:
    """Return residuals (N,): white, with a part that each cluster shares, or that each place of all clusters shares too."""
    noise = rng.normal(size=CLUSTERS * EACH)
    if kind != "white":
        noise += rng.normal(size=CLUSTERS)[NUMBER]
    if kind == "both":
        noise += rng.normal(size=EACH)[PLACE]
    return noise


@pytest.mark.parametrize(("kind", "clusters"), [("white", (NUMBER,)), ("shared", (NUMBER,)), ("both", (NUMBER, PLACE))])
def test_stated_covariances_are_the_scatter_of_many_fits(kind: str, clusters: tuple[NDArray[np.int64], ...]) -> None:
    rng = np.random.default_rng(7)
    fits = [fit(drawn(kind, rng), *clusters) for _ in range(600)]
    true = np.cov(np.array([found for found, _ in fits]).T)
    stated = np.mean([covariance for _, covariance in fits], axis=0)
    ratio = np.diag(stated) / np.diag(true)
    assert (ratio > 0.85).all()  # six hundred fits tell a variance to 6 %
    assert (ratio < 1.45).all()  # the jackknife errs to the large side where clusters are few


def test_leaving_out_is_what_it_says() -> None:
    rows, noise = design(), drawn("shared", np.random.default_rng(2))
    whole, stated = fit(noise, NUMBER)
    without = [np.linalg.lstsq(rows[g != NUMBER], noise[g != NUMBER], rcond=None)[0] for g in range(CLUSTERS)]
    off = np.array(without) - whole
    np.testing.assert_allclose(stated, off.T @ off * (CLUSTERS - 1) / CLUSTERS, rtol=1e-9)
