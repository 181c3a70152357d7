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
case "$*" in *"${FAIL:-nothing fails}"*) exit 3 ;; *"--fault"*) exit 1 ;; esac
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Make a folder with the script and an environment that only says what was called."""
    root = tmp_path.resolve()
    shutil.copy(ROOT / "run", root / "run")
    programs = root / ".venv" / "bin"
    programs.mkdir(parents=True)
    for name in ("python", "lint-imports"):
        (programs / name).write_text(STUB)
        (programs / name).chmod(0o755)
    for lock in ("requirements.lock", "requirements-dev.lock"):
        (root / lock).write_text(f"{lock}\n")
        stamp = hashlib.sha256(f"{root}\n{lock}\n".encode()).hexdigest()
        (root / ".venv" / f"{lock}.stamp").write_text(f"{stamp}\n")
    return root


def run(checkout: Path, *words: str, fail: str = "nothing fails") -> tuple[int, list[str], list[str]]:
    """Return the exit code, what was called and what was said."""
    environment = {"PATH": "/usr/bin:/bin", "FAIL": fail}
    done = subprocess.run([checkout / "run", *words], capture_output=True, text=True, check=False, env=environment, timeout=60)
    return done.returncode, done.stdout.splitlines(), done.stderr.splitlines()


def gates(called: list[str]) -> list[str]:
    return [line.partition("--gate")[2].strip() for line in called if "--gate" in line]


def test_short_checks(checkout: Path) -> None:
    code, called, said = run(checkout, "test")
    assert code == 0, said
    timed = [line.split(":")[1].strip() for line in said if line.endswith(" s")]
    assert timed[:-1] == ["lint", "format", "types", "layers", "tests", "accuracy"]
    assert any("-m not slow" in line for line in called)
    assert gates(called) == ["--scenes radish_day05a --methods coverage"]


def test_every_check_paths_and_failures(checkout: Path) -> None:
    code, called, _ = run(checkout, "test", "--all")
    assert code == 0
    assert any(line.endswith("-m not nightly") for line in called)
    faults = [f"--fault {fault}" for fault in ("ghost", "swap", "tips", "length")]
    assert gates(called)[-4:] == [f"--scenes radish_day05a --methods coverage {one}" for one in faults]
    code, called, _ = run(checkout, "test", "--all", fail="--fault swap")
    assert code == 1
    assert gates(called)[-1].endswith("--fault swap")
    assert called[-1] == "the gate does not notice the deliberate fault 'swap': exit code 3 instead of 1"
    code, (tests,), _ = run(checkout, "test", "tests/a", "tests/b.py")
    assert code == 0
    assert tests.endswith("tests/a tests/b.py")
    code, called, said = run(checkout, "test", fail="pytest")
    assert code == 1
    assert "pytest" in called[-1]
    assert "--last-failed" in said[-1]
    assert not (checkout / ".gate.log").exists()


def test_commands_install_only_the_lock_files_that_they_need(checkout: Path) -> None:
    def installs(*words: str) -> list[str]:
        _, called, said = run(checkout, *words)
        log = (checkout / ".venv-setup.log").read_text()
        assert not any("making .venv" in line for line in said)
        return [line.rpartition("/")[2] for line in [*called, *log.splitlines()] if " pip " in line or "-m pip" in line]

    stamp = checkout / ".venv" / "requirements-dev.lock.stamp"
    wanted = stamp.read_text()
    stamp.unlink()
    (checkout / ".venv" / "bin" / "rhizotwin").symlink_to("python")
    assert installs("demo") == []
    assert not stamp.exists()
    assert installs("test", "tests/a") == ["requirements-dev.lock"]
    assert stamp.read_text() == wanted
    assert installs("test", "tests/a") == []
