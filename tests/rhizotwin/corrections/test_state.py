"""What each kind of correction makes of roots, voxels and their volume."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.corrections import log
from rhizotwin.corrections.session import Session
from rhizotwin.scenes.errors import UserError
from tests.rhizotwin import plant as plants
from tests.rhizotwin.plant import Plant


@pytest.fixture
def session(plant: Plant) -> Session:
    return Session(plant.result)


def painted_mm3(*roots) -> float:
    leaves = plants.painted(tuple(replace(root, parent=-1) for root in roots))
    return float(leaves.occupancy.sum(dtype=np.float64)) * leaves.voxel_mm**3


def test_what_is_left_is_as_large_as_painted_afresh(session: Session, plant: Plant):
    """Painting a plant evens what sampling puts too much into full voxels out among the others, laterals by some 2 % of their own."""
    session.do(log.edit("delete roots", roots=[2, 3]))
    left = painted_mm3(*plant.roots[:2])
    assert session.measure().volume_mm3 == pytest.approx(left, rel=2.5e-3)


def test_a_shared_volume_stays_with_the_root_that_is_left(session: Session, plant: Plant):
    """The laterals begin inside the main root, whose volume it is: without the main root it is theirs."""
    session.do(log.edit("delete roots", roots=[0]))
    assert session.measure().volume_mm3 == pytest.approx(painted_mm3(*plant.roots[1:]), rel=3e-2)
    assert {line.parent for line in session.state.lines.values()} == {-1}


def test_a_cut_keeps_volume_and_length_and_moves_laterals(session: Session, plant: Plant):
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


def test_a_cut_root_is_whole_again_when_joined(session: Session, plant: Plant):
    before = session.measure()
    session.do(log.edit("cut", roots=[1], point_mm=tuple(plant.roots[1].points_mm[20])))
    session.do(log.edit("join", roots=[1, 4]))
    assert session.measure().volume_mm3 == pytest.approx(before.volume_mm3, rel=1e-9)
    assert session.measure().length_mm == pytest.approx(before.length_mm, rel=1e-9)
    assert session.state.lines[1].tip_seen


def test_joining_across_a_gap_adds_a_tube(session: Session, plant: Plant):
    before = session.measure()
    near_end = np.linalg.norm(plant.roots[2].points_mm[[0, -1]] - plant.roots[1].points_mm[-1], axis=1).min()
    session.do(log.edit("join", roots=[1, 2]))
    after = session.measure()
    assert after.length_mm - before.length_mm == pytest.approx(near_end, rel=1e-6)
    a, b = 0.3 / 2.0, 0.4 / 2.0
    bridge = np.pi / 3.0 * near_end * (a * a + a * b + b * b)
    assert after.volume_mm3 - before.volume_mm3 == pytest.approx(bridge, rel=0.1)  # less what lies inside the main root


def test_a_tip_is_set_and_what_lies_beyond_goes(session: Session, plant: Plant):
    way = session.state.lines[3].way_mm
    session.do(log.edit("tip", roots=[3], point_mm=tuple(plant.roots[3].points_mm[20])))
    assert session.state.lines[3].length_mm == pytest.approx(way[20])
    assert session.state.lines[3].tip_seen
    assert len(session.state.lines) == 4


def test_parent_and_base_change_the_tree_and_not_the_volume(session: Session, plant: Plant):
    before = session.measure().volume_mm3
    session.do(log.edit("parent", roots=[2, 1]))
    assert [root.order for root in session.state.roots()] == [0, 1, 2, 1]
    with pytest.raises(UserError, match="which is its descendant"):
        session.do(log.edit("parent", roots=[1, 2]))
    session.do(log.edit("base", roots=[0], point_mm=tuple(plant.roots[0].points_mm[-1])))
    assert session.state.lines[0].points_mm[0] == pytest.approx(plant.roots[0].points_mm[-1])
    assert session.measure().volume_mm3 == pytest.approx(before, rel=1e-9)


def test_a_box_takes_voxels_and_what_of_the_roots_lies_in_it(session: Session):
    box = ((-20.0, -20.0, -40.0), (20.0, 20.0, -30.0))
    centre = session.solid.centre_mm
    inside = ((centre >= box[0]) & (centre <= box[1])).all(axis=1)
    expected = session.measure().volumes_mm3[~inside].sum()
    session.do(log.edit("delete box", box_mm=box))
    assert session.measure().volumes_mm3[inside].sum() == 0.0
    assert session.measure().volume_mm3 == pytest.approx(expected, rel=0.06)  # tubes end at their nodes, voxels at their faces
    points = np.concatenate([line.points_mm for line in session.state.lines.values()])
    assert not ((points >= box[0]) & (points <= box[1])).all(axis=1).any()


IMPOSSIBLE = [
    log.edit("delete roots", roots=[99]),
    log.edit("cut", roots=[1], point_mm=tuple(plants.roots()[1].points_mm[-1])),
    log.edit("join", roots=[1]),
    log.edit("delete voxels", runs=((10_000_000, 2),)),
    log.edit("delete voxels", runs=((0, 10**13),)),
    log.edit("delete voxels", runs=((10**30, 1),)),
    log.edit("restore roots", roots=[1]),
]


def test_what_cannot_be_is_refused_and_changes_nothing(session: Session):
    for edit in IMPOSSIBLE:
        with pytest.raises(UserError):
            session.do(edit)
    assert not session.can_undo


def tree(session: Session) -> dict[int, tuple[int, float, bool]]:
    """Return parent, length and visibility of the tip of each root."""
    return {k: (line.parent, line.length_mm, line.tip_seen) for k, line in session.state.lines.items()}


DELETIONS = {
    "root and lateral": log.edit("delete roots", roots=[0, 3]),
    "tip": log.edit("tip", roots=[0], point_mm=(1.0, 0.5, -40.0)),
    "middle": log.edit("delete box", box_mm=((-20.0, -20.0, -40.0), (20.0, 20.0, -30.0))),
}


@pytest.mark.parametrize("deletion", DELETIONS.values(), ids=DELETIONS.keys())
def test_a_restored_deletion_leaves_no_trace(own: Path, deletion: log.Edit):
    session = Session(own)
    before, measured = tree(session), session.measure()
    session.do(deletion)
    assert session.measure().length_mm < measured.length_mm - 10.0
    session.do(log.edit("restore deletion"))
    assert tree(session) == before
    assert session.measure().volumes_mm3[: len(measured.volumes_mm3)] == pytest.approx(measured.volumes_mm3, abs=1e-6)
    assert session.measure().volume_mm3 == pytest.approx(measured.volume_mm3, rel=1e-6)
    assert not session.state.removed
    assert not session.state.deletions
    session.save()
    assert tree(Session(own)) == before
    with pytest.raises(UserError, match="no deleted roots"):
        session.do(log.edit("restore deletion"))


def test_corrections_after_a_deletion_outlive_its_restoration(session: Session):
    session.do(log.edit("delete roots", roots=[0]))
    session.do(log.edit("parent", roots=[3, 2]))
    session.do(log.edit("delete roots", roots=[1]))
    session.do(log.edit("restore deletion"))
    session.do(log.edit("restore deletion"))
    assert {k: line.parent for k, line in session.state.lines.items()} == {0: -1, 1: 0, 2: 0, 3: 2}
    session.do(log.edit("tip", roots=[0], point_mm=(1.0, 0.5, -40.0)))
    session.do(log.edit("cut", roots=[0], point_mm=(0.5, 0.2, -25.0)))
    shortened, length = session.state.lines[0].length_mm, session.measure().length_mm
    session.do(log.edit("restore deletion"))
    assert session.state.lines[0].length_mm == shortened
    assert session.state.lines[4].parent == 0  # what was cut off at the tip is a root of its own
    assert session.measure().length_mm > length + 10.0


def test_restored_roots_have_their_laterals_again(session: Session):
    """Logs of version 0.2 contain this correction in place of "restore deletion"."""
    before = tree(session)
    session.do(log.edit("delete roots", roots=[0]))
    session.do(log.edit("restore roots", roots=[0]))
    assert tree(session) == before
    assert not session.state.deletions
