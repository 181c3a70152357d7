"""Runs against another commit: what is measured, and which is divided by which."""

from pathlib import Path

import pytest

from benchmarks import commit_comparison
from benchmarks.__main__ import main
from benchmarks.commit_comparison import Job
from rhizotwin.scenes.errors import UserError


def checkout(folder: Path, megabytes: int, loops: int) -> Path:
    """Make a program of the command line's name that takes memory and time."""
    (folder / "rhizotwin").mkdir(parents=True)
    (folder / "rhizotwin" / "__init__.py").touch()
    program = f"import sys\nkept = bytearray({megabytes} * 2**20)\nfor i in range({loops}):\n    pass\nsys.exit('--wrong' in sys.argv)\n"
    (folder / "rhizotwin" / "__main__.py").write_text(program)
    return folder


def test_ratios_are_of_this_code_by_the_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    heavy, light = checkout(tmp_path / "heavy", 600, 10_000_000), checkout(tmp_path / "light", 1, 1)
    monkeypatch.setattr(commit_comparison, "ROOT", light)
    monkeypatch.setattr(commit_comparison, "check_out", lambda _: heavy)
    said: list[str] = []
    (found,) = commit_comparison.compare("old", jobs=[Job("both", (), makes=False, must=0.5)], repeats=2, device="cpu", say=said.append)
    assert found.cpu < 0.5
    assert found.memory < 0.5
    assert found.before.memory_mib > 600.0 > found.after.memory_mib
    assert said == [commit_comparison.table([found]).splitlines()[-1]]


def test_a_run_that_fails_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = checkout(tmp_path / "one", 1, 1)
    monkeypatch.setattr(commit_comparison, "ROOT", folder)
    monkeypatch.setattr(commit_comparison, "check_out", lambda _: folder)
    with pytest.raises(UserError, match=r"--wrong.* ended with code 1"):
        commit_comparison.compare("old", jobs=[Job("fails", ("--wrong",), makes=False)], repeats=1, device="cpu", say=str)


def test_an_unknown_commit_or_job_is_a_mistake(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["speed", "--against", "no-such-commit", "--jobs", "help"]) == 2
    assert "git says" in capsys.readouterr().err
    assert main(["speed", "--against", "HEAD", "--jobs", "nothing"]) == 2
    assert "is none of printed-0.27" in capsys.readouterr().err
