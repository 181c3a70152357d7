"""Logs of corrections: invalid ones are rejected."""

import json
from pathlib import Path

import pytest

from rhizotwin.corrections import log
from rhizotwin.scenes.errors import UserError
from tests.rhizotwin.plant import Plant


def edit(**changes: object) -> dict[str, object]:
    return {"edits": [{"do": "cut", "who": "a", "when": "b"} | changes]}


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"shape_sha256": "0" * 64}, "corrections of a different result"),
        (edit(do="explode"), "'explode'"),
        (edit(file="/etc/passwd"), "unknown key 'file'"),
        (edit(do="delete roots", roots=["x"]), "'x'"),
        (edit(point_mm=[0, 0, float("nan")]), "not a valid point"),
        (edit(do="delete box", box_mm=[]), "could not be read as a log"),
        ({"schema_version": 99}, "schema_version"),
    ],
)
def test_logs_that_are_wrong_are_refused(plant: Plant, tmp_path: Path, change: dict, reason: str):
    path = tmp_path / log.LOG_NAME
    log.write(path, log.new(plant.result))
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(UserError, match=reason):
        log.read(path, plant.result)
