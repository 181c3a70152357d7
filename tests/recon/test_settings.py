"""Settings from a file, and what is refused."""

import re
import tomllib
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import pytest

from rhizotwin.recon.settings import Settings, load_settings
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.schema import Place, from_plain, to_plain

PAGE = Path(__file__).resolve().parents[2] / "docs" / "settings.md"


def test_files_have_defaults_and_results_record_the_same(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    path.write_text("voxel_mm = 0.2\n[hull]\nfinest_mm = 0.1\n", encoding="utf-8")
    found = load_settings(path)
    assert found == replace(Settings(), voxel_mm=0.2, hull=replace(Settings().hull, finest_mm=0.1))
    assert from_plain(Settings, to_plain(found), Place("result.json")) == found


def limits_of(group: object, before: str = "") -> dict[str, tuple[object, tuple[float, float]]]:
    """Return default and limits of every number, by its key."""
    found: dict[str, tuple[object, tuple[float, float]]] = {}
    for each in fields(group):
        key, value = before + each.name, getattr(group, each.name)
        found |= limits_of(value, f"{key}.") if is_dataclass(value) else {key: (value, each.metadata.get("limits"))}
    return found


def test_the_page_has_every_number_with_its_default_and_limits() -> None:
    rows = re.findall(r"^\| `([\w.]+)` \| (\S.*?) \| ([^|]+) \| \S", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    ends = {key: re.fullmatch(r"([\d.e-]+) to ([\d.e-]+)", limits) for key, _, limits in rows}
    told = {
        key: (tomllib.loads(f"x = {default}")["x"], None if (two := ends[key]) is None else (float(two[1]), float(two[2])))
        for key, default, _ in rows
    }
    assert told == {key: (to_plain(value), limits) for key, (value, limits) in limits_of(Settings()).items()}


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("voxel_mn = 0.2", 'did you mean "voxel_mm"'),
        ("[hull]\nfinest_mm = 0", r"line 2: \[hull\] finest_mm = 0"),
        ("[trust]\nleast_views = 8.5", "must be a whole number"),
        ("[trust]\nsway_mm = [0.2, 0.1]", r"sway_mm = \[0.2, 0.1\]: the second limit must not be below the first"),
        ("voxel_mm = ", "not valid TOML"),
        (None, "does not exist"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(tmp_path: Path, text: str | None, named: str) -> None:
    path = tmp_path / "settings.toml"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(UserError, match=named):
        load_settings(path)
