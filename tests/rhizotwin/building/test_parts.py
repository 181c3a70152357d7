"""The printed parts are closed, can be printed, fit what they hold, and do not run into each other."""

import io
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from manifold3d import Error, Manifold

from rhizotwin.building import lamp, lightbox, mounts, table, tank
from rhizotwin.building.measures import Measures
from rhizotwin.building.part import Part, check_bed, surface
from rhizotwin.building.pot import net_pot, net_pot_grid, strip_seat_radius_mm
from rhizotwin.building.rig_parts import bought_of, collisions, parts_of, thesis_rig
from rhizotwin.building.shapes import circle, gear, raised, rectangle
from rhizotwin.building.write import stl_bytes, write_parts
from rhizotwin.rig.printing.print_strip import FlatStrip
from rhizotwin.rig.rig_file import ArmPart, Clearance, RigFile
from rhizotwin.scenes.board import CharucoBoard
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Canister, MarkerStrip, NetPot, Scene, Tank
from rhizotwin.sim.lights import rig_from_front

OVERHANG_DEG = 50.0
"""Surfaces that lean further out over nothing than this, from upright, need support: printers manage 45 to 60."""
ON_BED_MM = 1e-3

MEASURES = Measures()
SMALL = Scene(
    name="small",
    canister=Canister(outer_radius_mm=45.0, wall_mm=2.0, height_mm=120.0, base_mm=4.0),
    net_pot=NetPot(outer_radius_mm=48.0, grid_z_mm=-10.0),
    strip=MarkerStrip(columns=18),
)
RIG = thesis_rig()
TANK = replace(Scene(), name="tank", tank=Tank(turn_deg=2.0))


def low(scene: Scene) -> RigFile:
    """Return the rig on a floor that is low enough for the scene's table."""
    more = 0.0 if scene.tank is None else tank.drop_mm(scene.tank)
    return replace(RIG, clearance=Clearance(floor_z_mm=-(scene.canister.height_mm + 42.6 + more)))


@cache
def made(scene: Scene, measures: Measures = MEASURES) -> list[Part]:
    return parts_of(scene, rig=low(scene), measures=measures, board=CharucoBoard())


@pytest.fixture(params=[Scene(), SMALL, TANK], ids=lambda scene: scene.name)
def scene(request: pytest.FixtureRequest) -> Scene:
    return request.param


def check_closed(part: Part) -> None:
    assert part.solid.status() is Error.NoError
    assert part.solid.volume() > 0.0
    assert len(part.solid.decompose()) == 1
    _, faces = surface(part.solid)
    begin, end = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64).T
    there, back = np.sort(begin * (faces.max() + 1) + end), np.sort(end * (faces.max() + 1) + begin)
    assert (np.diff(there) > 0).all()
    assert np.array_equal(there, back)  # every edge has one face on each side, turned alike
    stored = trimesh.load(io.BytesIO(stl_bytes(part.printed)), file_type="stl")  # as a slicer reads it, corners merged
    assert stored.is_watertight, part.name
    assert stored.area_faces.min() > 1e-9, part.name


def test_the_grid_is_open_in_the_middle() -> None:
    middle = raised(circle(MEASURES.mesh_middle_mm / 2.0 - 0.01), -200.0, 100.0)
    assert (net_pot_grid(Scene(), MEASURES).solid ^ middle).is_empty()
    closed = net_pot_grid(Scene(), replace(MEASURES, mesh_middle_mm=0.0))
    assert not (closed.solid ^ middle).is_empty()
    with pytest.raises(UserError, match="mesh_middle_mm"):
        net_pot_grid(SMALL, replace(MEASURES, mesh_middle_mm=90.0))


def overhang_mm2(part: Part) -> float:
    """Return the area off the bed that leans out further than `OVERHANG_DEG` as the part is printed."""
    vertices, faces = surface(part.printed)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.cross(b - a, c - a) / 2.0
    size = np.linalg.norm(area, axis=1)
    down = -area[:, 2] / np.maximum(size, 1e-12)
    lifted = np.max([a[:, 2], b[:, 2], c[:, 2]], axis=0) > ON_BED_MM
    return float(size[(down > np.sin(np.deg2rad(OVERHANG_DEG)) + 1e-6) & lifted].sum())


