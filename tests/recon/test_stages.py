"""What is kept of a stage: every field once, arrays exactly, in formats that need no Python to be trusted."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rhizotwin.recon.device import numbers
from rhizotwin.recon.stages import StageFolder


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
