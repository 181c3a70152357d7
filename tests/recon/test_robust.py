"""Covariances of fits whose residuals belong together, against the scatter of many drawn fits."""

import numpy as np
import pytest
from numpy.typing import NDArray

from rhizotwin.recon.robust import inverse, sandwich, scatter

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
    fits = [fit(drawn(kind, rng), *clusters) for _ in range(1000)]
    true = np.cov(np.array([found for found, _ in fits]).T)
    stated = np.mean([covariance for _, covariance in fits], axis=0)
    ratio = np.diag(stated) / np.diag(true)
    assert (ratio > 0.85).all()  # a thousand fits tell a variance to 4.5 %
    assert (ratio < 1.45).all()  # the jackknife errs to the large side where clusters are few


def test_white_noise_has_the_classic_covariance() -> None:
    rng = np.random.default_rng(3)
    stated = np.mean([fit(drawn("white", rng), NUMBER)[1] for _ in range(300)], axis=0)
    np.testing.assert_allclose(
        np.diag(stated), np.diag(inverse(design().T @ design())), rtol=0.25
    )  # leaving out errs by 1 / (1 - leverage), and few of 24 clusters tell a slope


def test_counted_as_independent_shared_errors_claim_far_too_much() -> None:
    rng = np.random.default_rng(5)
    shared, alone = zip(*((fit(noise, NUMBER)[1], fit(noise, np.arange(len(noise)))[1]) for noise in _shared(rng)), strict=True)
    assert np.mean(shared, axis=0)[0, 0] > 5.0 * np.mean(alone, axis=0)[0, 0]  # 12 residuals, half of whose variance is common: 6.5


def _shared(rng: np.random.Generator) -> list[Array]:
    return [drawn("shared", rng) for _ in range(100)]


def test_leaving_out_is_what_it_says() -> None:
    rows, noise = design(), drawn("shared", np.random.default_rng(2))
    whole, stated = fit(noise, NUMBER)
    without = [np.linalg.lstsq(rows[g != NUMBER], noise[g != NUMBER], rcond=None)[0] for g in range(CLUSTERS)]
    off = np.array(without) - whole
    np.testing.assert_allclose(stated, off.T @ off * (CLUSTERS - 1) / CLUSTERS, rtol=1e-9)


def test_chance_makes_no_variance_smaller() -> None:
    normal, least = np.diag([4.0, 9.0]), np.diag([0.25, 1.0 / 9.0])
    np.testing.assert_allclose(sandwich(normal, np.diag([1.0, 90.0]), least), np.diag([0.25, 90.0 / 81.0]))


def test_unknowns_of_very_different_units_are_inverted() -> None:
    normal = np.array([[1e16, 1e7], [1e7, 2e-1]])
    np.testing.assert_allclose(inverse(normal) @ normal, np.eye(2), atol=1e-8)
