"""Specimens in frames of their own come to hang in the water, or are refused with all limits and what would fit."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.specimens import MeshSpecimen, RsmlSpecimen
from rhizotwin.sim import placement
from rhizotwin.sim.specimen import SpecimenSolid, build_specimen

SCENE = Scene()
GRID_MM = SCENE.net_pot.grid_z_mm - placement.FREE_MM


def rsml(path: Path, points: list[tuple[float, ...]], *, unit: str = "mm", resolution: str = "1", diameter: float = 1.0) -> str:
    """Write a root through points, in the file's own steps, and return the file's name."""
    axes = "xyz"[: len(points[0])]
    nodes = "".join("<point " + " ".join(f'{a}="{v}"' for a, v in zip(axes, point, strict=True)) + "/>" for point in points)
    samples = "".join(f'<sample value="{diameter}"/>' for _ in points)
    thick = f'<functions><function name="diameter" domain="polyline">{samples}</function></functions>'
    root = f"<root><geometry><polyline>{nodes}</polyline></geometry>{thick}</root>"
    metadata = f"<metadata><unit>{unit}</unit><resolution>{resolution}</resolution></metadata>"
    path.write_text(f"<rsml>{metadata}<scene><plant>{root}</plant></scene></rsml>")
    return str(path)


def build(specimen: MeshSpecimen | RsmlSpecimen) -> SpecimenSolid:
    return build_specimen(Scene(specimen=specimen))


def test_a_root_with_its_collar_at_zero_is_hung_below_the_grid(tmp_path: Path) -> None:
    file = rsml(tmp_path / "a.rsml", [(50, 0, 0), (50, 0, -40), (70, 0, -80)])
    with pytest.raises(UserError, match="Move it below the grid with --shift-mm"):
        build(RsmlSpecimen(file=file))
    solid = build(RsmlSpecimen(file=file, place="auto"))
    (root,) = solid.roots
    assert solid.extents_max_mm[2] == pytest.approx(GRID_MM, abs=0.01)
    assert root.points_mm[:, 0] == pytest.approx([-10.0, -10.0, 10.0], abs=0.4)
    assert root.points_mm[0, 2] - root.points_mm[-1, 2] == pytest.approx(80.0)
    assert "81 mm (x, y, z), 1 to 1 mm thick" in solid.notes[0]


@pytest.mark.parametrize(
    "points",
    [[(0, 0, 0), (0, 5, 40), (3, 0, 80)], [(0, 0, 0), (5, 40, 0), (0, 80, 0)], [(0, 0), (5, 40), (0, 80)]],
    ids=["z down", "flat with z = 0", "2-D"],
)
def test_whatever_way_it_is_drawn_the_base_is_above(tmp_path: Path, points: list[tuple[float, ...]]) -> None:
    (root,) = build(RsmlSpecimen(file=rsml(tmp_path / "a.rsml", points), place="auto")).roots
    assert root.points_mm[0, 2] == pytest.approx(GRID_MM - 0.5, abs=0.1)  # its radius below
    assert root.points_mm[0, 2] - root.points_mm[-1, 2] == pytest.approx(80.0, abs=0.01)


def test_flip_scale_and_shift_in_this_order(tmp_path: Path) -> None:
    file = rsml(tmp_path / "a.rsml", [(0, 2, 20), (0, 4, 60)])
    (root,) = build(RsmlSpecimen(file=file, flip=True, scale=0.5, shift_mm=(1.0, 0.0, -30.0))).roots
    assert root.points_mm == pytest.approx(np.array([[1.0, -1.0, -40.0], [1.0, -2.0, -60.0]]))
    assert root.diameters_mm == pytest.approx(0.5)


def test_a_mesh_is_hung_and_scaled_as_one(tmp_path: Path) -> None:
    trimesh.creation.box((10.0, 20.0, 30.0)).export(tmp_path / "box.stl")
    solid = build(MeshSpecimen(file=str(tmp_path / "box.stl"), place="auto", scale=2.0))
    assert solid.volume_mm3 == pytest.approx(8.0 * 6000.0, rel=1e-6)
    assert solid.extents_max_mm == pytest.approx([10.0, 20.0, GRID_MM], abs=0.01)
    assert any("20 x 40 x 60 mm" in note for note in solid.notes)


@pytest.mark.parametrize("size", [300.0, 20.0], ids=["too large", "in the wrong place"])
def test_what_a_refusal_advises_is_accepted(tmp_path: Path, size: float) -> None:
    file = rsml(tmp_path / "a.rsml", [(0, 0, 0), (size, 0, -size), (0, 0, -2 * size)])
    with pytest.raises(UserError) as refused:
        build(RsmlSpecimen(file=file))
    text = str(refused.value)
    for limit in ("radius 73.025", "z -146.4 to -4", f"x {2 * size + 1:.3g} mm"):
        assert limit in text
    scale = float((re.search(r"--scale (\S+)", text) or ["", "1"])[1])
    shift = re.search(r"--shift-mm=(\S+?),(\S+?),(\S+?)[ ;]", text)
    assert shift is not None
    assert (scale < 1.0) == (size == 300.0)
    for told in ({"place": "auto"}, {"shift_mm": tuple(map(float, shift.groups()))}):
        placed = build(RsmlSpecimen(file=file, scale=scale, **told))
        assert placed.extents_max_mm[2] == pytest.approx(GRID_MM, abs=0.1)


def test_centimetres_that_look_like_dots_per_inch_are_told(tmp_path: Path) -> None:
    file = rsml(tmp_path / "a.rsml", [(0, 0), (0, 3000)], unit="cm", resolution="300", diameter=20)
    notes = build(RsmlSpecimen(file=file, place="auto")).notes
    assert "one unit of the coordinates in the file is 0.03333 mm" in notes[0]
    assert "'0.08467 mm'" in notes[1]
    assert len(build(RsmlSpecimen(file=file, place="auto", unit="0.03 mm")).notes) == 1
