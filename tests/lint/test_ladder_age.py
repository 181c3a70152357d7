"""The age of the accuracy ladder, in small repositories."""

import json
import subprocess
from pathlib import Path

import pytest

from tests.lint import ladder_age

RENEW = "./run bench accuracy --update-baseline"


def git(folder: Path, *words: str) -> str:
    author = ["-c", "user.name=A", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false"]
    return subprocess.run(["git", *author, *words], cwd=folder, capture_output=True, text=True, check=True).stdout.strip()


def commit(folder: Path, file: str) -> str:
    (folder / file).parent.mkdir(exist_ok=True)
    with (folder / file).open("a") as changed:
        changed.write("\n")
    git(folder, "add", file)
    git(folder, "commit", "--quiet", "-m", "change")
    return git(folder, "rev-parse", "--short", "HEAD")


def check(folder: Path, text: str) -> list[str]:
    (folder / "benchmarks").mkdir(exist_ok=True)
    (folder / ladder_age.LADDER).write_text(text)
    return list(ladder_age.check(folder))


def measured(*commits: str) -> str:
    return json.dumps({"records": [{"commit": commit, "iou": 0.9} for commit in commits]})


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    # a hook that runs the tests sets these
    for name in ("GIT_DIR", "GIT_INDEX_FILE", "GIT_WORK_TREE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(ladder_age, "MAX_COMMITS", 2)
    folder = tmp_path / "repository"
    folder.mkdir()
    git(folder, "init", "--quiet")
    return folder


def test_only_commits_of_the_reconstruction_age_a_record(repository: Path) -> None:
    old, recent = commit(repository, "recon/a.py"), commit(repository, "recon/a.py")
    commit(repository, "docs/a.md")
    commit(repository, "recon/a.py")
    assert check(repository, measured(old, recent, old)) == []
    commit(repository, "recon/b.py")
    line = f"benchmarks/ladder.json:1: commit {old} is 3 commits of recon old, at most 2; type: {RENEW}"
    assert check(repository, measured(old, recent, old)) == [line]


def test_a_commit_may_be_missing_from_a_shallow_history_only(repository: Path) -> None:
    old = commit(repository, "recon/a.py")
    commit(repository, "recon/a.py")
    shallow = repository.parent / "shallow"
    git(repository, "clone", "--quiet", "--depth", "1", repository.as_uri(), str(shallow))
    assert check(shallow, measured(old)) == []
    (line,) = check(repository, measured("0123abc"))
    assert "0123abc is not in this repository" in line


def test_nothing_is_known_without_a_ladder_git_or_repository(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    commit(repository, "recon/a.py")
    assert list(ladder_age.check(repository)) == []
    # unpacked inside a repository that is not its own
    (repository / "inner").mkdir()
    assert check(repository / "inner", measured("0123abc")) == []
    monkeypatch.setenv("PATH", "")
    assert check(repository, measured("0123abc")) == []


@pytest.mark.parametrize("text", ["{", "[]", '{"records": [{"commit": "--all"}]}'])
def test_a_damaged_ladder_is_one_violation(repository: Path, text: str) -> None:
    (line,) = check(repository, text)
    assert line.startswith("benchmarks/ladder.json:1: it is damaged")
