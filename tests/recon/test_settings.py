"""Settings from a file, and what is kept of a stage: arrays exactly, in formats that need no Python to be trusted."""

import json
import re
import tomllib
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rhizotwin.recon.device import numbers
from rhizotwin.recon.settings import Settings, load_settings
from rhizotwin.recon.stages import StageFolder
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
        (None, "there is no such file"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(tmp_path: Path, text: str | None, named: str) -> None:
    path = tmp_path / "settings.toml"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(UserError, match=named):
        load_settings(path)


@dataclass(frozen=True)
class Part:
    """A part with arrays."""

    mm: float
    values: Any


@dataclass(frozen=True)
class Made:
    """What a stage makes."""

    name: str
    found: float | None
    pair: tuple[float, float]
    parts: dict[int, Part]
    seen: object


def test_fields_and_arrays_come_back(tmp_path: Path) -> None:
    values = np.array([[1.0, np.nan], [-0.1, 1e-300]])
    made = Made("hull", float("inf"), (0.1, 2.0), {7: Part(0.5, values), 3: Part(1.0, numbers(np.arange(3.0)))}, seen=object())
    StageFolder.begin(tmp_path).keep("hull", made, leave=("seen",))
    plain, arrays = json.loads((tmp_path / "hull.json").read_text()), np.load(tmp_path / "hull.npz", allow_pickle=False)
    parts = plain.pop("parts")
    assert plain == {"name": "hull", "found": None, "pair": [0.1, 2.0]}
    assert parts["7"] == {"mm": 0.5, "values": {"npz": "parts/7/values", "shape": [2, 2], "dtype": "float64"}}
    assert set(arrays.files) == {"parts/7/values", "parts/3/values"}
    np.testing.assert_array_equal(arrays["parts/7/values"], values)
    assert arrays["parts/3/values"].tolist() == [0.0, 1.0, 2.0]


def test_what_has_no_open_format_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="solid/seen: object"):
        StageFolder.begin(tmp_path).keep("solid", Made("", None, (0.0, 0.0), {}, seen=object()))
    StageFolder.begin(None).keep("cameras", Part(1.0, ()))  # nobody asked for anything
    assert not any(tmp_path.iterdir())
