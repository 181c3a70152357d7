"""Specimens and shoots of every kind become one closed solid, hung in the water if asked, or are refused in one sentence."""

import re
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.plants import Plant
from rhizotwin.scenes.rsml import Root, length_mm, write_rsml
from rhizotwin.scenes.shoots import Shoot
from rhizotwin.scenes.solution import Solution
from rhizotwin.scenes.specimens import GrownSpecimen, MeshSpecimen, RootOrder, RsmlSpecimen, SphereSpecimen
from rhizotwin.scenes.thickened_roots import BURIED_MM
from rhizotwin.sim import placement, solids
from rhizotwin.sim import shoot as shoots
from rhizotwin.sim.shoot import ShootSolid, build_shoot
from rhizotwin.sim.specimen import SpecimenSolid, build_specimen

SCENE = Scene()
GRID_MM = SCENE.net_pot.grid_z_mm - placement.FREE_MM


def rsml(path: Path, points: list[tuple[float, ...]], *, unit: str = "mm", diameter: float = 1.0) -> str:
    axes = "xyz"[: len(points[0])]
    nodes = "".join("<point " + " ".join(f'{a}="{v}"' for a, v in zip(axes, point, strict=True)) + "/>" for point in points)
    samples = "".join(f'<sample value="{diameter}"/>' for _ in points)
    thick = f'<functions><function name="diameter" domain="polyline">{samples}</function></functions>'
    root = f"<root><geometry><polyline>{nodes}</polyline></geometry>{thick}</root>"
    metadata = f"<metadata><unit>{unit}</unit><resolution>1</resolution></metadata>"
    path.write_text(f"<rsml>{metadata}<scene><plant>{root}</plant></scene></rsml>")
    return str(path)


def build(specimen: SphereSpecimen | MeshSpecimen | RsmlSpecimen | GrownSpecimen, folder: Path | None = None) -> SpecimenSolid:
    return build_specimen(Scene(specimen=specimen), folder=folder)


def box(size_mm: float = 10.0, at_mm: tuple[float, float, float] = (0.0, 0.0, -50.0)) -> trimesh.Trimesh:
    return trimesh.creation.box((size_mm,) * 3, transform=trimesh.transformations.translation_matrix(at_mm))


