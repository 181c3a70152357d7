"""Results that are passed from stage to stage, written in open formats for inspection.

Each stage has two files: NAME.json contains its fields, named as in Python, and NAME.npz the arrays. An array is
represented in the JSON by ``{"npz": KEY, "shape": [...], "dtype": "..."}``.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import trimesh
from numpy.typing import NDArray

from rhizotwin.scenes import atomic

T = TypeVar("T")
STAGES = ("cameras", "coverage", "hull", "roots", "hull_again", "solid")
"""Names of the stages, in order. The hull is carved again if the roots sway (the last one is kept as "hull"), and once
more if the roots change the calibration or the attenuation ("hull_again")."""


@dataclass(frozen=True)
class StageFolder:
    """Folder for the results of the stages of a reconstruction."""

    folder: Path | None
    """None: nothing is written."""

    @staticmethod
    def begin(folder: Path | str | None) -> StageFolder:
        """Return a folder for stages, after removing those of an earlier reconstruction."""
        kept = StageFolder(None if folder is None else Path(folder))
        if kept.folder is not None:
            for name in STAGES:
                for suffix in (".json", ".npz"):
                    (kept.folder / f"{name}{suffix}").unlink(missing_ok=True)
        return kept

    def keep(self, stage: str, value: T, *, leave: tuple[str, ...] = ()) -> T:
        """Write a stage's value and return it; the ``.json`` is written last, so that a stage with one is complete.

        Parameters
        ----------
        stage : str
            One of `STAGES`.
        value : dataclass
            Result of the stage.
        leave : tuple of str
            Names of fields that are omitted at any depth: results of an earlier stage, and device data derived from
            them.

        Returns
        -------
        dataclass
            The value, unchanged.

        Raises
        ------
        UserError
            If the folder cannot be written.
        """
        if stage not in STAGES:
            raise ValueError(f"{stage=} is none of {STAGES}")
        if self.folder is None:
            return value
        arrays: dict[str, NDArray[Any]] = {}
        plain = _plain(value, stage, frozenset(leave), arrays)
        buffer = io.BytesIO()
        np.savez_compressed(buffer, allow_pickle=False, **arrays)
        atomic.write_bytes(self.folder / f"{stage}.npz", buffer.getvalue())
        atomic.write_json(self.folder / f"{stage}.json", plain)
        return value


def _plain(value: object, at: str, leave: frozenset[str], arrays: dict[str, NDArray[Any]]) -> object:
    """Return a value in JSON form, and add its arrays to ``arrays``.

    Numbers that are not finite become null.
    """
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, trimesh.Trimesh):
        return _plain({"vertices_mm": np.asarray(value.vertices), "faces": np.asarray(value.faces)}, at, leave, arrays)
    if is_dataclass(value):
        parts = {field.name: getattr(value, field.name) for field in fields(value) if field.name not in leave}
        return _plain(parts, at, leave, arrays)
    if isinstance(value, Mapping):
        return {str(key): _plain(item, f"{at}/{key}", leave, arrays) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(item, f"{at}/{place}", leave, arrays) for place, item in enumerate(value)]
    array = np.asarray(value)  # also for Dr.Jit arrays
    if array.dtype.hasobject:
        raise TypeError(f"{at}: {type(value).__name__} has no open format")
    if not array.shape:
        return _plain(array.item(), at, leave, arrays)
    key = at.partition("/")[2] or at
    arrays[key] = array
    return {"npz": key, "shape": list(array.shape), "dtype": str(array.dtype)}
