"""Two runs compared case by case."""

import json
import math

import pytest

from benchmarks import __main__ as command
from benchmarks import run_comparison
from benchmarks.cases import ladder
from rhizotwin.scenes.errors import UserError

CASES = ladder(scenes=("radish_day05*", "radish_day10*"), profiles=("clean", "bench"), rings=(2,), methods=("coverage",))


def test_mean_interval_and_sign_test_by_hand():
    found = run_comparison.difference([5.0, 4.0, 6.0, 8.0], [3.0, 3.0, 3.0, 6.0], name="error", unit="%", smaller_is_better=True)
    assert (found.before, found.after, found.mean) == (5.75, 3.75, -2.0)
    reach = 3.182446 * math.sqrt(2.0 / 3.0) / 2.0  # t(0.975, 3) sd / sqrt(n)
    assert (found.low, found.high) == (pytest.approx(-2.0 - reach, abs=1e-5), pytest.approx(-2.0 + reach, abs=1e-5))
    assert (found.better, found.worse, found.p_sign) == (4, 0, pytest.approx(0.125))


def write(path, records, crashed=()):
    details = {record["case"]["name"]: record for record in records}
    path.write_text(json.dumps({"about": {}, "metrics": {}, "crashed": dict.fromkeys(crashed, "Error"), "details": details}))
    return path


def row(said, name):
    """Return pairs, better and worse of a number."""
    line = next(line for line in said.splitlines() if line.startswith(name))
    return [int(word) for word in line.split("  p =")[0].split()[-3:]]


def test_what_is_missing_or_failed_in_the_second_run_is_worse(tmp_path, record_of, capsys):
    before = [record_of(case) for case in CASES]
    after = [record_of(case) for case in CASES[1:]]
    after[0]["score"]["volume_error"] = None
    before[2]["score"]["volume_error"] = None
    after[3]["score"]["roots"] = None
    a, b = write(tmp_path / "a.json", before), write(tmp_path / "b.json", after, crashed=[CASES[0].name])
    assert command.main(["compare", str(a), str(b)]) == 0
    said = capsys.readouterr().out
    assert "11 cases in both, 0 only in A, 0 only in B" in said
    assert f"failed in B: {CASES[0].name}\n" in said
    assert row(said, "volume error (size)") == [9, 1, 2]
    assert row(said, "tip recall") == [10, 0, 2]
    assert row(said, "memory") == [11, 0, 1]
    none = write(tmp_path / "none.json", [], crashed=[case.name for case in CASES])
    assert command.main(["compare", str(a), str(none)]) == 0
    assert row(capsys.readouterr().out, "time") == [0, 0, 12]


def test_runs_that_share_nothing_and_other_files_are_refused(tmp_path, record_of, capsys):
    a, b = (write(tmp_path / f"{k}.json", [record_of(case)]) for k, case in enumerate(CASES[:2]))
    assert command.main(["compare", str(a), str(b)]) == 2
    assert "have no case" in capsys.readouterr().err
    path = tmp_path / "run.json"
    for content in (None, "{", "[]", "{}", '{"details": {"a": 3}}', '{"details": {}}'):
        if content is not None:
            path.write_text(content)
        with pytest.raises(UserError, match=r"run\.json"):
            run_comparison.read_cases(path)