def inside_out(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.invert()
    return mesh


def through_file(mesh: trimesh.Trimesh, folder: Path, name: str = "box.ply") -> SpecimenSolid:
    mesh.export(folder / name)
    return build(MeshSpecimen(file=name), folder)


def closed(solid: SpecimenSolid) -> bool:
    mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    return bool(mesh.is_watertight and mesh.is_winding_consistent and abs(mesh.volume / solid.volume_mm3 - 1.0) < 1e-9)


def test_a_sphere_has_the_ball_s_volume_and_place() -> None:
    solid = build(SphereSpecimen(diameter_mm=20.0, centre_mm=(5.0, -3.0, -60.0)))
    assert solid.volume_mm3 == pytest.approx(4.0 / 3.0 * np.pi * 1000.0, rel=1e-9)
    assert solid.extents_min_mm == pytest.approx([-5.0, -13.0, -70.0], abs=0.002)
    assert solid.extents_max_mm == pytest.approx([15.0, 7.0, -50.0], abs=0.002)
    assert np.linalg.norm(solid.vertices - [5.0, -3.0, -60.0], axis=1) == pytest.approx(10.0, abs=0.001)
    assert closed(solid)


@pytest.mark.parametrize("name", ["box.ply", "box.STL", "box.obj"])
def test_meshes_of_every_format(tmp_path: Path, name: str) -> None:
    solid = through_file(box(), tmp_path, name)
    assert solid.volume_mm3 == pytest.approx(1000.0, rel=1e-6)
    assert solid.notes == ()
    assert closed(solid)


def test_faces_turned_the_wrong_way_are_turned_back_and_said_so(tmp_path: Path) -> None:
    solid = through_file(inside_out(box()), tmp_path, "box.stl")
    assert solid.volume_mm3 == pytest.approx(1000.0, rel=1e-6)
    assert "pointed inwards" in solid.notes[0]
    faces = np.array(box().faces)
    faces[3] = faces[3, ::-1]
    solid = through_file(trimesh.Trimesh(box().vertices, faces, process=False), tmp_path)
    assert solid.volume_mm3 == pytest.approx(1000.0, rel=1e-6)
    assert "turned" in solid.notes[0]


def test_overlapping_shells_count_once_and_cavities_are_kept(tmp_path: Path) -> None:
    shells = trimesh.util.concatenate([box(), box(at_mm=(5.0, 0.0, -50.0)), inside_out(box(4.0))])
    solid = through_file(shells, tmp_path, "shells.stl")
    assert solid.volume_mm3 == pytest.approx(1500.0 - 64.0, rel=1e-5)
    assert any("cavit" in note for note in solid.notes)


@pytest.mark.parametrize(("bend_mm", "match"), [(4.0, ""), (0.6, "folds into itself")])
def test_a_coil_that_intersects_itself(tmp_path: Path, bend_mm: float, match: str) -> None:
    turn = np.linspace(0.0, 4.0 * np.pi, 121)
    line = np.stack([bend_mm * np.cos(turn), bend_mm * np.sin(turn), -50.0 - 0.1 * turn], axis=1)  # 0.6 mm between the turns
    coil = trimesh.Trimesh(*solids.tube(line, np.full(121, 1.0), sides=24), process=False)
    with pytest.raises(UserError, match=match) if match else nullcontext():
        solid = through_file(coil, tmp_path)
        root = Root(points_mm=line, diameters_mm=np.full(121, 2.0), order=0, parent=-1)
        assert solid.volume_mm3 == pytest.approx(solids.unite_roots([root]).volume(), rel=2e-4)
        assert solid.volume_mm3 < 0.9 * coil.volume
        assert "counted once" in solid.notes[0]


NO_MESH = {
    "truncated.ply": (box().export(file_type="ply")[:-70], "truncated"),
    "thing.docx": (b"x", r"\.ply, \.stl, \.obj"),
    "nan.obj": (b"v nan 0 0\nv 9 0 0\nv 0 9 0\nv 0 0 9\nf 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n", "could not be read|not finite|empty"),
}


@pytest.mark.parametrize(("name", "content", "match"), [(name, *case) for name, case in NO_MESH.items()], ids=NO_MESH)
def test_files_that_are_no_mesh_are_refused_by_name(tmp_path: Path, name: str, content: bytes, match: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(UserError, match=match) as caught:
        build(MeshSpecimen(file=name), tmp_path)
    assert name in str(caught.value)


MISFITS = {
    "open": (lambda: trimesh.Trimesh(box().vertices, box().faces[:-1], process=False), r"box\.ply: .* not closed at 3 edges"),
    "in metres": (lambda: box(0.01), "must be in millimetres"),
    "in the wall": (lambda: box(at_mm=(70.0, 0.0, -50.0)), r"2\.1\d mm past the inner wall .* at \(75\.0, [-\d.]+, -[45]5\.0\)"),
    "above the surface": (lambda: box(at_mm=(0.0, 0.0, -6.0)), r"3\.00 mm above the water's surface"),
}


@pytest.mark.parametrize(("mesh", "match"), MISFITS.values(), ids=MISFITS.keys())
def test_meshes_that_are_no_specimen_are_refused(tmp_path: Path, mesh: Callable[[], trimesh.Trimesh], match: str) -> None:
    with pytest.raises(UserError, match=match):
        through_file(mesh(), tmp_path)


def test_rsml_becomes_tubes(tmp_path: Path) -> None:
    rsml(tmp_path / "root.rsml", [(0, 0, -2), (0, 0, -7)], unit="cm", diameter=0.2)
    solid = build(RsmlSpecimen(file="root.rsml"), tmp_path)
    assert solid.volume_mm3 == pytest.approx(np.pi * 50.0 + 4.0 / 3.0 * np.pi, rel=0.01)
    assert solid.traits["total_length_mm"] == pytest.approx(50.0)
    assert closed(solid)


def test_laterals_count_from_the_skin_of_a_storage_root(tmp_path: Path) -> None:
    storage = Root(points_mm=np.array([[0, 0, -20], [0, 0, -60]], float), diameters_mm=np.full(2, 12.0), order=0, parent=-1)
    lateral = Root(points_mm=np.array([[0, 0, -40], [25, 0, -40]], float), diameters_mm=np.full(2, 0.5), order=1, parent=0)
    write_rsml(tmp_path / "roots.rsml", [storage, lateral])
    solid = build(RsmlSpecimen(file="roots.rsml"), tmp_path)
    assert solid.traits["total_length_mm"] == pytest.approx(40.0 + 25.0 - (6.0 - BURIED_MM), abs=0.1)
    assert any("5 mm of laterals" in note for note in solid.notes)


def test_a_volume_out_of_reach_is_refused() -> None:
    with pytest.raises(UserError, match=r"mm (past|below|above) the|was not reached"):
        build(GrownSpecimen(volume_ml=400.0, age_days=3.0))


def test_two_plants_are_one_solid_and_each_is_known() -> None:
    tube = RootOrder(diameter_mm=1.0, elongation_mm_per_day=20.0, max_length_mm=30.0)
    grown = GrownSpecimen(age_days=3.0, volume_ml=0.02, orders=(tube,))
    plants = tuple(Plant(plant=name, at_mm=(x, 0.0), specimen=grown) for name, x in (("A", -10.0), ("B", 10.0)))
    solid = build_specimen(Scene(plants=plants))
    assert solid.volume_mm3 == pytest.approx(40.0, rel=1e-5)
    assert {name: one["volume_mm3"] for name, one in solid.plants.items()} == pytest.approx({"A": 20.0, "B": 20.0}, rel=1e-5)
    assert [(root.plant, root.parent) for root in solid.roots] == [("A", -1), ("B", -1)]
    assert solid.roots[1].points_mm[0] - solid.roots[0].points_mm[0] == pytest.approx([20.0, 0.0, 0.0])
    assert solid.traits["total_length_mm"] == pytest.approx(2.0 * solid.plants["A"]["traits"]["total_length_mm"])
    with pytest.raises(UserError, match="plant A of scene 'scene' has no specimen"):
        build_specimen(Scene(plants=(Plant(plant="A"),)))


def test_a_root_with_its_collar_at_zero_is_hung_below_the_grid(tmp_path: Path) -> None:
    file = rsml(tmp_path / "a.rsml", [(50, 0, 0), (50, 0, -40), (70, 0, -80)])
    with pytest.raises(UserError, match="Move it below the grid with --shift-mm"):
        build(RsmlSpecimen(file=file))
    solid = build(RsmlSpecimen(file=file, place="auto"))
    (root,) = solid.roots
    assert solid.extents_max_mm[2] == pytest.approx(GRID_MM, abs=0.01)
    assert root.points_mm[:, 0] == pytest.approx([-10.0, -10.0, 10.0], abs=0.4)
    assert root.points_mm[0, 2] - root.points_mm[-1, 2] == pytest.approx(80.0)


@pytest.mark.parametrize("points", [[(0, 0, 0), (0, 5, 40), (3, 0, 80)], [(0, 0), (5, 40), (0, 80)]], ids=["z down", "2-D"])
def test_whatever_way_it_is_drawn_the_base_is_above(tmp_path: Path, points: list[tuple[float, ...]]) -> None:
    (root,) = build(RsmlSpecimen(file=rsml(tmp_path / "a.rsml", points), place="auto")).roots
    assert root.points_mm[0, 2] == pytest.approx(GRID_MM - 0.5, abs=0.1)  # its radius below
    assert root.points_mm[0, 2] - root.points_mm[-1, 2] == pytest.approx(80.0, abs=0.01)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_sideways_roots_are_said_and_set_upright(tmp_path: Path, axis: str) -> None:
    points = [tuple(np.roll([10.0 * k, 2.0 * k, k], "xyz".index(axis))) for k in range(6)]
    file = rsml(tmp_path / "a.rsml", points)
    lying = build(RsmlSpecimen(file=file, place="auto"))
    assert f"set --vertical-axis {axis}" in lying.notes[1]
    upright = build(RsmlSpecimen(file=file, place="auto", vertical_axis=axis))
    assert len(upright.notes) == 1
    assert upright.roots[0].points_mm[0, 2] - upright.roots[0].points_mm[-1, 2] == pytest.approx(50.0)


UNITS = {
    "96 dpi never applied": ("cm", 37.95, 11.0, 0.15, "set --specimen-unit 'cm'"),
    "dpi as dots per mm": (
        "mm",
        300,
        1000.0,
        10.0,
        r"set --specimen-unit 'mm' \(1010 mm.* or --specimen-unit '0.08467 mm' \(86 mm, 0.85 mm thick\)",
    ),
    "um instead of mm": ("um", 1, 90.0, 1.0, "set --specimen-unit 'mm'"),
    "diameters in cm": ("inch", 300, 1000.0, 0.1, 'such as "diameter \\[cm\\]"'),
}


@pytest.mark.parametrize(("unit", "resolution", "long", "thick", "cure"), UNITS.values(), ids=UNITS)
def test_an_implausible_unit_is_named(tmp_path: Path, unit: str, resolution: float, long: float, thick: float, cure: str) -> None:
    file = Path(rsml(tmp_path / "a.rsml", [(0, 0, 0), (0, 0, -long)], unit=unit, diameter=thick))
    file.write_text(file.read_text().replace("<resolution>1<", f"<resolution>{resolution}<"))
    assert re.search(cure, build(RsmlSpecimen(file=str(file), place="auto")).notes[1])


def test_flip_scale_and_shift_in_this_order(tmp_path: Path) -> None:
    file = rsml(tmp_path / "a.rsml", [(0, 2, 20), (0, 4, 60)])
    (root,) = build(RsmlSpecimen(file=file, flip=True, scale=0.5, shift_mm=(1.0, 0.0, -30.0))).roots
    assert root.points_mm == pytest.approx(np.array([[1.0, -1.0, -40.0], [1.0, -2.0, -60.0]]))
    assert root.diameters_mm == pytest.approx(0.5)


@pytest.mark.parametrize("size", [300.0, 20.0], ids=["too large", "in the wrong place"])
def test_what_a_refusal_advises_is_accepted(tmp_path: Path, size: float) -> None:
    file = rsml(tmp_path / "a.rsml", [(0, 0, 0), (size, 0, -size), (0, 0, -2 * size)])
    with pytest.raises(UserError) as refused:
        build(RsmlSpecimen(file=file))
    text = str(refused.value)
    scale = float((re.search(r"--scale (\S+)", text) or ["", "1"])[1])
    shift = re.search(r"--shift-mm=(\S+?),(\S+?),(\S+?)[ ;]", text)
    assert shift is not None
    assert (scale < 1.0) == (size == 300.0)
    for told in ({"place": "auto"}, {"shift_mm": tuple(map(float, shift.groups()))}):
        placed = build(RsmlSpecimen(file=file, scale=scale, **told))
        assert placed.extents_max_mm[2] == pytest.approx(GRID_MM, abs=0.1)


def shoot_of(**changes: object) -> ShootSolid:
    solid = build_shoot(Scene(shoot=replace(Shoot(), **changes)))
    assert solid is not None
    return solid


def test_it_is_closed_stands_on_the_pot_and_has_its_seeds_leaves() -> None:
    assert build_shoot(Scene()) is None
    solid = shoot_of(seed=3)
    np.testing.assert_array_equal(shoot_of(seed=3).vertices, solid.vertices)
    assert shoot_of(seed=4).leaf_area_mm2 != solid.leaf_area_mm2
    mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(solid.volume_mm3, rel=1e-9)
    assert solid.vertices[:, 2].min() == pytest.approx(Scene().net_pot.top_mm + shoots.GAP_MM, abs=0.01)
    assert solid.height_mm == pytest.approx(solid.vertices[:, 2].max() - Scene().net_pot.top_mm)


def test_a_flat_blade_has_its_outline_s_area_times_its_thickness() -> None:
    flat = {"leaves": 1, "size_sd": 0.0, "elevation_sd_deg": 0.0, "droop_deg": 0.0, "fold_deg": 0.0}
    thin, thick = shoot_of(**flat, thickness_mm=0.2), shoot_of(**flat, thickness_mm=0.4)
    along = (np.arange(100_000) + 0.5) / 100_000
    width = np.maximum(np.sqrt(1.0 - (2.0 * along**0.85 - 1.0) ** 2), shoots.TIP_SHARE)
    assert thin.leaf_area_mm2 == pytest.approx(40.0 * 24.0 * width.mean(), rel=0.01)
    # petiole and stem are the same in both, but for what of them lies in the blade
    assert thick.volume_mm3 - thin.volume_mm3 == pytest.approx(0.2 * thin.leaf_area_mm2, rel=0.02)


def test_leaves_in_the_pot_are_refused() -> None:
    with pytest.raises(UserError, match=r"below the top of the net pot .* Increase shoot\.elevation_deg"):
        shoot_of(elevation_deg=-40.0)


def test_roots_respond_to_the_ion_that_limits_them() -> None:
    """1 mmol/l of K and NO3 limit growth to 1 / (1 + 0.25) = 0.8 and 1 / (1 + 1) = 0.5, of which the smaller applies."""
    taproot = RootOrder(diameter_mm=1.0, length_sd=0.0, diameter_sd=0.0, elongation_mm_per_day=4.0, max_length_mm=60.0)
    salt = Solution(grams_per_l={"KNO3": 0.101102})

    def build(solution: Solution, **half: float) -> SpecimenSolid:
        plant = GrownSpecimen(volume_ml=0.03, age_days=10.0, orders=(taproot,), half_growth_mmol_per_l=half)
        return build_specimen(Scene(specimen=plant, solution=solution))

    free, limited = build(Solution()), build(salt, K=0.25, NO3=1.0)
    assert length_mm(free.roots) == pytest.approx(60.0 * (1.0 - np.exp(-40.0 / 60.0)), rel=1e-3)
    assert length_mm(limited.roots) == pytest.approx(0.5 * length_mm(free.roots), rel=1e-3)
    assert limited.volume_mm3 == pytest.approx(0.5 * free.volume_mm3, rel=0.01), "same diameters at half of the length"
    for solution, half, match in (
        (Solution(), "K", "requires the concentrations"),
        (salt, "K+", "K\\+ is not an ion"),
        (salt, "Ca", "too little of Ca"),
    ):
        with pytest.raises(UserError, match=match):
            build(solution, **{half: 0.1})
