"""The empty backlight, estimated from pictures in which something always stands before part of the panel."""

import numpy as np
import pytest

from rhizotwin.recon.coverage import background
from rhizotwin.recon.optics import cameras, refraction
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Scene
from tests.recon.hull.exact_pictures import ring_of, views_of

V, U = np.mgrid[0:120, 0:160]


def panel() -> np.ndarray:
    x, y = 2 * U / 160 - 1, 2 * V / 120 - 1
    return (40000 * (1 - 0.25 * x**2 - 0.1 * y + 0.05 * x * y)).astype(np.float32)


def turned(always_px: int, noise: float, *, views: int = 20, light: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    """Pictures with a dark band that never leaves the middle, a lateral that wanders, and noise."""
    rng, empty = np.random.default_rng(0), panel()
    stack = np.repeat(empty[None], views, axis=0)
    stack[:, :, 80 - always_px // 2 : 80 + always_px // 2] *= light
    for k in range(views):
        column = int(rng.integers(20, 130))
        stack[k, :, column : column + 12] *= 0.05
    return (stack + rng.normal(0, noise * 40000, stack.shape)).astype(np.float32), empty


@pytest.mark.parametrize(
    ("always_px", "noise", "light"), [(0, 0.0, 0.05), (16, 0.01, 0.05), (16, 0.0, 0.0)], ids=["none", "noise", "pitch black"]
)
def test_the_panel_behind_what_always_hides_it_is_estimated(always_px: int, noise: float, light: float) -> None:
    stack, empty = turned(always_px, noise, light=light)
    found, _, glare = background.estimate(stack, np.broadcast_to(np.arange(len(empty))[:, None] >= 5, stack.shape))
    off = (found / empty - 1)[5:]
    assert np.abs(off).mean() < 0.003 + 0.6 * noise
    assert abs(off.mean()) < 0.002 + 0.5 * noise
    assert np.abs(off[:, 72:88]).max() < 0.05
    assert not glare.any()
    assert (found[:5] == 0).all()


def test_a_reflection_is_taken_off_and_a_bright_panel_is_not() -> None:
    """A soft streak a tenth as bright as the panel: reflected by the wall, nothing is hidden by it; the panel's own, roots hide it."""
    stack, empty = turned(0, 0.003, views=30)
    streak = (5000.0 * np.exp(-0.5 * (((U - 70) / 2.0) ** 2 + ((V - 60) / 25.0) ** 4))).astype(np.float32)
    strong, inside = streak > 0.07 * empty, np.ones(stack.shape, bool)
    found = background.estimate(stack + streak, inside)
    assert not found.glare.any()
    assert np.abs(found.added - streak)[strong].max() < 0.02 * empty.mean()
    assert np.abs(found.light / empty - 1)[strong].max() < 0.02
    opacity = 1.0 - (stack + streak - found.added) / found.light
    assert np.abs(opacity - 0.95)[(np.abs(stack) < 0.1 * empty) & strong].mean() < 0.02
    found = background.estimate(stack + streak * stack / empty, inside)
    assert not found.added.any()
    assert found.glare[strong].all()


def test_a_crowd_that_mostly_hides_the_panel_bends_nothing() -> None:
    """Roots before half of the panel in nine of ten views: what they leave free is the panel, and not a reflection on a darker one."""
    rng, empty = np.random.default_rng(1), panel()
    stack = np.repeat(empty[None], 40, axis=0)
    hidden = rng.random(stack.shape) < 0.9
    stack[:, 15:105, 30:130] *= np.where(hidden, rng.uniform(0.05, 0.9, hidden.shape), 1.0)[:, 15:105, 30:130].astype(np.float32)
    stack[:, 60:100, 70:90] *= 0.05  # and always before some
    found, _, glare = background.estimate(stack, np.ones(stack.shape, bool))
    assert not glare.any()
    assert np.abs(found / empty - 1).max() < 0.04


def test_views_past_a_wobbling_skirt_give_the_background() -> None:
    stack, empty = turned(0, 0.0)
    inside = np.ones(stack.shape, bool)
    inside[:9, :10] = False  # the skirt hides the upper rows in nine of twenty views
    inside[:16, :4] = False  # and the uppermost in most
    stack[~inside] = 100.0
    found = background.estimate(stack, inside).light
    assert (found[:4] == 0).all()
    assert np.abs(found / empty - 1)[4:].max() < 1e-3


def masked(**ring: float) -> tuple[Scene, cameras.View, refraction.Optics, np.ndarray]:
    """Return a scene of one ring, its first view, its optics, and where that view sees water."""
    scene = ring_of(1, **ring)
    view, optics = views_of(scene)[0], refraction.Optics.from_scene(scene)
    return scene, view, optics, background.water_mask(view, optics, scene)


def test_water_mask_ends_below_the_skirt_and_inside_the_walls() -> None:
    scene, view, optics, mask = masked()
    skirt = np.array([[scene.net_pot.outer_radius_mm, 0.0, scene.net_pot.skirt_bottom_mm]])
    cam = frames.apply(view.cam_from_canister, skirt)[0]
    top = np.flatnonzero(mask[:, 200])[0]
    assert scene.camera.focal_px[1] * cam[1] / cam[2] + scene.camera.principal_px[1] < top, "hidden by the skirt"
    lines, _ = cameras.water_lines(view, optics, np.array([[200.0, top], [200.0, top - 5.0]]))
    highest = np.maximum(lines.entry_z_mm, lines.entry_z_mm + 2 * lines.slope * optics.inner_radius_mm)
    assert highest[0] < scene.net_pot.grid_z_mm < highest[1] + 1.0, "hidden by the grid before the far wall"
    edge = 400.0 * np.tan(np.arcsin(76.2 / 400.0)) * scene.camera.focal_px[0] / 400.0
    assert np.flatnonzero(mask[200])[-1] - 199.5 == pytest.approx(0.98 * edge, abs=6)
    np.testing.assert_array_equal(mask[:, ::-1], mask)


def test_a_camera_that_looks_down_sees_no_light_through_the_base() -> None:
    """The wall stands on the base, which is opaque out to the outer wall: below its line there is no backlight to be covered."""
    _, view, optics, mask = masked(height_mm=10.0, tilt_deg=8.0)
    bottom = np.flatnonzero(mask[:, 200])[-1]
    line, _ = cameras.water_lines(view, optics, np.array([[200.0, bottom], [200.0, bottom + 2.0]]))
    far_z = line.entry_z_mm + 2.0 * line.slope * np.sqrt(optics.inner_radius_mm**2 - line.b_mm**2)
    down = line.slope * (optics.outer_radius_mm - optics.inner_radius_mm)
    assert far_z[0] + 0.8 * down[0] > optics.floor_z_mm
    assert far_z[1] + down[1] < optics.floor_z_mm + 0.5, "and no more is lost"
