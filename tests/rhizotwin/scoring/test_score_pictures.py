"""A result against pictures that it has not seen: the drawing against exact silhouettes, the numbers against shifts that are known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.reconstruct import reconstruct
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.recon.settings import HullSettings, Settings
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import CapturePlan, Ring, Scene
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scoring import drawn
from rhizotwin.scoring.score_pictures import compare, gather, score_pictures
from tests.recon.hull import exact_pictures
from tests.roots import straight

NOTHING = Mesh(vertices_mm=np.zeros((0, 3)), faces=np.zeros((0, 3), np.int64))
TUBE = ((8.0, -6.0, -30.0), (-14.0, 10.0, -80.0), 1.2)


def scene() -> Scene:
    small = Scene()
    return replace(small, camera=small.camera.resized((320, 240)), plan=CapturePlan(rings=(Ring(views=4),)))


def tube_mesh() -> Mesh:
    """Return the tube with round ends, as a surface."""
    a, b, radius_mm = np.array(TUBE[0]), np.array(TUBE[1]), TUBE[2]
    height = float(np.linalg.norm(b - a))
    made = trimesh.creation.capsule(radius=radius_mm, height=height, count=(32, 32))
    made.apply_transform(trimesh.geometry.align_vectors([0.0, 0.0, 1.0], (b - a) / height))
    made.apply_translation(0.5 * (a + b))
    # long triangles would be straight where light makes them bend
    vertices, faces = trimesh.remesh.subdivide_to_size(made.vertices, made.faces, 2.0)
    return Mesh(vertices_mm=vertices, faces=faces)


@pytest.mark.parametrize("number", [0, 1])
def test_what_is_drawn_is_what_the_water_shows(number: int) -> None:
    """Against silhouettes that follow every line of sight by itself."""
    optics, view = Optics.from_scene(scene()), exact_pictures.views_of(scene())[number]
    root = straight(*TUBE[:2], 2.0 * TUBE[2], count=60)
    exact = exact_pictures.drawn(view, optics, (TUBE,), samples=5)
    surface, band = drawn.coverage(view, optics, tube_mesh(), ()), drawn.coverage(view, optics, NOTHING, (root,))
    area = float(exact.coverage[exact.usable].sum())
    assert float(surface[exact.usable].sum()) == pytest.approx(area, rel=0.03)
    assert float(band[exact.usable].sum()) == pytest.approx(area, rel=0.03 + 0.02 * np.pi * TUBE[2] ** 2)  # a band has no ends
    assert np.abs(surface - exact.coverage)[exact.usable].max() < 0.25
    assert compare(surface, exact).edges_px.max() < 0.25


def disc(column: float) -> Silhouette:
    x, y = np.meshgrid(np.arange(120.0), np.arange(100.0))
    return Silhouette(np.clip(30.5 - np.hypot(x - column, y - 50.0), 0.0, 1.0).astype(np.float32), np.ones((100, 120), bool))


def stripe(column: float, rows: slice = slice(None)) -> Silhouette:
    cover = np.zeros((100, 120), np.float32)
    cover[rows] = np.clip(2.0 - np.abs(np.arange(120.0) - column), 0.0, 1.0)
    return Silhouette(cover, np.ones(cover.shape, bool))


@pytest.mark.parametrize("shift_px", [0.0, 1.5])
def test_a_shift_is_told_as_what_it_is(shift_px: float) -> None:
    found = gather("disc", ["one"], [compare(disc(60.0 + shift_px).coverage, disc(60.0))], known=0)
    radius, half = 30.0, 0.5 * shift_px
    lens = 2.0 * radius**2 * np.arccos(half / radius) - 2.0 * half * np.sqrt(radius**2 - half**2)
    assert found.iou == pytest.approx(lens / (2.0 * np.pi * radius**2 - lens), abs=0.01)
    assert found.edge_median_px == pytest.approx(shift_px / np.sqrt(2.0), abs=0.1)  # half of a circle is moved by more
    assert found.edge_p95_px == pytest.approx(shift_px, abs=0.1)


def test_distances_of_lines_misses_and_surplus_are_told() -> None:
    found = gather("stripe", ["one"], [compare(stripe(51.5).coverage, stripe(50.0))], known=0)
    assert found.line_median_px == pytest.approx(1.5, abs=0.3)
    assert (found.explained, found.seen) == (1.0, 1.0)
    half = stripe(50.0, np.s_[:50])
    missed, too_much = compare(half.coverage, stripe(50.0)), compare(stripe(50.0).coverage, half)
    shares = [(one.explained[0] / one.explained[1], one.seen[0] / one.seen[1]) for one in (missed, too_much)]
    assert shares == [(pytest.approx(0.52, abs=0.04), 1.0), (1.0, pytest.approx(0.52, abs=0.04))]
    none = gather("nothing", ["one"], [compare(np.zeros((100, 120), np.float32), disc(60.0))], known=0)
    assert (none.iou, none.explained, none.seen) == (0.0, 0.0, 0.0)
    assert none.edge_median_px > 10.0


def write_scan(folder: Path, views: range, made: Scene) -> Path:
    """Write exact silhouettes of some views as a dataset."""
    optics, every = Optics.from_scene(made), exact_pictures.views_of(made)
    exact_pictures.masks(folder, made, {k: exact_pictures.drawn(every[k], optics, (TUBE,)).coverage for k in views})
    return folder


def test_only_pictures_that_were_not_used_count(tmp_path: Path) -> None:
    made = replace(scene(), plan=CapturePlan(rings=(Ring(views=12),)))
    whole = write_scan(tmp_path / "whole", range(12), made)
    part = write_scan(tmp_path / "part", range(0, 12, 2), made)
    result = reconstruct(part, settings=Settings(voxel_mm=0.5, hull=HullSettings(finest_mm=0.5)))
    found = score_pictures(result, whole, monitor=Monitor.of(None))
    assert (found.pictures, found.known) == (6, 6)
    assert found.iou > 0.9
    assert found.edge_median_px < 0.3
    assert min(found.explained, found.seen) > 0.97
    assert "6 unused pictures were compared; 6 used pictures were excluded" in found.table()
    with pytest.raises(UserError, match="is the dataset of the result"):
        score_pictures(result, part, monitor=Monitor.of(None))
    with pytest.raises(UserError, match="all pictures"):
        score_pictures(result, write_scan(tmp_path / "same", range(0, 10, 2), made), monitor=Monitor.of(None))