def test_parts_can_be_printed_and_say_where_they_need_support(scene: Scene) -> None:
    for part in made(scene):
        check_closed(part)
        check_bed(part, (220.0, 220.0, 250.0))
    assert [part.name for part in made(scene) if overhang_mm2(part) > 0.0] == [part.name for part in made(scene) if part.support]


def test_an_overhang_is_seen() -> None:
    table_top = raised(rectangle((-20.0, -20.0), (20.0, 20.0)), 10.0, 12.0) + raised(rectangle((-2.0, -2.0), (2.0, 2.0)), 0.0, 11.0)
    assert overhang_mm2(Part(name="t", about="", solid=table_top)) == pytest.approx(40.0**2 - 4.0**2)


def test_nothing_runs_into_anything(scene: Scene) -> None:
    assert collisions(made(scene), bought_of(scene, rig=low(scene), measures=MEASURES)) == []


def test_a_collision_is_seen() -> None:
    wide = replace(Scene(), canister=Canister(outer_radius_mm=76.8))
    bought = bought_of(wide, rig=RIG, measures=MEASURES)
    assert ("net_pot", "canister") in [pair[:2] for pair in collisions(made(Scene()), bought)]


def test_pot_keeps_its_gap_to_the_canister(scene: Scene) -> None:
    pot, ring = made(scene)[0].placed()[0], made(scene)[2].placed()[0]
    cup = bought_of(scene, rig=RIG, measures=MEASURES)[0].solid
    lifted = pot.translate((0.0, 0.0, 1.0))  # it stands on the rim: what is left is the gap round it
    # the polygons of 240 sides that stand for circles come nearer to each other by r (1 - cos(pi / 240))
    facet = scene.canister.outer_radius_mm * (1.0 - np.cos(np.pi / 240.0))
    assert lifted.min_gap(cup, 5.0) == pytest.approx(MEASURES.fit_mm, abs=2.0 * facet)
    assert ring.min_gap(cup, 5.0) == pytest.approx(MEASURES.fit_mm, abs=2.0 * facet)


def test_strip_goes_round_the_seat_once(scene: Scene) -> None:
    vertices, _ = surface(made(scene)[0].solid)
    low = vertices[np.isclose(vertices[:, 2], scene.net_pot.skirt_bottom_mm)]
    outer = low[np.hypot(low[:, 0], low[:, 1]) > scene.canister.outer_radius_mm + 1.0]
    outer = outer[np.argsort(np.arctan2(outer[:, 1], outer[:, 0]))]
    seat = float(np.linalg.norm(outer - np.roll(outer, 1, axis=0), axis=1).sum())
    flat = FlatStrip(strip=scene.strip, net_pot=scene.net_pot, paper_mm=MEASURES.paper_mm)
    # half the paper's thickness lies between the seat and the middle of the paper, which keeps its length
    assert seat + np.pi * MEASURES.paper_mm == pytest.approx(flat.length_mm, abs=1e-3)
    assert strip_seat_radius_mm(scene, MEASURES) + MEASURES.paper_mm == scene.net_pot.outer_radius_mm


def test_gears_mesh_with_their_play() -> None:
    teeth = 180
    ring = gear(teeth, table.MODULE_MM, backlash_mm=table.BACKLASH_MM)
    wheel = gear(table.PINION_TEETH, table.MODULE_MM, backlash_mm=table.BACKLASH_MM)
    centres = table.MODULE_MM * (teeth + table.PINION_TEETH) / 2.0
    pitch_deg = 360.0 / table.PINION_TEETH

    def shared(turn: float, play_deg: float) -> float:
        """Return the area that both cover when the pinion has turned by a share of its pitch, and then by some play."""
        pinion = wheel.rotate(180.0 + pitch_deg * (0.5 + turn) + play_deg).translate((centres, 0.0))
        return (ring.rotate(-turn * 360.0 / teeth) ^ pinion).area()

    play_deg = float(np.rad2deg(table.BACKLASH_MM / (table.PINION_TEETH / 2.0)))
    turns = np.linspace(0.0, 1.0, 9).tolist()
    assert max(shared(turn, 0.0) for turn in turns) < 1e-4
    assert max(shared(turn, 0.8 * play_deg) for turn in turns) < 2e-3  # both teeth are thinner by the backlash
    assert min(shared(turn, 1.6 * play_deg) for turn in turns) > 1e-2


