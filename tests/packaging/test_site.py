"""The docs' site: every page is two clicks from the front page."""

import re
from pathlib import Path

import yaml

DOCS = Path(__file__).resolve().parents[2] / "docs"
LINK = re.compile(r"\]\(([^)#:]+\.md)")


def linked(page: Path) -> set[Path]:
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
