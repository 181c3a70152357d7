"""Storage of the results of individual stages in open formats, for inspection.

Each stage is written to two files: NAME.json contains the fields of the result under their Python names, and NAME.npz
contains the arrays. The JSON file refers to an array by ``{"npz": KEY, "shape": [...], "dtype": "..."}``.
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
STAGES = ("cameras", "coverage", "roots", "hull", "solid")
"""Names of the stages, in processing order."""


@dataclass(frozen=True)
class StageFolder:
    """Folder to which the results of the stages of a reconstruction are written."""

    folder: Path | None
    """Path of the folder. If it is None, nothing is written."""

    @staticmethod
    def begin(folder: Path | str | None) -> StageFolder:
        """Create a stage folder, and remove the files of an earlier reconstruction from it."""
        kept = StageFolder(None if folder is None else Path(folder))
        if kept.folder is not None:
            for name in STAGES:
                for suffix in (".json", ".npz"):
                    (kept.folder / f"{name}{suffix}").unlink(missing_ok=True)
        return kept

    def keep(self, stage: str, value: T, *, leave: tuple[str, ...] = ()) -> T:
        """Write the result of a stage, and return it unchanged.

        The JSON file is written last. A stage with a JSON file is therefore complete.

        Parameters
        ----------
        stage : str
            Name of the stage, an element of `STAGES`.
        value : dataclass
            Result of the stage.
        leave : tuple of str
            Names of fields that are omitted at any depth, such as results of an earlier stage and device arrays that
            are derived from them.

        Returns
        -------
        dataclass
            The argument ``value``.

        Raises
        ------
        UserError
            If the folder cannot be written.
        """
        if stage not in STAGES:
            raise ValueError(f"{stage=} must be one of {STAGES}")
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
    """Convert a value to types that the json module can write, and add its arrays to ``arrays``.

    Numbers that are not finite are converted to null.
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
        raise TypeError(f"{at}: {type(value).__name__} cannot be written to the files of a stage")
    if not array.shape:
        return _plain(array.item(), at, leave, arrays)
    key = at.partition("/")[2] or at
    arrays[key] = array
    return {"npz": key, "shape": list(array.shape), "dtype": str(array.dtype)}