@pytest.mark.parametrize("outer_radius_mm", [40.0, 110.0])
def test_screws_of_the_feet_are_in_the_base_beside_its_groove(outer_radius_mm: float) -> None:
    scene = replace(Scene(), canister=replace(Scene().canister, outer_radius_mm=outer_radius_mm))
    base, drive = table.table_base(scene, MEASURES).solid, table.drive_of(scene, MEASURES)
    radius = table.COUNTERSINK_M4_MM / 2.0
    discs = [raised(circle(radius + 1.0, xy) - circle(radius + 0.05, xy), -2.0, 0.0) for xy in table.foot_places_mm(drive)]
    assert [(disc ^ base).volume() for disc in discs] == pytest.approx([disc.volume() for disc in discs], rel=1e-3)


def test_heads_of_the_motors_screws_are_below_the_plate(scene: Scene) -> None:
    below = tank.below(scene)
    drive, half = table.drive_of(below, MEASURES), MEASURES.motor_holes_mm / 2.0
    plate, base = (part.placed()[0] for part in made(scene) if part.name in {"table_plate", "table_base"})
    screw = Manifold.cylinder(8.0, 1.5) + Manifold.cylinder(3.0, 2.84).translate((0.0, 0.0, 8.0))  # M3 x 8, ISO 4762
    thread = 3.0  # in the motor, whose holes are at least 4.5 mm deep
    low_mm = table.base_top_mm(below) - table.BASE_MM - thread
    screws = [screw.translate((x, y - drive.centres_mm, low_mm)) for x in (-half, half) for y in (-half, half)]
    assert max((placed ^ base).volume() for placed in screws) < 1e-6
    assert all((placed ^ plate).is_empty() for placed in screws)


def test_the_lamp_faces_the_rim_and_is_held_by_its_posts() -> None:
    scene = replace(Scene(), lights=replace(Scene().lights, front_xz_mm=(300.0, 150.0)))
    pose, lit = lamp.rig_from_lamp(scene), rig_from_front(scene.lights)
    np.testing.assert_allclose(pose[:3, [0, 3]], lit[:3, [2, 3]], atol=1e-9)  # normal and centre
    diffuser = next(solid for name, solid in lamp.sheets(scene, MEASURES) if name == "lamp diffuser")
    assert diffuser.volume() == pytest.approx(4.0 * MEASURES.diffuser_mm * np.linalg.norm(lit[:3, 0]) * np.linalg.norm(lit[:3, 1]))
    bars = [one.solid for one in bought_of(scene, rig=low(scene), measures=MEASURES) if one.name == "bar"]
    for holder, (x, y, z) in zip(lamp.lamp_holder(scene, MEASURES).placed(), lamp.post_places_mm(scene, MEASURES), strict=True):
        screw = Manifold.cylinder(40.0, 2.5, 2.5, center=True).rotate((90.0, 0.0, 0.0)).translate((x, y - np.sign(y) * 10.0, z))
        assert (screw ^ holder).is_empty()
        assert min(screw.min_gap(bar, 50.0) for bar in bars) == 0.0
        assert min(holder.min_gap(bar, 50.0) for bar in bars) == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(UserError, match="front lamp"):
        lamp.lamp_holder(replace(Scene(), lights=replace(Scene().lights, front_wh_mm=(300.0, 20.0))), MEASURES)


def test_what_cannot_be_printed_is_refused() -> None:
    with pytest.raises(UserError, match=r"would be 0.40 mm thick"):
        net_pot(replace(Scene(), net_pot=NetPot(outer_radius_mm=77.0)), MEASURES)
    with pytest.raises(UserError, match="cannot be printed"):
        net_pot(replace(Scene(), net_pot=NetPot(grid_z_mm=-1.0)), MEASURES)
    with pytest.raises(UserError, match=r"clearance.floor_z_mm -165 leaves"):
        table.table_foot(Scene(), MEASURES, -165.0)
    small = replace(Scene(), lights=replace(Scene().lights, backlight_wh_mm=(99.0, 100.0)))
    with pytest.raises(UserError, match=r"at least 100 x 100 mm"):
        lightbox.lightbox_walls(small, MEASURES)
    with pytest.raises(UserError, match="does not fit the printer's build volume of 150 x 150"):
        check_bed(made(Scene())[0], (150.0, 150.0, 200.0))


