"""Views that contradict all others, among exact silhouettes of a plant of rods."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.hull import agreement
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from tests.recon.hull import exact_pictures

RODS = (
    ((2.0, 0.0, -12.0), (1.0, 1.0, -70.0), 1.0),
    ((2.0, 0.0, -25.0), (25.0, 5.0, -45.0), 0.5),
    ((1.5, 0.5, -35.0), (-12.0, 16.0, -60.0), 0.5),
    ((1.5, 0.5, -40.0), (4.0, -20.0, -50.0), 0.5),
)
WRONG = 4


@cache
def scan() -> tuple[ViewBank, tuple[Silhouette, ...], Water]:
    scene = Scene(camera=Camera().resized((240, 180)), plan=CapturePlan(rings=(Ring(views=20),)))
    optics, views = Optics.from_scene(scene), exact_pictures.views_of(scene)
    return (
        ViewBank.pack(views, optics),
        tuple(exact_pictures.drawn(view, optics, RODS) for view in views),
        Water(optics.inner_radius_mm, -8.0, -120.0),
    )


def spoilt(kind: str) -> list[Silhouette]:
    one = scan()[1][WRONG]
    coverage = one.coverage.copy()
    if kind == "mirrored":
        coverage = np.where(one.usable, coverage[:, ::-1], 0.0).astype(np.float32)
    else:
        coverage[len(coverage) // 3 :] = {"bright below": 0.0, "dark below": 1.0}[kind]
    return [replace(one, coverage=coverage) if k == WRONG else right for k, right in enumerate(scan()[1])]


def test_no_view_of_a_right_scan_is_wrong() -> None:
    bank, silhouettes, water = scan()
    assert agreement.find_wrong_views(bank, silhouettes, water) == []


@pytest.mark.parametrize("kind", ["mirrored", "bright below", "dark below"])
def test_one_wrong_view_is_found(kind: str) -> None:
    bank, _, water = scan()
    assert agreement.find_wrong_views(bank, spoilt(kind), water) == [WRONG]


def test_of_many_wrong_views_none_is_named() -> None:
    bank, silhouettes, water = scan()
    mirrored = [replace(one, coverage=one.coverage[:, ::-1] * one.usable) for one in silhouettes[:6]]
    assert agreement.find_wrong_views(bank, [*mirrored, *silhouettes[6:]], water) == []


def test_a_cube_in_the_wrong_place_is_excluded_and_the_roots_are_missed() -> None:
    bank, silhouettes, _ = scan()
    right, wrong = np.array([[1.5, 0.5, -41.0]]), np.array([[-20.0, -20.0, -41.0]])
    found = agreement.compare(bank, silhouettes, np.concatenate([right, wrong]), np.ones(2))
    assert not found.excluded[:, 0].any()
    assert found.excluded[:, 1].mean() > 0.7
    assert found.share > 0.9
