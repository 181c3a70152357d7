"""The pictures and the page of a result, and the small renderer behind them."""

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh

from rhizotwin.recon.results import pictures, report, shading
from rhizotwin.recon.results.result_files import Mesh
from rhizotwin.scenes.dataset import load_dataset, save_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.rsml import Root, write_rsml


def as_mesh(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(vertices_mm=np.asarray(solid.vertices), faces=np.asarray(solid.faces))


def test_raster_of_a_ball_has_its_area_depth_and_normals():
    ball = trimesh.creation.icosphere(subdivisions=5, radius=4.0)
    ball.apply_translation([1.0, 2.0, -30.0])
    seen = shading.rasterise(as_mesh(ball), shading.FRONT, box_mm=(-5.0, 9.0, -40.0, -20.0), px_mm=0.05)
    assert seen.hit.shape == (400, 280)
    assert seen.hit.sum() * 0.05**2 == pytest.approx(np.pi * 16.0, rel=3e-3)
    rows, columns = np.nonzero(seen.hit)
    assert columns.mean() * 0.05 - 5.0 + 0.025 == pytest.approx(2.0, abs=0.01)  # y of the centre
    assert -20.0 - (rows.mean() + 0.5) * 0.05 == pytest.approx(-30.0, abs=0.01)
    assert seen.depth_mm[seen.hit].max() == pytest.approx(5.0, abs=0.01)  # towards +x
    assert seen.normal[200, 140] == pytest.approx([0.0, 0.0, 1.0], abs=0.03)


def test_distances_are_those_of_the_points_that_a_picture_shows():
    """A ball within another of the same centre but for a shift: nearest where it is shifted to, which one side sees and the other not."""
    small, large = trimesh.creation.icosphere(subdivisions=4, radius=3.0), trimesh.creation.icosphere(subdivisions=4, radius=4.0)
    small.apply_translation([0.5, 0.0, 0.0])
    box, px_mm = (-5.0, 5.0, -5.0, 5.0), 0.025
    for side, middle in ((shading.FRONT, 0.5), (shading.SIDE, 4.0 - np.hypot(3.0, 0.5))):
        seen = shading.rasterise(as_mesh(small), side, box_mm=box, px_mm=px_mm)
        apart = pictures.distances_shown(seen, side, box, px_mm, as_mesh(large))
        column = 200 if side is shading.FRONT else 220
        assert apart[200, column] == pytest.approx(middle, abs=0.02)
        assert (apart[seen.hit] > 0.45).all()
        assert (apart[~seen.hit] == 0.0).all()


def test_a_ball_turned_inside_out_looks_the_same():
    ball = trimesh.creation.icosphere(subdivisions=2, radius=4.0)
    ball.apply_translation([50.0, 0.0, 0.0])
    for mesh in (as_mesh(ball), Mesh(vertices_mm=np.asarray(ball.vertices), faces=np.asarray(ball.faces)[:, ::-1])):
        assert np.einsum("ij,ij->i", shading.vertex_normals(mesh), mesh.vertices_mm - [50.0, 0.0, 0.0]).min() > 0.0


def test_side_view_looks_along_y_and_keeps_the_nearer_surface():
    near = trimesh.creation.box(bounds=[[-1.0, -5.0, -1.0], [1.0, -4.0, 1.0]])
    far = trimesh.creation.box(bounds=[[-2.0, 4.0, -2.0], [2.0, 5.0, 2.0]])
    seen = shading.rasterise(as_mesh(near + far), shading.SIDE, box_mm=(-3.0, 3.0, -3.0, 3.0), px_mm=0.1)
    assert seen.depth_mm[30, 30] == pytest.approx(5.0)
    assert seen.depth_mm[12, 30] == pytest.approx(-4.0)
    assert seen.hit.sum() == 40 * 40


def test_shading_is_transparent_off_the_surface_and_opaque_on_it():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=3.0)
    seen = shading.rasterise(as_mesh(ball), shading.FRONT, box_mm=(-4.0, 4.0, -4.0, 4.0), px_mm=0.1)
    picture = shading.shade(seen, (0.8, 0.5, 0.2), px_mm=0.1, shrink=2)
    assert picture.shape == (40, 40, 4)
    assert picture[20, 20, 3] == 1.0
    assert picture[0, 0, 3] == 0.0
    assert 0.0 <= picture.min() <= picture.max() <= 1.0
    assert picture[14, 14, :3].mean() > picture[26, 26, :3].mean()  # light from the upper left


def test_all_pictures(scan):
    made = scan(radius_mm=6.3, shift_mm=(0.5, 0.0, 0.0), lost=(3,))
    written = report.write_pictures(made.result, made.dataset, truth_mesh=made.dataset / "truth" / "specimen.ply")
    assert [path.name for path in written] == ["inputs.png", "cameras.png", "shape.png", "shape_and_truth.png"]
    for path in written:
        picture = cv2.imread(str(path))
        assert picture is not None
        assert min(picture.shape[:2]) > 300
        assert picture.std() > 5.0


def test_roots_get_pictures(scan):
    made = scan(voxel_mm=1.0)
    turn = np.linspace(0.0, 3.0, 30)
    tap = Root(points_mm=np.stack([4.0 * turn, -turn, -45.0 - 3.0 * turn], 1), diameters_mm=np.full(30, 1.5), order=0, parent=-1)
    write_rsml(made.result / "roots.rsml", [tap])
    assert {"roots.png", "lengths.png"} <= {path.name for path in report.write_pictures(made.result, made.dataset)}


def test_without_silhouettes_and_truth_there_are_still_pictures(scan):
    made = scan(voxel_mm=1.0)
    shutil.rmtree(made.result / "silhouettes")
    shutil.rmtree(made.dataset / "truth")
    written = report.write_pictures(made.result, made.dataset)
    assert [path.name for path in written] == ["cameras.png", "shape.png"]


def test_pictures_repeat_exactly(scan):
    made = scan(voxel_mm=1.0)
    first = [path.read_bytes() for path in report.write_pictures(made.result, made.dataset)]
    assert first == [path.read_bytes() for path in report.write_pictures(made.result, made.dataset)]


def test_a_result_of_another_dataset_is_refused(scan):
    made = scan(voxel_mm=1.0)
    made.edit_summary(scene="radish", dataset_sha256="0" * 64)
    with pytest.raises(UserError, match="radish"):
        report.write_pictures(made.result, made.dataset)
    assert not (made.result / "pictures").exists()


def test_a_dataset_that_changes_meanwhile_does_not_spoil_the_report(scan, caplog):
    """A resumed scan takes a frame out, and a person deletes a picture, while the shape is being found."""
    made = scan()
    loaded = load_dataset(made.dataset)
    save_dataset(replace(loaded, frames=loaded.frames[1:]))
    (made.dataset / loaded.frames[0].file).unlink()
    written = report.write_pictures(made.result, loaded)
    assert "inputs.png" in [path.name for path in written]
    assert "view_000.png: the picture is missing" in caplog.text
    assert "leaves this picture out" in caplog.text
    with pytest.raises(UserError, match="was not reconstructed from"):
        report.write_pictures(made.result, made.dataset)
