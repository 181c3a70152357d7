"""A deletion can be restored: roots, parts of roots and voxels, with their laterals."""

from pathlib import Path

import pytest

from rhizotwin.corrections import log
from rhizotwin.corrections.session import Session
from rhizotwin.scenes.errors import UserError
from tests.rhizotwin.plant import Plant


def tree(session: Session) -> dict[int, tuple[int, float, bool]]:
    """Return parent, length and visibility of the tip of each root."""
    return {k: (line.parent, line.length_mm, line.tip_seen) for k, line in session.state.lines.items()}


@pytest.mark.parametrize(
    "deletion",
    [
        {"kind": "delete roots", "roots": [0]},
        {"kind": "delete roots", "roots": [0, 3]},
        {"kind": "tip", "roots": [0], "point_mm": (1.0, 0.5, -40.0)},
        {"kind": "delete box", "box_mm": ((-20.0, -20.0, -40.0), (20.0, 20.0, -30.0))},
        {"kind": "delete box", "box_mm": ((-20.0, -20.0, -60.5), (20.0, 20.0, -30.0))},
        {"kind": "delete box", "box_mm": ((-20.0, -20.0, -70.0), (20.0, 20.0, -20.0))},
    ],
    ids=["root", "root and lateral", "tip", "middle", "lower part", "all below the first lateral"],
)
def test_a_restored_deletion_leaves_no_trace(own: Path, deletion: dict):
    session = Session(own)
    before, measured = tree(session), session.measure()
    count = len(measured.volumes_mm3)
    session.do(log.edit(deletion["kind"], **{key: value for key, value in deletion.items() if key != "kind"}))
    assert session.measure().length_mm < measured.length_mm - 10.0
    session.do(log.edit("restore deletion"))
    assert tree(session) == before
    assert session.measure().volumes_mm3[:count] == pytest.approx(measured.volumes_mm3, abs=1e-6)
    assert session.measure().volume_mm3 == pytest.approx(measured.volume_mm3, rel=1e-6)
    assert not session.state.removed
    assert not session.state.deletions
    session.save()
    assert tree(Session(own)) == before
    with pytest.raises(UserError, match="no deleted roots"):
        session.do(log.edit("restore deletion"))


def test_corrections_after_a_deletion_are_kept_when_it_is_restored(plant: Plant):
    session = Session(plant.result)
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


def test_restored_roots_have_their_laterals_again(plant: Plant):
    """Logs of version 0.2 contain this correction in place of "restore deletion"."""
    session = Session(plant.result)
    before = tree(session)
    session.do(log.edit("delete roots", roots=[0]))
    session.do(log.edit("restore roots", roots=[0]))
    assert tree(session) == before
    assert not session.state.deletions
