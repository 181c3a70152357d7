"""The accuracy ladder that is published was measured with a recent version of the reconstruction."""

import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

LADDER = "benchmarks/ladder.json"
SOURCES = "recon"
MAX_COMMITS = 60
"""Commits of the reconstruction since the measurement: about a week of work on it, of which a renewal takes a night."""
RENEW = "./run bench accuracy --update-baseline"


def check(root: Path) -> Iterator[str]:
    """Yield a line for each commit whose records are too old; none without a ladder, or where git does not know their age."""
    if not (root / LADDER).exists():
        return
    try:
        commits = recorded((root / LADDER).read_text(encoding="utf-8"))
    except (KeyError, TypeError, ValueError):
        yield f"{LADDER}:1: it is damaged, no list of records that name their commits can be read from it; restore it, or type: {RENEW}"
        return
    top = git(root, "rev-parse", "--show-toplevel", "--is-shallow-repository")
    folder, shallow = top.rsplit(maxsplit=1) if top else ("", "")
    # the sources may have been unpacked inside another repository
    if not folder or Path(folder).resolve() != root.resolve():
        return
    for commit in commits:
        count = git(root, "rev-list", "--count", f"{commit}..HEAD", "--", SOURCES)
        if count is None and shallow == "false":
            yield f"{LADDER}:1: commit {commit} is not in this repository, so the age of its records is unknown; type: {RENEW}"
        elif count is not None and int(count) > MAX_COMMITS:
            yield f"{LADDER}:1: commit {commit} is {int(count)} commits of {SOURCES} old, at most {MAX_COMMITS}; type: {RENEW}"


def recorded(text: str) -> list[str]:
    """Return the distinct commits of the records, in order."""
    commits = dict.fromkeys(record["commit"] for record in json.loads(text)["records"])
    if not all(re.fullmatch(r"[0-9a-f]{4,40}", commit) for commit in commits):
        raise ValueError(f"{list(commits)} are not all abbreviated hashes of git")
    return list(commits)


def git(root: Path, *words: str) -> str | None:
    """Return the output of git, or None where it is missing or fails."""
    program = shutil.which("git")
    done = subprocess.run([program, *words], cwd=root, capture_output=True, text=True, check=False) if program else None
    return done.stdout if done and done.returncode == 0 else None