@pytest.mark.parametrize(("key", "most", "too_large"), [("ball_mm", 11.2, 11.5), ("magnet_mm", (13.4, 6.8), (10.0, 8.0))])
def test_balls_and_magnets_too_large_for_the_parts_are_refused(key: str, most: object, too_large: object) -> None:
    with pytest.raises(UserError, match=key):
        made(TANK, replace(MEASURES, **{key: too_large}))
    for part in made(TANK, replace(MEASURES, **{key: most})):
        check_closed(part)


@pytest.mark.parametrize(("key", "value"), [("shaft_mm", 16.0), ("horn_holes_mm", (2.0, 100.0))])
def test_parts_that_would_fall_apart_are_refused(tmp_path: Path, key: str, value: object) -> None:
    measures = replace(MEASURES, **{key: value})
    with pytest.raises(UserError, match=r"would consist of [0-9]+ pieces"):
        write_parts(Scene(), tmp_path / "out", rig=RIG, measures=measures, bed_mm=(220.0, 220.0, 250.0))
    assert not (tmp_path / "out").exists()


def pot_with_top(top_mm: float) -> object:
    """Make a net pot with a clearance for which rounding to the nearest number would be too small."""
    return net_pot(replace(Scene(), net_pot=replace(Scene().net_pot, top_mm=top_mm)), replace(MEASURES, fit_mm=0.2871))


def bracket(last_mm: float) -> object:
    return mounts.camera_bracket(Scene(), ArmPart(links_mm=(61.0, 101.6, 96.4, last_mm)), replace(MEASURES, roll_face_mm=55.04))


def level(level_mm: float) -> object:
    wet = replace(TANK, strip=replace(TANK.strip, bottom_mm=-3.14), tank=replace(TANK.tank, level_mm=level_mm))
    return tank.parts(wet, MEASURES, -300.0)


ADVICE = {
    "top": ("top_mm(?: to)? at least", pot_with_top, 0.5),
    "bracket": ("set it to at least", bracket, 60.0),
    "level": ("reduce tank.level_mm to", level, -4.0),
}


@pytest.mark.parametrize(("words", "make", "bad"), ADVICE.values(), ids=ADVICE.keys())
def test_a_number_that_a_message_advises_is_accepted(words: str, make: Callable[[float], object], bad: float) -> None:
    with pytest.raises(UserError, match=words) as refused:
        make(bad)
    advised = re.search(words + r" (-?[0-9.]*[0-9])", str(refused.value))
    assert advised is not None
    make(float(advised[1]))


def test_magnets_face_each_other_through_the_floor_of_a_tank() -> None:
    parts = {part.name: part for part in made(TANK)}
    assert {"tank_carrier", "tank_pivot", "tank_post"} <= parts.keys()
    assert not {"tank_carrier", "tank_pivot", "tank_post"} & {part.name for part in made(Scene())}
    glass = tank.solid(TANK, TANK.tank)
    above, below = parts["tank_carrier"].placed()[0], parts["table_plate"].placed()[0]
    floor_mm = tank.floor_mm(TANK, TANK.tank)
    assert above.bounding_box()[2] == pytest.approx(floor_mm + TANK.tank.wall_mm)  # the carrier glides on the tank's floor
    assert below.bounding_box()[5] == pytest.approx(floor_mm - tank.PLAY_MM)
    assert below.min_gap(glass, 5.0) == pytest.approx(tank.PLAY_MM, abs=1e-6)
    for x, y in tank.magnet_places_mm(TANK):  # both pockets open towards the tank's floor, one over the other
        bore = Manifold.cylinder(100.0, 4.0, 4.0).translate((x, y, floor_mm - 50.0))
        wide, high = MEASURES.magnet_mm
        probe = Manifold.cylinder(high, wide / 2.0, wide / 2.0)
        assert (probe.translate((x, y, floor_mm - tank.PLAY_MM - high)) ^ below).volume() < 1e-6
        assert (probe.translate((x, y, floor_mm + TANK.tank.wall_mm + tank.GLIDE_MM)) ^ above).volume() < 1e-6
        assert (bore ^ below).volume() > 1.0  # the pockets have a floor
    wet = replace(TANK, tank=replace(TANK.tank, level_mm=-6.5))
    with pytest.raises(UserError, match=r"is only 3.5 mm above the water of the tank \(tank.level_mm\), which rises by 3.9 mm"):
        tank.parts(wet, MEASURES, -300.0)
    with pytest.raises(UserError, match=r"for the posts of the tank"):
        tank.parts(TANK, MEASURES, -160.0)
