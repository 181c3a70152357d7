"""What the documents tell people to type exists; their links lead somewhere; their scenes load."""

import importlib.util
import re
import shlex
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import is_dataclass
from pathlib import Path

from benchmarks import __main__ as benchmarks
from rhizotwin.commands import COMMANDS, GROUPS, command_line
from rhizotwin.recon.settings import Settings
from rhizotwin.rig.arm.placement import compute_joints_from_direction
from rhizotwin.rig.rig_file import ArmPart, RigFile
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import load_profile, load_scene, scene_from_dict
from rhizotwin.scenes.schema import Place, from_plain

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\[[^\]]*\]\(([^)#]+)[^)]*\)")


def blocks(page: Path, language: str) -> list[str]:
    """Return the fenced blocks of a page in a language."""
    return [block for named, block in FENCE.findall(page.read_text(encoding="utf-8")) if named == language]


def failures(check: Callable[[Path, str], object], found: Iterable[tuple[Path, str]]) -> list[str]:
    """Return what fails a check, each with its page and the reason."""
    failed = []
    for page, text in found:
        try:
            check(page, text)
        except (AssertionError, KeyError, SystemExit, UserError, ValueError) as error:
            failed.append(f"{page.relative_to(ROOT)}: {text[:80]}: {error!r}")
    return failed


def check_line(_: Path, line: str) -> None:
    """Check that a line can be typed: its options are known, its scenes and profiles load."""
    words = shlex.split(line)
    if words[:2] in (["./run", "demo"], ["./run", "rhizotwin"]) or words[0] in ("rhizotwin", ".venv/bin/rhizotwin"):
        ours = words[1:] if words[:2] != ["./run", "rhizotwin"] else words[2:]
        given = command_line.bind(ours)[1].arguments
        for group in list(given.values()):
            given |= vars(group) if is_dataclass(group) else {}
        if given.get("scene") is not None and not given["scene"].endswith(".toml"):
            load_scene(given["scene"])
        if given.get("profile") is not None:
            load_profile(given["profile"])
    elif words[:2] == ["./run", "bench"]:
        benchmarks.bind(words[2:])
    elif words[0] == "./run":
        assert words[1] in ("docs", "setup", "test")
        assert f"    {words[1]})\n" in (ROOT / "run").read_text(encoding="utf-8")
    else:
        assert words[0] in (".venv/bin/python", ".venv/bin/uv"), "neither ours nor Python"


def test_lines_can_be_typed() -> None:
    lines = [(page, line) for page in PAGES for block in blocks(page, "bash") for line in block.splitlines() if line.strip()]
    assert len(lines) > 100
    assert failures(check_line, lines) == []


def test_links_lead_somewhere() -> None:
    def check(page: Path, target: str) -> None:
        assert "://" in target or (page.parent / target).exists()

    assert failures(check, [(page, target) for page in PAGES for target in LINK.findall(page.read_text(encoding="utf-8"))]) == []


def test_the_arm_reaches_the_poses_in_the_documents() -> None:
    lines = re.findall(r"^poses = .+$", (ROOT / "docs" / "scanning.md").read_text(encoding="utf-8"), re.MULTILINE)
    poses = [pose for line in lines for pose in tomllib.loads(line)["poses"]]
    assert poses
    for pose in poses:  # raises an error where the arm cannot reach
        compute_joints_from_direction(RigFile(arm=ArmPart()), tuple(pose["position_mm"]), tuple(pose["direction"]))


def test_scenes_and_settings_in_the_documents_load() -> None:
    def check(page: Path, block: str) -> None:
        if page.name == "settings.md":
            from_plain(Settings, tomllib.loads(block), Place(str(page)))
        else:
            scene_from_dict(tomllib.loads(block), where=str(page))

    assert failures(check, [(page, block) for page in PAGES for block in blocks(page, "toml")]) == []


def test_every_command_and_the_checks_are_in_the_documents() -> None:
    table = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    alone = [command for command in COMMANDS if command not in GROUPS]
    assert [command for command in alone if not re.search(rf"^\| `rhizotwin {command}\b", table, re.MULTILINE)] == []
    pages = (".ci/run", "README.md", "docs/development.md")
    assert [page for page in pages if "./run test --all" not in (ROOT / page).read_text(encoding="utf-8")] == []


def pins(lock: str) -> set[tuple[str, str]]:
    """Return the names and versions in a lock file, each of which must have hashes."""
    text = (ROOT / lock).read_text(encoding="utf-8")
    assert "://" not in text
    found = re.findall(r"^([a-z0-9-]+)==(\S+)(?: ; .*?)? \\\n(?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+", text, re.MULTILINE)
    assert len(found) == len(re.findall(r"^[a-z0-9]", text, re.MULTILINE)) > 20
    return set(found)


def test_locks_have_hashes_no_index_and_every_dependency() -> None:
    def names(needs: list[str]) -> set[str]:
        return {re.split(r"[<>=!~ ;[]", need)[0] for need in needs}

    whole = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    users, developers = pins("requirements.lock"), pins("requirements-dev.lock")
    extras = whole["project"]["optional-dependencies"]
    assert users < developers
    assert names([*whole["project"]["dependencies"], *whole["dependency-groups"]["build"]]) <= dict(users).keys()
    assert names([*extras["dev"], *extras["docs"]]) <= dict(developers).keys()
    assert not {"pytest", "mypy", "mkdocs", "playwright"} & dict(users).keys()


def test_no_address_or_package_is_named_before_it_exists() -> None:
    intended = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["urls"].values()
    unpublished = ["pip install rhizotwin", "pip install 'rhizotwin", "rhizotwin.github.io", "ghcr.io/rhizotwin", *intended]
    folders = ("docs", "rhizotwin", "recon", "rig", "scenes", "sim", "benchmarks", "examples", "packaging")
    kinds = (".cff", ".js", ".md", ".py", ".toml", ".yaml", ".yml")
    files = [path for folder in folders for path in (ROOT / folder).rglob("*") if path.suffix in kinds]
    files = [*files, *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CITATION.cff"))]
    texts = {path: path.read_text(encoding="utf-8") for path in files if path.name != "releasing.md"}
    assert [(path, name) for path, text in texts.items() for name in unpublished if name in text] == []


def test_pictures_of_the_output_are_those_of_the_present_code() -> None:
    place = ROOT / "packaging" / "pictures.py"
    spec = importlib.util.spec_from_file_location("pictures", place)
    assert spec is not None
    assert spec.loader is not None
    pictures = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(pictures)
    assert pictures.outdated() == [], "make them again: python packaging/pictures.py"
