"""The pictures and the page of a result, and the small renderer behind them."""

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh

from rhizotwin.drawing import shading
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.report import charts, figures, result_pictures, sides
from rhizotwin.report.report_data import ReportData
from rhizotwin.scenes.dataset import load_dataset, save_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.figures import png


def ball(radius_mm: float, at_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Mesh:
    return Mesh.of(trimesh.creation.icosphere(subdivisions=4, radius=radius_mm).apply_translation(at_mm))


def test_a_picture_of_a_ball_has_its_area_depth_and_light():
    seen = shading.rasterise(ball(4.0, (1.0, 2.0, -30.0)), shading.FRONT, box_mm=(-5.0, 9.0, -40.0, -20.0), px_mm=0.05)
    assert seen.hit.shape == (400, 280)
    assert seen.hit.sum() * 0.05**2 == pytest.approx(np.pi * 16.0, rel=5e-3)
    rows, columns = np.nonzero(seen.hit)
    assert columns.mean() * 0.05 - 5.0 + 0.025 == pytest.approx(2.0, abs=0.01)  # y of the centre
    assert -20.0 - (rows.mean() + 0.5) * 0.05 == pytest.approx(-30.0, abs=0.01)
    assert seen.depth_mm[seen.hit].max() == pytest.approx(5.0, abs=0.01)  # towards +x
    assert seen.normal[200, 140] == pytest.approx([0.0, 0.0, 1.0], abs=0.05)
    picture = shading.shade(seen, (0.8, 0.5, 0.2), px_mm=0.05, shrink=2)
    assert picture.shape == (200, 140, 4)
    assert (picture[100, 70, 3], picture[0, 0, 3]) == (1.0, 0.0), "transparent off the surface and opaque on it"
    assert 0.0 <= picture.min() <= picture.max() <= 1.0
    assert picture[75, 45, :3].mean() > picture[125, 95, :3].mean()


def test_all_pictures_of_a_result(scan):
    made = scan(radius_mm=6.3, shift_mm=(0.5, 0.0, 0.0), lost=(3,), voxel_mm=1.0)
    written = result_pictures.write_pictures(ReportData.read(made.result, made.dataset), figures="png")
    assert [path.name for path in written] == ["shape.png", "inputs.png", "shape_and_truth.png"]
    pictures = [cv2.imread(str(path)) for path in written]
    assert min(min(picture.shape[:2]) for picture in pictures) > 300
    assert min(picture.std() for picture in pictures) > 5.0


def test_a_name_is_not_a_formula():
    """Matplotlib reads text between dollar signs as a formula, and raises an error if it is not one."""
    shape = ball(4.0, (0.0, 0.0, -30.0))
    drawn = figures.shape_and_truth(shape, shape, title=r"$\frac$")
    assert png(drawn, dpi=20).startswith(b"\x89PNG")


def test_both_sides_have_the_same_scale_and_height():
    front, side = sides.boxes(np.array([[0.0, 0.0, -10.0], [30.0, 5.0, -60.0]]), (shading.FRONT, shading.SIDE))
    assert front == (2.5 - 19.0, 2.5 + 19.0, -64.0, -6.0)
    assert side == (15.0 - 19.0, 15.0 + 19.0, -64.0, -6.0)


@pytest.mark.parametrize(
    ("low", "high", "expected"), [(0.0, 7.3, [0, 2, 4, 6]), (-61.0, -9.0, [-60, -40, -20]), (0.0, 0.31, [0, 0.1, 0.2, 0.3])]
)
def test_ticks_are_round_numbers_within_the_axis(low: float, high: float, expected: list[float]):
    assert charts.ticks(low, high, most=4) == pytest.approx(expected)


def test_pictures_without_silhouettes_and_truth_repeat_exactly(scan):
    made = scan(voxel_mm=1.0)
    shutil.rmtree(made.result / "silhouettes")
    shutil.rmtree(made.dataset / "truth")
    first, second = (result_pictures.write_pictures(ReportData.read(made.result, made.dataset), figures="png") for _ in range(2))
    assert [path.name for path in first] == ["shape.png"]
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]


def test_a_dataset_that_changes_does_not_spoil_the_report(scan, caplog):
    """A resumed scan takes a frame out, and a person deletes a picture, while the shape is being found."""
    made = scan(voxel_mm=1.0)
    loaded = load_dataset(made.dataset)
    save_dataset(replace(loaded, frames=loaded.frames[1:]))
    (made.dataset / loaded.frames[0].file).unlink()
    written = result_pictures.write_pictures(ReportData.read(made.result, loaded), figures="png")
    assert "inputs.png" in [path.name for path in written]
    assert "view_000.png: the picture is missing" in caplog.text
    assert "drawn without this picture" in caplog.text
    with pytest.raises(UserError, match="was not reconstructed from"):
        ReportData.read(made.result, made.dataset)
