"""Sessions: undo and redo, saved corrections, and logs that are wrong."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rhizotwin.corrections import log
from rhizotwin.corrections.session import Session
from rhizotwin.scenes.errors import UserError
from tests.rhizotwin.plant import Plant


def test_undo_and_redo_go_all_the_way(plant: Plant):
    session = Session(plant.result)
    volumes = [session.measure().volume_mm3]
    lowest = np.argsort(session.solid.centre_mm[:, 2])[:5]
    edits = [*(log.edit("delete roots", roots=[root]) for root in (1, 2)), log.edit("delete voxels", runs=log.runs(sorted(lowest)))]
    for edit in edits:
        session.do(edit)
        volumes.append(session.measure().volume_mm3)
    assert volumes == sorted(volumes, reverse=True)
    assert len(set(volumes)) == len(volumes)
    for volume in reversed(volumes[:-1]):
        session.undo()
        assert session.measure().volume_mm3 == volume
    assert not session.can_undo
    for volume in volumes[1:]:
        session.redo()
        assert session.measure().volume_mm3 == volume
    assert session.redo() is session.state
    assert log.runs(range(10, 200)) == ((10, 190),)


def test_saved_corrections_are_there_when_opened_again(own: Path):
    session = Session(own)
    session.do(log.edit("delete roots", roots=[1], who="ann"))
    session.save()
    again = Session(own)
    assert (len(again.log.edits), again.unsaved) == (1, 0)
    assert again.measure().volume_mm3 == pytest.approx(session.measure().volume_mm3, rel=1e-9)
    again.do(log.edit("delete roots", roots=[2], who="ben"))
    again.save()
    assert [one.who for one in log.read(own / log.LOG_NAME, own).edits] == ["ann", "ben"]
    session.undo()
    with pytest.raises(UserError, match="changed by another session"):
        session.save()
    assert len(log.read(own / log.LOG_NAME, own).edits) == 2


def test_tubes_that_were_undone_leave_nothing_behind(own: Path):
    """Rows of voxels in the log must be those of a session without the undone tube."""
    session = Session(own)
    count, before = len(session.solid.size), session.measure().volume_mm3
    session.do(log.edit("join", roots=[1, 2]))
    joined = session.measure().volume_mm3
    session.undo()
    assert session.measure().volume_mm3 == before
    assert len(session.measure().volumes_mm3) == count
    session.redo()
    assert session.measure().volume_mm3 == joined
    session.undo()
    session.do(log.edit("join", roots=[3, 2]))
    bridge = np.flatnonzero(session.measure().volumes_mm3[count:] > 1e-9) + count
    session.do(log.edit("delete voxels", runs=log.runs(bridge[::2].tolist())))
    session.save()
    again = Session(own)
    assert again.measure().volumes_mm3 == pytest.approx(session.measure().volumes_mm3, abs=1e-9)
    assert again.measure().length_mm == pytest.approx(session.measure().length_mm)


def test_saved_corrections_that_cannot_be_applied_are_kept(own: Path):
    path = own / log.LOG_NAME
    log.write(path, replace(log.new(own), edits=(log.edit("delete roots", roots=[99]),)))
    before = path.read_bytes()
    with pytest.raises(UserError, match=r"root 99 does not exist\); move .*edits.json to open"):
        Session(own)
    assert path.read_bytes() == before


def changed(**changes: object) -> dict[str, object]:
    return {"edits": [{"do": "cut", "who": "a", "when": "b"} | changes]}


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"shape_sha256": "0" * 64}, "corrections of a different result"),
        (changed(do="explode"), "'explode'"),
        (changed(file="/etc/passwd"), "unknown key 'file'"),
        (changed(point_mm=[0, 0, float("nan")]), "not a valid point"),
    ],
)
def test_logs_that_are_wrong_are_refused(plant: Plant, tmp_path: Path, change: dict, reason: str):
    path = tmp_path / log.LOG_NAME
    log.write(path, log.new(plant.result))
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(UserError, match=reason):
        log.read(path, plant.result)
