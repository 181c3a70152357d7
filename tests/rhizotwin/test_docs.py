"""What the documents tell people to type exists; their links lead somewhere; their scenes load."""

import re
import shlex
import tomllib
from dataclasses import dataclass, is_dataclass
from pathlib import Path

import pytest

from benchmarks.arguments import parser as benchmarks_parser
from rhizotwin import command_line
from rhizotwin.commands import COMMANDS, GROUPS
from rhizotwin.recon.settings import Settings
from rhizotwin.scenes.files import load_profile, load_scene, scene_from_dict
from rhizotwin.scenes.schema import Place, from_plain

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\[[^\]]*\]\(([^)#]+)[^)]*\)")


@dataclass(frozen=True)
class Typed:
    """A line that a page tells people to type."""

    page: str
    line: str


TYPED = [
    Typed(str(page.relative_to(ROOT)), line)
    for page in PAGES
    for language, block in FENCE.findall(page.read_text(encoding="utf-8"))
    if language == "bash"
    for line in block.splitlines()
    if line.strip()
]


def own_words(line: str) -> list[str] | None:
    """Return what a line gives to the `rhizotwin` command, or None if it calls something else."""
    words = shlex.split(line)
    if words[:2] == ["./run", "demo"]:
        return words[1:]
    if words[:2] == ["./run", "rhizotwin"]:
        return words[2:]
    return words[1:] if words[0] in ("rhizotwin", ".venv/bin/rhizotwin") else None


@pytest.mark.parametrize("typed", TYPED, ids=lambda typed: f"{typed.page}: {typed.line[:60]}")
def test_line_can_be_typed(typed: Typed) -> None:
    words = shlex.split(typed.line)
    ours = own_words(typed.line)
    if ours is not None:
        given = command_line.bind(ours)[1].arguments
        for group in list(given.values()):
            given |= vars(group) if is_dataclass(group) else {}
        if given.get("scene") is not None and not given["scene"].endswith(".toml"):
            load_scene(given["scene"])
        if given.get("profile") is not None:
            load_profile(given["profile"])
    elif words[:2] == ["./run", "bench"]:
        benchmarks_parser().parse_args(words[2:])
    elif words[0] == "./run":
        assert words[1] in ("docs", "setup", "test")
        assert f"    {words[1]})\n" in (ROOT / "run").read_text(encoding="utf-8")
    else:
        assert words[0] in (".venv/bin/python", ".venv/bin/uv")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for target in LINK.findall(page.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_scenes_and_settings_in_the_documents_load(page: Path) -> None:
    for language, block in FENCE.findall(page.read_text(encoding="utf-8")):
        if language == "toml":
            if page.name == "settings.md":
                from_plain(Settings, tomllib.loads(block), Place(str(page)))
            else:
                scene_from_dict(tomllib.loads(block), where=str(page))


def test_every_decision_is_in_the_index() -> None:
    folder = ROOT / "docs" / "decisions"
    listed = set(LINK.findall((folder / "README.md").read_text(encoding="utf-8")))
    assert listed == {path.name for path in folder.glob("*.md")} - {"README.md"} | {"../log/README.md"}


def test_every_command_is_in_the_documents() -> None:
    table = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    for command in COMMANDS:
        assert command in GROUPS or re.search(rf"^\| `rhizotwin {command}\b", table, re.MULTILINE), command


def test_ci_runs_what_the_readme_says() -> None:
    for page in (".ci/run", "README.md", "docs/development.md"):
        assert "./run test --all" in (ROOT / page).read_text(encoding="utf-8")


def test_lock_names_no_index() -> None:
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    assert "://" not in lock
    pins = re.findall(r"^[a-z0-9-]+==\S+(?: ; .*?)? \\\n(?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+", lock, re.MULTILINE)
    assert len(pins) == len(re.findall(r"^[a-z0-9]", lock, re.MULTILINE)) > 20


def test_lock_holds_every_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    locked = set(re.findall(r"^([a-z0-9-]+)==", (ROOT / "requirements.lock").read_text(encoding="utf-8"), re.MULTILINE))
    needed = [*project["dependencies"], *project["optional-dependencies"]["dev"]]
    assert {re.split(r"[<>=!~ ]", need)[0] for need in needed} <= locked


def test_every_package_is_in_the_wheel() -> None:
    listed = set(tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["packages"])
    tops = [ROOT / "rhizotwin", *((ROOT / "rhizotwin" / name) for name in ("recon", "rig", "scenes", "sim"))]
    folders = {file.parent.relative_to(ROOT) for top in tops for file in top.rglob("__init__.py")}
    assert listed == {".".join(folder.parts) for folder in folders}
