"""Lines with errors on both sides: published values, simulation, the closed forms at its limits."""

import numpy as np
import pytest

from rhizotwin.experiment.york import Points, fit_line

# Pearson's points with York's weights; York et al. 2004, table II: a = 5.47991022, b = -0.480533407, chi squared over dof 1.483294149.
X = np.array([0.0, 0.9, 1.8, 2.6, 3.3, 4.4, 5.2, 6.1, 6.5, 7.4])
Y = np.array([5.9, 5.4, 4.4, 4.6, 3.5, 3.7, 2.8, 2.8, 2.4, 1.5])
X_SIGMA = np.array([1000.0, 1000.0, 500.0, 800.0, 200.0, 80.0, 60.0, 20.0, 1.8, 1.0]) ** -0.5
Y_SIGMA = np.array([1.0, 1.8, 4.0, 8.0, 20.0, 20.0, 70.0, 70.0, 100.0, 500.0]) ** -0.5
POINTS = Points(X, Y, X_SIGMA, Y_SIGMA)


def test_pearsons_points_and_limits_of_the_closed_form() -> None:
    line = fit_line(POINTS, scatter=False)
    assert line.intercept == pytest.approx(5.47991022, rel=1e-8)
    assert line.slope == pytest.approx(-0.480533407, rel=1e-8)
    assert line.chi2 / line.dof == pytest.approx(1.483294149, rel=1e-8)
    line = fit_line(Points(X, Y, np.zeros(10), Y_SIGMA), scatter=False)  # without errors in x it is the weighted line
    assert (line.slope, line.intercept) == pytest.approx(np.polyfit(X, Y, 1, w=1.0 / Y_SIGMA), rel=1e-8)
    with pytest.raises(ValueError, match="2 independent points"):
        fit_line(POINTS[X < 1.0])
    assert fit_line(POINTS[X < 1.0], slope=1.0).dof == 1


def test_its_uncertainty_is_that_of_many_draws() -> None:
    rng = np.random.default_rng(6)
    line = fit_line(POINTS, scatter=False)
    true_x, drawn = np.linspace(0.0, 7.0, 10), []
    for _ in range(500):
        x, y = rng.normal(true_x, X_SIGMA), rng.normal(5.5 - 0.48 * true_x, Y_SIGMA)
        once = fit_line(Points(x, y, X_SIGMA, Y_SIGMA), scatter=False)
        drawn.append((once.intercept, once.slope))
    assert np.std(drawn, axis=0) == pytest.approx(np.sqrt(np.diag(line.covariance)), rel=0.15)


def test_scatter_makes_chi_squared_one_and_is_found() -> None:
    rng = np.random.default_rng(3)
    x = rng.uniform(0.0, 5.0, 400)
    x_sigma, y_sigma = np.full(400, 0.05), np.full(400, 0.02)
    y = 0.7 + x + rng.normal(0.0, 0.2, 400)
    line = fit_line(Points(x + rng.normal(0.0, 0.05, 400), y + rng.normal(0.0, 0.02, 400), x_sigma, y_sigma))
    assert line.chi2 == pytest.approx(line.dof, rel=1e-6)
    assert line.scatter == pytest.approx(0.2, rel=0.1)
    assert line.slope == pytest.approx(1.0, abs=3.0 * line.covariance[1][1] ** 0.5)


def test_an_interval_of_plants_on_six_days_holds_its_share() -> None:
    """The days of a plant deviate together, so that there are 4 independent points; with 24, 74 % were held."""
    rng, held = np.random.default_rng(7), []
    groups, exact = np.repeat(np.arange(4), 6), np.zeros(24)
    for _ in range(300):
        x = rng.normal(0.0, 0.1, (5, 1)) + 0.3 * np.arange(6)
        y = x + rng.normal(0.0, 0.15, (5, 1)) + rng.normal(0.0, 0.02, (5, 6))
        line = fit_line(Points(x[:4].ravel(), y[:4].ravel(), exact, exact, groups), slope=1.0)
        middle, spread = line.at(x[4])
        held.append(np.mean(np.abs(middle - y[4]) <= line.reach(0.9) * spread))
    assert 0.86 < np.mean(held) < 0.94
