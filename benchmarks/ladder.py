"""Committed results of the ladder, each with the commit of the reconstruction at which it was measured.

A run renews the results of its cases, and leaves the others, so that the ladder can be measured in parts. The pages of
the documentation, and the baseline of the gate, are made from this file.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks import commits
from benchmarks.output import stored_json
from rhizotwin.scenes import atomic

Record = dict[str, Any]

PATH = Path(__file__).with_name("ladder.json")
SCHEMA_VERSION = 1
DIGITS = 6
"""Significant digits of the stored numbers."""
_OMITTED = ("traits", "rig", "warnings", "timings_s", "plants", "shoot", "volume_terms_mm3", "volume_budget")
"""Parts of a score that neither the pages nor the gate use."""
_TAKEN = ("wall_s", "cpu_s", "peak_memory_mib", "load")


def read(path: Path = PATH) -> list[Record]:
    """Return the committed records, empty if there is no file; raise UserError if it is damaged."""
    if not path.is_file():
        return []
    with stored_json(path, SCHEMA_VERSION, "make it with `./run bench accuracy --update-baseline`") as stored:
        records = list(stored["records"])
        if not all(isinstance(record["case"]["name"], str) and record["commit"] and record["score"] for record in records):
            raise TypeError("a record is incomplete")
    return records


def update(records: Iterable[Record], *, path: Path = PATH) -> list[Record]:
    """Replace or add records in the file, sorted by the names of their cases, and return all records of the file.

    Parameters
    ----------
    records : iterable of dict
        Measured records (`benchmarks.accuracy.measure`).
    path : Path
        File of the records.

    Raises
    ------
    UserError
        If a record was measured with a modified reconstruction, or the file is damaged.
    """
    found = {record["case"]["name"]: record for record in read(path)}
    for record in records:
        commits.check(record["commit"], record["case"]["name"])
        found[record["case"]["name"]] = _shorten(record)
    kept = [found[name] for name in sorted(found)]
    text = ",\n".join(json.dumps(record, allow_nan=False, separators=(",", ":")) for record in kept)
    atomic.write_text(path, f'{{"schema_version": {SCHEMA_VERSION}, "records": [\n{text}\n]}}\n')
    return kept


def commits_of(records: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the distinct commits of records, sorted."""
    return sorted({str(record["commit"]) for record in records})


def _shorten(record: Record) -> Record:
    score = {key: value for key, value in record["score"].items() if key not in _OMITTED}
    kept = {"case": record["case"], "commit": record["commit"], "score": score, **{name: record[name] for name in _TAKEN}}
    return dict(_rounded(kept))


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
