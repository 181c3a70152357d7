"""Elimination of the nodes from a linear problem whose solution and scatter can be computed otherwise."""

import numpy as np

from rhizotwin.recon.tubes import smoothness
from rhizotwin.recon.tubes.parameters import Parameter, Parameters
from rhizotwin.recon.tubes.system import Equations, System
from rhizotwin.recon.tubes.tubes import Tubes, place_nodes

VIEWS, MANY, SIGMA = 8, 2, 0.3
RNG = np.random.default_rng(1)


def roots() -> Tubes:
    """Return a few roots whose radius varies."""
    starts = RNG.uniform(-20.0, 20.0, (12, 3))
    paths = [np.linspace(start, start + RNG.uniform(-6.0, 6.0, 3), 12) for start in starts]
    return place_nodes(paths, [np.linspace(0.4, 0.3, 12)] * len(paths))


TREE = roots()
COUNT = len(TREE.radius_mm)
BY_NODE, BY_PARAMETER = RNG.normal(0.0, 3.0, (VIEWS, COUNT, 4)), RNG.normal(1.0, 1.0, (VIEWS, COUNT, MANY))
PRIOR = Parameters(
    tuple(Parameter(name, step=1.0) for name in "ab"), np.zeros(MANY), np.zeros(MANY), np.diag([0.0, 25.0]), np.ones(MANY, bool)
)


def equations(residual: np.ndarray) -> Equations:
    """Return the normal equations of residuals (V, N) that are linear in the nodes and the parameters."""
    return Equations(
        hessian=np.einsum("vni,vnj->nij", BY_NODE, BY_NODE),
        gradient=np.einsum("vni,vn->ni", BY_NODE, residual),
        mixed=np.einsum("vni,vnj->nij", BY_NODE, BY_PARAMETER),
        whole=np.einsum("vni,vnj->ij", BY_PARAMETER, BY_PARAMETER),
        right=np.einsum("vni,vn->i", BY_PARAMETER, residual),
    )


def test_the_step_is_that_of_all_equations_at_once() -> None:
    residual, ridge = RNG.normal(size=(VIEWS, COUNT)), np.eye(4)
    own = equations(residual)
    system = System.eliminate(own, TREE, ridge)
    flanks, smooth = smoothness.flank_motion(TREE), smoothness.prior(TREE)
    whole = np.zeros((4 * COUNT + MANY,) * 2)
    for n in range(COUNT):
        whole[4 * n : 4 * n + 4, 4 * n : 4 * n + 4] = own.hessian[n] + ridge
    whole[: 4 * COUNT, : 4 * COUNT] = flanks.T @ (flanks.T @ whole[: 4 * COUNT, : 4 * COUNT]).T + smooth.toarray()
    whole[: 4 * COUNT, 4 * COUNT :] = flanks.T @ own.mixed.reshape(-1, MANY)
    whole[4 * COUNT :, : 4 * COUNT] = whole[: 4 * COUNT, 4 * COUNT :].T
    whole[4 * COUNT :, 4 * COUNT :] = own.whole + PRIOR.precision
    state = np.concatenate([TREE.centre_mm, TREE.radius_mm[:, None]], axis=1).ravel()
    step = np.linalg.solve(whole, np.concatenate([flanks.T @ own.gradient.ravel() - smooth @ state, own.right]))
    change, covariance = system.solve(PRIOR, 1.0)
    np.testing.assert_allclose(change, step[4 * COUNT :], rtol=1e-6)
    np.testing.assert_allclose((system.start + system.response @ change).ravel(), step[: 4 * COUNT], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(covariance, np.linalg.inv(whole)[4 * COUNT :, 4 * COUNT :], rtol=1e-6)


def test_the_covariance_is_the_scatter_over_shared_noise() -> None:
    """Residuals of a root are alike, and those of a view, so that independent residuals would be far too certain."""
    shared = PRIOR.unconstrained(np.ones(MANY, bool))
    changes, told = [], []
    for _ in range(100):
        residual = RNG.normal(0.0, SIGMA, (VIEWS, 1)) + RNG.normal(0.0, SIGMA, len(TREE.branches))[TREE.owner]
        residual += RNG.normal(0.0, SIGMA, (VIEWS, COUNT))
        own = equations(residual)
        system = System.eliminate(own, TREE, 1e-4 * np.eye(4))
        change = system.solve(shared, 1.0)[0]
        left = residual - np.einsum("vni,ni->vn", BY_NODE, system.flank_steps(change)) - BY_PARAMETER @ change
        meat = system.scatter((BY_NODE[v] * left[v, :, None], BY_PARAMETER[v] * left[v, :, None]) for v in range(VIEWS))
        changes.append(change)
        told.append(system.solve(shared, meat + 1e-6 * system.reduced)[1])
    np.testing.assert_allclose(np.sqrt(np.diag(np.mean(told, axis=0))), np.std(changes, axis=0), rtol=0.3)


def test_parameters_stay_within_their_limits() -> None:
    declared = (Parameter("a", step=1.0, low=0.0), Parameter("b", step=1.0, largest=0.01))
    own = equations(np.full((VIEWS, COUNT), -1.0))
    limited = Parameters(declared, np.zeros(MANY), np.zeros(MANY), np.zeros((MANY, MANY)), np.ones(MANY, bool))
    free = System.eliminate(own, TREE).solve(limited.unconstrained(np.ones(MANY, bool)), 1.0)[0]
    change, covariance = System.eliminate(own, TREE).solve(limited, 1.0)
    assert free[0] < 0.0
    assert change[0] == covariance[0, 0] == 0.0
    assert abs(change[1]) <= 0.01 < abs(free[1])
