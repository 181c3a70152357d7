"""Print a version's section of CHANGELOG.md: the notes of its release.

python packaging/release_notes.py 0.2.0
python packaging/release_notes.py v0.2.0    # a tag, which must be the version in pyproject.toml
"""

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def section(changelog: str, version: str) -> str:
    """Return what stands between a version's heading and the next.

    Parameters
    ----------
    changelog : str
        In the format of Keep a Changelog.
    version : str
        Such as ``0.2.0``.

    Raises
    ------
    ValueError
        If there is no such section, or nothing in it.
    """
    found = re.search(rf"^## {re.escape(version)}(?: [^\n]*)?$\n(.*?)(?=^## |\Z)", changelog, re.MULTILINE | re.DOTALL)
    if found is None or not found[1].strip():
        raise ValueError(f"CHANGELOG.md has no section '## {version}' with something in it; write it before the release")
    return found[1].strip() + "\n"


def check_tag(tag: str) -> str:
    """Return the version that a tag names; it must be that of pyproject.toml.

    Raises
    ------
    ValueError
        If it is another one.
    """
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    if tag.removeprefix("v") != version:
        raise ValueError(f"the tag {tag} is not v{version}, the version in pyproject.toml")
    return str(version)


def main(words: list[str]) -> int:
    """Print the section of the version that is given."""
    if len(words) != 1:
        sys.stderr.write("usage: python packaging/release_notes.py VERSION\n")
        return 2
    try:
        sys.stdout.write(section((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), check_tag(words[0])))
    except ValueError as error:
        sys.stderr.write(f"release_notes: {error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
