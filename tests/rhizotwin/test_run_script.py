"""The script `run`: what `./run test` calls, what it says, and what it tells people to do where a check fails."""

import hashlib
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
STUB = """#!/usr/bin/env bash
[ "$1" = -c ] || [ "$1" = -P ] && exit 0
echo "called $(basename "$0") $*"
case "$*" in *"${FAIL:-nothing fails}"*) exit 3 ;; esac
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Make a folder with the script and an environment that only says what was called."""
    root = tmp_path.resolve()
    shutil.copy(ROOT / "run", root / "run")
    (root / "requirements.lock").write_text("nothing\n")
    programs = root / ".venv" / "bin"
    programs.mkdir(parents=True)
    for name in ("python", "lint-imports"):
        (programs / name).write_text(STUB)
        (programs / name).chmod(0o755)
    stamp = hashlib.sha256(f"{root}\nnothing\n".encode()).hexdigest()
    (root / ".venv" / "stamp").write_text(f"{stamp}\n")
    return root


def run(checkout: Path, *words: str, fail: str = "nothing fails") -> tuple[int, list[str], list[str]]:
    """Return the exit code, what was called and what was said."""
    environment = {"PATH": "/usr/bin:/bin", "FAIL": fail}
    done = subprocess.run([checkout / "run", *words], capture_output=True, text=True, check=False, env=environment, timeout=60)
    return done.returncode, done.stdout.splitlines(), done.stderr.splitlines()


def test_the_short_checks_say_what_they_take_and_leave_out_what_is_long(checkout: Path) -> None:
    code, called, said = run(checkout, "test")
    assert code == 0, said
    assert "15 minutes" in said[0]
    assert "--all" in said[0]
    assert said[-1].startswith("run: all checks passed after ")
    assert {line.split(":")[1].strip() for line in said if line.endswith(" s")} >= {
        "lint",
        "format",
        "types",
        "layers",
        "tests",
        "accuracy",
    }
    assert any("not slow" in line for line in called)
    assert sum("benchmarks accuracy --quick --gate" in line for line in called) == 1


def test_all_runs_every_test_and_the_gate_twice(checkout: Path) -> None:
    code, called, _ = run(checkout, "test", "--all")
    assert code == 0
    assert any(line.startswith("called python -m pytest -q") for line in called)
    assert not any("not slow" in line for line in called)
    gates = [line for line in called if "--gate" in line]
    assert [line.partition("--gate")[2].strip() for line in gates] == ["", "--change rounded:1001"]


@pytest.mark.parametrize(
    ("failing", "cure"),
    [
        ("ruff check", "--fix"),
        ("ruff format", "ruff format"),
        ("mypy", "mypy names"),
        ("pytest", "--last-failed"),
        ("accuracy", "./run bench scatter --quick"),
    ],
)
def test_a_check_that_fails_says_what_to_do_in_one_line_and_stops(checkout: Path, failing: str, cure: str) -> None:
    code, called, said = run(checkout, "test", fail=failing)
    assert code == 1
    assert failing in called[-1]
    assert "failed after" in said[-1]
    assert cure in said[-1]


def test_a_word_that_is_unknown_is_refused(checkout: Path) -> None:
    code, called, said = run(checkout, "test", "--some")
    assert code == 1
    assert not called
    assert "--all" in said[-1]


def test_the_slow_tests_exist() -> None:
    for name in (ROOT / "tests" / "slow.txt").read_text(encoding="utf-8").splitlines():
        path, _, test = name.partition("::")
        assert (ROOT / path).is_file(), name
        assert f"def {test.partition('[')[0]}" in (ROOT / path).read_text(encoding="utf-8"), name
