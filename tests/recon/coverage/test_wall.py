"""Films and bubbles on the canister's wall, told from roots by turning the canister."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.projection import all_images
from rhizotwin.recon.coverage import background, outer_dirt, wall
from rhizotwin.recon.coverage.coarse_lines import CoarseLines
from rhizotwin.recon.coverage.wall import Face
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes.monitor import Monitor
from tests.recon.hull.exact_pictures import ring_of, views_of

Turn = tuple[dict[int, cameras.View], Optics, dict[int, np.ndarray]]


@pytest.fixture(scope="module")
def turn() -> Turn:
    """Return cameras round a canister, its optics, and what of the water each sees."""
    scene = ring_of(24)
    optics, views = Optics.from_scene(scene), dict(enumerate(views_of(scene)))
    return views, optics, {k: background.water_mask(view, optics, scene) for k, view in views.items()}


def through(paint: np.ndarray, where: wall.Crossings) -> np.ndarray:
    """Return the optical depth of what is painted on the wall, which each line of sight crosses twice."""
    return sum(wall.look_up(paint, column, row) for column, row in where.sides)


def test_films_are_given_back_bubbles_hidden_and_roots_stay(turn: Turn) -> None:
    """On a wall with a film of optical depth 0.2, with a bubble and a thin root that runs down."""
    views, optics, seen = turn
    film, things = np.zeros((2, *wall.INSIDE.shape(optics)), np.float32)
    film[40:52, 100:114], things[70:73, 200:203], things[30:110, 300] = 0.2, 1.5, 0.6
    where = {k: wall.crossings(view, optics) for k, view in views.items()}
    opacity = {k: (1.0 - np.exp(-through(film + things, where[k]) * seen[k])).astype(np.float32) for k in views}
    found = wall.detect_fouling(opacity, seen, where, optics, Monitor())
    assert found.film[44:48, 104:110] == pytest.approx(0.2, abs=0.02)
    assert found.bubbles[71, 201], "the bubble stands alone"
    assert not found.bubbles[:, 290:312].any(), "the root goes on"
    assert (found.film[30:110, 298:304] < 0.03).all(), "the root is no film"
    before = after = 0.0
    for k in views:
        free, visible = wall.remove_fouling(opacity[k], seen[k], where[k], found)
        clear = seen[k] & visible & (through(things, where[k]) == 0)
        before, after = before + float(opacity[k][clear].sum()), after + float(np.abs(free[clear]).sum())
    assert after < 0.25 * before


@pytest.mark.parametrize(("side", "ahead"), [(0, 0.4), (1, np.pi - 0.2)], ids=["near", "far"])
def test_lines_cross_the_wall_where_its_points_are_projected(turn: Turn, side: int, ahead: float) -> None:
    views, optics, _ = turn
    rows, columns = wall.INSIDE.shape(optics)
    view = views[3]
    where, (x, y, _), radius_mm = wall.crossings(view, optics).sides[side], view.centre_mm, optics.inner_radius_mm * (1.0 - 1e-9)
    azimuth = np.arctan2(y, x) + ahead
    px, count = all_images(view, optics, np.array([[radius_mm * np.cos(azimuth), radius_mm * np.sin(azimuth), -60.0]]))
    assert count[0] == 1
    u, v = np.rint(px[0, 0]).astype(int)
    column = np.mod(azimuth * columns / (2 * np.pi) - 0.5 - where[0][v, u] + columns / 2, columns) - columns / 2
    assert abs(column) < 1.5, "within the pixel"
    assert where[1][v, u] == pytest.approx((optics.water_z_mm + 60.0) * rows / (optics.water_z_mm - optics.floor_z_mm), abs=1.5)


PX_A_MM = 1.8


def pictured(turn: Turn, face: Face, paint: np.ndarray) -> dict[int, np.ndarray]:
    """Return the opacity of what is painted on a face of the wall, in every view, with some noise."""
    views, optics, seen = turn
    rng, found = np.random.default_rng(1), {}
    for k, view in views.items():
        depth = through(paint, wall.crossings(view, optics, face))
        noise = rng.normal(0.0, 0.01, depth.shape)
        found[k] = np.where(seen[k], 1.0 - np.exp(-depth) + noise, 0.0).astype(np.float32)
    return found


def with_dust_and_scratch(face: Face, optics: Optics) -> np.ndarray:
    paint = np.zeros(face.shape(optics), np.float32)
    middle, along = paint.shape[0] // 2, np.arange(40)
    paint[middle : middle + 2, 100:102] = paint[middle - 20 + along, 300 + along] = paint[middle - 20 + along, 301 + along] = 1.5
    return paint


def test_what_is_on_the_outside_is_found_in_its_place_and_hidden(turn: Turn) -> None:
    shrink = 2
    views, optics, seen = turn
    face = replace(outer_dirt.outer_face(optics, PX_A_MM), shrink=shrink)
    larger = views[0].camera.resized((400 * shrink, 300 * shrink))
    views = {k: replace(view, camera=larger) for k, view in views.items()}
    seen = {k: np.kron(part, np.ones((shrink, shrink), bool)) for k, part in seen.items()}
    paint = with_dust_and_scratch(face, optics)
    opacity = pictured((views, optics, seen), replace(face, shrink=1), paint)
    dirty = outer_dirt.detect_dirt(opacity, seen, views, optics, face, Monitor())
    assert dirty[paint > 0].mean() > 0.9
    assert dirty[paint == 0].mean() < 0.002, "a texel about it"
    before = after = 0.0
    for k, view in views.items():
        hidden = outer_dirt.hidden_pixels(opacity[k], dirty, wall.crossings(view, optics, face), face)
        before, after = before + float((opacity[k] > 0.2).sum()), after + float(((opacity[k] > 0.2) & ~hidden).sum())
    assert after < 0.15 * before


def test_growth_inside_noise_and_passing_roots_are_no_dirt(turn: Turn) -> None:
    """A root along the wall looks as a scratch does, but for light's way through the wall; others pass in a third of a place's views."""
    views, optics, seen = turn
    face, rng = outer_dirt.outer_face(optics, PX_A_MM), np.random.default_rng(2)
    inside = replace(face, outside=False)
    passing = {k: (0.5 * (rng.random(seen[k].shape) < 0.05) * seen[k]).astype(np.float32) for k in views}
    pictures = pictured(turn, inside, with_dust_and_scratch(inside, optics)), passing
    assert [outer_dirt.detect_dirt(opacity, seen, views, optics, face, Monitor()).any() for opacity in pictures] == [False, False]


@pytest.mark.parametrize(("image_wh", "beyond"), [((80, 60), False), ((83, 62), True)])
def test_every_pixel_has_a_value(image_wh: tuple[int, int], beyond: bool) -> None:
    scene = ring_of(1, image_wh)
    lines = CoarseLines.compute(views_of(scene)[0], Optics.from_scene(scene), step=4, beyond=beyond)
    columns = np.broadcast_to(4.0 * np.arange(lines.shape[1]) + 1.5, lines.shape)
    found = lines.upsample(columns)
    assert found.shape == (image_wh[1], image_wh[0])
    inner = found[:, 2 : 4 * lines.shape[1] - 2]
    np.testing.assert_allclose(inner, np.broadcast_to(np.arange(found.shape[1])[2 : 4 * lines.shape[1] - 2], inner.shape), atol=1e-4)
