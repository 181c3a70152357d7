"""What views say across tubes: sections against moved nodes, and the kernels' sums against NumPy's."""

import drjit as dr
import mitsuba as mi
import numpy as np

from rhizotwin.recon.roots import proof
from rhizotwin.recon.tubes import translucent_tube, tube_picture, tube_profiles, tubes
from rhizotwin.recon.tubes.tube_profiles import Profiles, Sections
from tests.recon.strings import TRUNK, TWIG, pictured, strung


def crowd() -> tubes.Tubes:
    """Return a trunk and a twig of other radii."""
    system = strung(TRUNK, TWIG)
    return tubes.moved(system, system.centre_mm, np.linspace(0.1, 0.4, len(system.radius_mm)))


def measured(system: tubes.Tubes) -> Profiles:
    """Return the profiles of tubes that are drawn a little beside where the pictures show them."""
    seen = pictured(system)
    beside = tubes.moved(system, system.centre_mm + np.array([0.05, -0.03, 0.02]), 1.1 * system.radius_mm)
    at = seen.project(beside.centre_mm)
    depth = tube_picture.optical_depth(seen, beside, at, 0.2)
    return tube_profiles.profiles(seen, beside, at, depth, tube_picture.unexplained(seen, depth), 0.2)


def test_the_gradient_across_is_that_of_moved_nodes() -> None:
    system = crowd()
    seen = pictured(system)
    cut = Sections.of(seen, system, seen.project(system.centre_mm))
    assert cut is not None
    place, normal = np.array(cut.place), np.array(cut.normal).T
    for axis in range(3):
        step = 0.02 * np.eye(3)[axis]
        above, below = (seen.project(system.centre_mm + side * step).px.reshape(-1, 2)[place] for side in (1.0, -1.0))
        moved = np.einsum("mi,mi->m", normal, above - below) / 0.04
        np.testing.assert_allclose(np.array(cut.across)[axis], moved, atol=0.01)


def test_the_normal_equations_are_the_sums_over_the_views() -> None:
    profiles = measured(crowd())
    told, residual, some = profiles.host(), profiles.residual_gradient(), np.array([7, 2, 30])
    across = np.concatenate([told.across, told.scale[..., None]], axis=-1)
    weight = np.stack([[told.shift_2] * 3 + [told.shift_width]] * 3 + [[told.shift_width] * 3 + [told.width_2]])
    np.testing.assert_allclose(residual.hessian, np.einsum("ijvn,vni,vnj->nij", weight, across, across), rtol=1e-4, atol=1e-3)
    force = np.stack([told.shift] * 3 + [told.width])
    np.testing.assert_allclose(residual.gradient, np.einsum("ivn,vni->ni", force, across), rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(residual.visible, told.shown.sum(axis=0) / told.whole.sum(axis=0), rtol=1e-4)
    np.testing.assert_array_equal(profiles.host(some).across, told.across[:, some])
    np.testing.assert_array_equal(residual.of(some).hessian, residual.hessian[some])


def test_a_tube_that_no_view_sees_has_no_sections() -> None:
    system = crowd()
    seen = pictured(system)
    away = tubes.moved(system, system.centre_mm + np.array([0.0, 0.0, 500.0]), system.radius_mm)
    at = seen.project(away.centre_mm)
    depth = tube_picture.optical_depth(seen, away, at, 0.0)
    assert not np.array(depth).any()
    found = tube_profiles.profiles(seen, away, at, depth, tube_picture.unexplained(seen, depth), 0.0)
    assert not found.residual_gradient().hessian.any()
    assert not proof.weigh(seen, away, at, depth, tube_picture.unexplained(seen, depth), 0.0).explained.any()
    assert np.isnan(tube_profiles.misfit(seen, away, tube_picture.unexplained(seen, depth))).all()


def test_layers_of_the_kernel_are_the_strips() -> None:
    mu, radius, sine = 2.0, np.geomspace(0.02, 3.0, 50), np.linspace(0.01, 1.0, 50)
    strips = translucent_tube.strips(mu * radius / np.maximum(sine, translucent_tube.LEAST_SINE))
    found = translucent_tube.layers(mu, None, mi.Float(radius), mi.Float(sine), mi.Float(10.0 * radius))
    w = 10.0 * radius
    for n, layer in enumerate(found):
        dr.eval(layer.half_px, layer.height, layer.by_width, layer.by_height)
        e, h = strips.width[n], strips.height[n]
        np.testing.assert_allclose(np.array(layer.half_px), w * e, rtol=2e-5)
        np.testing.assert_allclose(np.array(layer.height), h, rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(np.array(layer.by_width), h * (e + strips.width_slope[n]), rtol=1e-3, atol=1e-5)
        np.testing.assert_allclose(np.array(layer.by_height), strips.height_slope[n] / w, rtol=1e-3, atol=1e-4)
