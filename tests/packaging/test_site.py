"""The docs' site: every page is two clicks from the front page, and the screencast is of this program."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import yaml

from rhizotwin.commands import COMMANDS

DOCS = Path(__file__).resolve().parents[2] / "docs"
LINK = re.compile(r"\]\(([^)#:]+\.md)")


def linked(page: Path) -> set[Path]:
    """Return the pages that a page links to."""
    return {(page.parent / target).resolve() for target in LINK.findall(page.read_text(encoding="utf-8"))}


def in_navigation() -> set[Path]:
    """Return the pages in the side bar, which every page shows."""
    text = (DOCS.parent / "mkdocs.yml").read_text(encoding="utf-8")
    waiting, found = [yaml.safe_load(text)["nav"]], set()
    while waiting:
        one = waiting.pop()
        if isinstance(one, str):
            found.add(DOCS / one)
        else:
            waiting += one.values() if isinstance(one, dict) else one
    return found


def test_every_page_is_two_clicks_away() -> None:
    first = in_navigation() | linked(DOCS / "index.md")
    second = first.union(*(linked(page) for page in first if page.is_relative_to(DOCS)))
    pages = set(DOCS.rglob("*.md"))
    assert len(pages) > 50
    assert pages - second == set()


def test_every_command_for_a_task_exists() -> None:
    named = set(re.findall(r"`rhizotwin ([a-z]+)", (DOCS / "which-command.md").read_text(encoding="utf-8")))
    assert named <= {command.split()[0] for command in COMMANDS}
    assert {"demo", "scan", "import", "reconstruct", "view", "traits", "export", "batch", "growth", "biomass"} <= named


def test_screencast_shows_commands_that_exist() -> None:
    picture = ET.parse(DOCS / "pictures" / "screencast.svg")
    lines = [one.text or "" for one in picture.iter("{http://www.w3.org/2000/svg}text")]
    typed = [line.split()[2] for line in lines if line.startswith("$ rhizotwin ")]
    assert typed[:2] == ["scenes", "demo"]
    assert set(typed) <= {command.split()[0] for command in COMMANDS}
    assert any("LLVM 19" in line for line in lines)
