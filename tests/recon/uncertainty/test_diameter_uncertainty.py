"""How far each root's diameter may be wrong, point by point."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from rhizotwin.recon.tubes import tube_fit
from rhizotwin.recon.tubes.tube_profiles import HostProfiles
from rhizotwin.recon.uncertainty import diameter_uncertainty
from rhizotwin.recon.uncertainty.tube_uncertainty import NO_DATA
from tests.recon.strings import TRUNK, TWIG, at_rest, pictured, strung


def profiled(width: np.ndarray, width_2: np.ndarray) -> HostProfiles:
    """Return what views (V, N) say of widths alone."""
    none = np.zeros(width.shape)
    return HostProfiles(np.zeros((*width.shape, 3)), np.full(width.shape, 5.0), none, none, width_2, none, width, none, none)


def test_it_is_the_jackknife_of_the_fit() -> None:
    """Against matrices written out, as a least-squares fit without each of the views has them."""
    tubes, rng = strung(TRUNK[::20], TWIG[::20]), np.random.default_rng(0)
    nodes, views = len(tubes.radius_mm), 12
    width_2 = rng.uniform(0.5, 2.0, (views, nodes))
    told = profiled(rng.normal(0.0, 0.1, (views, nodes)), width_2)
    normal = np.diag((width_2 * 25.0).sum(axis=0) + tube_fit.LEAST) + sparse.csr_matrix(tube_fit.prior(tubes)).toarray()[3::4, 3::4]
    step = np.linalg.solve(normal, (told.width * 5.0).T)
    by_view = np.sqrt(views) * step.std(axis=1)
    untold = 1.0 / np.sqrt((width_2 * 25.0).sum(axis=0) / 0.01 + 1.0 / (NO_DATA * tubes.radius_mm) ** 2)
    assert diameter_uncertainty.combine_sigma(tubes, told, 0.01) == pytest.approx(np.hypot(by_view, untold), rel=1e-6)
    nothing = profiled(np.zeros((views, nodes)), np.zeros((views, nodes)))
    assert diameter_uncertainty.combine_sigma(tubes, nothing, 0.01) == pytest.approx(NO_DATA * tubes.radius_mm), "as roots of its order are"


def test_noise_in_the_pictures_comes_out_in_the_diameters() -> None:
    """Fitted to pictures with noise, diameters miss the truth by what is told or less: what neighbours share is not counted."""
    true = strung(TRUNK, TWIG, radius_mm=0.25)
    seen = pictured(true, noise=0.02)
    fitted = tube_fit.fit(seen, true, np.zeros(len(true.radius_mm), bool), steps=6).tubes
    system = replace(at_rest(fitted, px_a_mm=4.0), evidence=seen)
    sigma, wrong = diameter_uncertainty.radius_sigma(system), fitted.radius_mm - 0.25
    inner = np.ones(len(wrong), bool)
    inner[[int(nodes[k]) for nodes in fitted.branches for k in (0, 1, -2, -1)]] = False  # ends and forks share pixels
    assert 0.2 < np.sqrt(np.mean(wrong[inner] ** 2) / np.mean(sigma[inner] ** 2)) < 1.6
