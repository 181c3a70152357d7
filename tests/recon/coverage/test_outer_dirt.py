"""Dirt on the canister's outside, told from what is on its inside and from roots by turning the canister."""

from dataclasses import replace

import numpy as np
import pytest

from rhizotwin.recon.coverage import outer_dirt, wall
from rhizotwin.recon.coverage.wall import Face
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes.monitor import Monitor
from tests.recon.coverage.conftest import Turn

PX_A_MM = 1.8


def pictured(turn: Turn, face: Face, paint: np.ndarray) -> dict[int, np.ndarray]:
    """Return the opacity of what is painted on a face of the wall, in every view, with some noise."""
    views, optics, seen = turn
    rng, found = np.random.default_rng(1), {}
    for k, view in views.items():
        where = wall.crossings(view, optics, face)
        depth = sum(wall.look_up(paint, where.column[side], where.row[side]) for side in (0, 1))
        noise = rng.normal(0.0, 0.01, depth.shape)
        found[k] = np.where(seen[k], 1.0 - np.exp(-depth) + noise, 0.0).astype(np.float32)
    return found


def enlarged(turn: Turn, times: int) -> Turn:
    """Return the same views with pictures of more pixels."""
    views, optics, seen = turn
    views = {k: replace(view, camera=view.camera.resized(tuple(times * n for n in view.camera.image_wh))) for k, view in views.items()}
    return views, optics, {k: np.kron(part, np.ones((times, times), bool)) for k, part in seen.items()}


def with_dust_and_scratch(face: Face, optics: Optics) -> np.ndarray:
    paint = np.zeros(face.shape(optics), np.float32)
    middle, along = paint.shape[0] // 2, np.arange(40)
    paint[middle : middle + 2, 100:102] = paint[middle - 20 + along, 300 + along] = paint[middle - 20 + along, 301 + along] = 1.5
    return paint


@pytest.mark.parametrize("shrink", [1, 2])
def test_what_is_on_the_outside_is_found_in_its_place_and_hidden(turn: Turn, shrink: int) -> None:
    face = replace(outer_dirt.outer_face(turn[1], PX_A_MM), shrink=shrink)
    views, optics, seen = turn = enlarged(turn, shrink)
    paint = with_dust_and_scratch(face, optics)
    opacity = pictured(turn, replace(face, shrink=1), paint)
    dirty = outer_dirt.detect_dirt(opacity, seen, views, optics, face, Monitor())
    assert dirty[paint > 0].mean() > 0.9
    assert dirty[paint == 0].mean() < 0.002, "a texel about it"
    before = after = 0.0
    for k, view in views.items():
        hidden = outer_dirt.hidden_pixels(opacity[k], dirty, wall.crossings(view, optics, face), face)
        before, after = before + float((opacity[k] > 0.2).sum()), after + float(((opacity[k] > 0.2) & ~hidden).sum())
    assert after < 0.15 * before


def test_what_grows_on_the_inside_noise_and_passing_roots_are_no_dirt(turn: Turn) -> None:
    """A root along the wall looks as a scratch does, but for light's way through the wall; others pass in a third of a place's views."""
    views, optics, seen = turn
    face, rng = outer_dirt.outer_face(optics, PX_A_MM), np.random.default_rng(2)
    inside = replace(face, outside=False)
    passing = {k: (0.5 * (rng.random(seen[k].shape) < 0.05) * seen[k]).astype(np.float32) for k in views}
    for opacity in (pictured(turn, inside, with_dust_and_scratch(inside, optics)), passing):
        assert not outer_dirt.detect_dirt(opacity, seen, views, optics, face, Monitor()).any()
