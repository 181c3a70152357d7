"""What each kind of correction makes of roots and voxels."""

import numpy as np
import pytest

from rhizotwin.corrections import log
from rhizotwin.corrections.session import Session
from rhizotwin.scenes.errors import UserError
from tests.rhizotwin.plant import Plant


def test_a_cut_keeps_volume_and_length_and_moves_laterals(plant: Plant):
    session = Session(plant.result)
    before = session.measure()
    session.do(log.edit("cut", roots=[0], point_mm=tuple(plant.roots[0].points_mm[23])))
    after = session.measure()
    assert after.volume_mm3 == pytest.approx(before.volume_mm3, rel=1e-9)
    assert after.length_mm == pytest.approx(before.length_mm, rel=1e-9)
    found = session.state.lines
    assert (found[1].parent, found[2].parent, found[3].parent, found[4].parent) == (0, 0, 4, 0)
    assert not found[0].tip_seen
    session.do(log.edit("delete roots", roots=[4], laterals=True))
    assert set(session.state.lines) == {0, 1, 2}


def test_a_cut_root_is_whole_again_when_joined(plant: Plant):
    session = Session(plant.result)
    before = session.measure()
    session.do(log.edit("cut", roots=[1], point_mm=tuple(plant.roots[1].points_mm[20])))
    session.do(log.edit("join", roots=[1, 4]))
    assert session.measure().volume_mm3 == pytest.approx(before.volume_mm3, rel=1e-9)
    assert session.measure().length_mm == pytest.approx(before.length_mm, rel=1e-9)
    assert session.state.lines[1].tip_seen


def test_joining_across_a_gap_adds_a_tube(plant: Plant):
    session = Session(plant.result)
    before = session.measure()
    gap = np.linalg.norm(plant.roots[2].points_mm[0] - plant.roots[1].points_mm[-1])
    near_end = min(gap, float(np.linalg.norm(plant.roots[2].points_mm[-1] - plant.roots[1].points_mm[-1])))
    session.do(log.edit("join", roots=[1, 2]))
    after = session.measure()
    assert after.length_mm - before.length_mm == pytest.approx(near_end, rel=1e-6)
    a, b = 0.3 / 2.0, 0.4 / 2.0
    bridge = np.pi / 3.0 * near_end * (a * a + a * b + b * b)
    assert after.volume_mm3 - before.volume_mm3 == pytest.approx(bridge, rel=0.1)  # less what lies inside the main root


def test_a_tip_is_set_and_what_lies_beyond_goes(plant: Plant):
    session = Session(plant.result)
    way = session.state.lines[3].way_mm
    session.do(log.edit("tip", roots=[3], point_mm=tuple(plant.roots[3].points_mm[20])))
    assert session.state.lines[3].length_mm == pytest.approx(way[20])
    assert session.state.lines[3].tip_seen
    assert len(session.state.lines) == 4


def test_parent_and_base_change_the_tree_and_not_the_volume(plant: Plant):
    session = Session(plant.result)
    before = session.measure().volume_mm3
    session.do(log.edit("parent", roots=[2, 1]))
    assert [root.order for root in session.state.roots()] == [0, 1, 2, 1]
    with pytest.raises(UserError, match="which is its descendant"):
        session.do(log.edit("parent", roots=[1, 2]))
    session.do(log.edit("base", roots=[0], point_mm=tuple(plant.roots[0].points_mm[-1])))
    assert session.state.lines[0].points_mm[0] == pytest.approx(plant.roots[0].points_mm[-1])
    assert session.measure().volume_mm3 == pytest.approx(before, rel=1e-9)


def test_a_box_takes_voxels_and_what_of_the_roots_lies_in_it(plant: Plant):
    session = Session(plant.result)
    box = ((-20.0, -20.0, -40.0), (20.0, 20.0, -30.0))
    centre = session.solid.centre_mm
    inside = ((centre >= box[0]) & (centre <= box[1])).all(axis=1)
    expected = session.measure().volumes_mm3[~inside].sum()
    session.do(log.edit("delete box", box_mm=box))
    assert session.measure().volumes_mm3[inside].sum() == 0.0
    assert session.measure().volume_mm3 == pytest.approx(expected, rel=0.06)  # tubes end at their nodes, voxels at their faces
    for line in session.state.lines.values():
        assert not ((line.points_mm >= box[0]) & (line.points_mm <= box[1])).all(axis=1).any()


def test_corrections_that_cannot_be_are_refused_and_change_nothing(plant: Plant):
    session = Session(plant.result)
    for edit in (
        log.edit("delete roots", roots=[99]),
        log.edit("cut", roots=[1], point_mm=tuple(plant.roots[1].points_mm[-1])),
        log.edit("join", roots=[1]),
        log.edit("join", roots=[1, 1]),
        log.edit("delete voxels", runs=((10_000_000, 2),)),
        log.edit("delete voxels", runs=((0, 10**13),)),
        log.edit("delete voxels", runs=((10**30, 1),)),
        log.edit("fit"),
        log.edit("restore roots", roots=[1]),
    ):
        with pytest.raises(UserError):
            session.do(edit)
    assert not session.can_undo
