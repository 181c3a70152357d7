"""Apply corrections to a result, undo and redo them, and measure the corrected result."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhizotwin.corrections import log as logs
from rhizotwin.corrections import state as states
from rhizotwin.corrections.log import Edit, Log
from rhizotwin.corrections.solid import Solid
from rhizotwin.corrections.state import Refit, State
from rhizotwin.scenes.dataset import file_sha256
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.rsml import Root
from rhizotwin.stored import result_files

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Measured:
    """Volume, length and number of roots after corrections."""

    volume_mm3: float
    """Total volume, mm3."""
    length_mm: float
    """Total length of all roots, mm."""
    roots: int
    """Number of roots."""
    volumes_mm3: Array
    """Volume in each voxel (N,), mm3."""
    solid: Solid
    """Voxels whose volume is divided among the roots. The first N voxels are those of ``volumes_mm3``."""


class Session:
    """Result of a reconstruction, to which corrections can be applied. The class is thread-safe.

    The volume is divided among the roots on first use of `solid`, at the latest by the first correction. The division
    takes seconds for large plants.

    Parameters
    ----------
    result_folder : Path
        Folder of the result.
    log : Log or None
        Corrections to apply. None: the corrections that are saved in the folder, if any.
    refit : Refit or None
        Function that fits roots to the pictures. None: refitting is not available.
    temporary : bool
        Whether the folder will be removed, so that corrections cannot be saved in it.

    Raises
    ------
    UserError
        If a file of the result cannot be read, or a correction cannot be applied.
    """

    def __init__(self, result_folder: Path, *, log: Log | None = None, refit: Refit | None = None, temporary: bool = False) -> None:
        self.folder = Path(result_folder)
        self.summary: dict[str, Any] = result_files.read_summary(self.folder)
        self.roots: tuple[Root, ...] = result_files.read_roots(self.folder)
        self.leaves = result_files.read_leaves(self.folder)
        self._sources = [(root.points_mm, root.diameters_mm) for root in self.roots]
        self._finest_mm = result_files.finest_mm(self.summary)
        self._undivided = Solid.undivided(self.leaves, self._sources, finest_mm=self._finest_mm)
        self._divided: Solid | None = None  # with the tubes of all corrections, including those that can be redone
        self._dividing = threading.Lock()
        self.log: Log = logs.new(self.folder)
        self.lock = threading.RLock()
        self._refit, self._temporary = refit, temporary
        self._states = [states.start(self._undivided, self.roots)]
        self._saved: tuple[Edit, ...] = ()
        self._undone: list[tuple[Edit, State]] = []
        self._measured: tuple[State, Measured] | None = None
        self._path = self.folder / logs.LOG_NAME
        self._known = self._file_hash()  # of the saved log that this session knows
        if log is not None:
            self._replay(log)
        elif self._known is not None:
            self._resume()

    @property
    def state(self) -> State:
        """Return the roots and voxels after the corrections."""
        return self._states[-1]

    @property
    def solid(self) -> Solid:
        """Return the voxels after the corrections, whose volume is divided among the roots."""
        with self._dividing:
            if self._divided is None:
                self._divided = Solid.of(self.leaves, self._sources, finest_mm=self._finest_mm)
                self._states[0] = states.resize(self._states[0], self._divided)  # roots may lie outside the voxels of the result
            return self._divided.first(voxels=len(self.state.gone), sources=self.state.sources)

    @property
    def can_undo(self) -> bool:
        """Return whether there is a correction to undo."""
        return len(self._states) > 1

    @property
    def can_redo(self) -> bool:
        """Return whether there is an undone correction to redo."""
        return bool(self._undone)

    def do(self, edit: Edit) -> State:
        """Apply a correction and discard the corrections that were undone.

        Raises
        ------
        UserError
            If the correction cannot be applied. The result is then unchanged.
        """
        with self.lock:
            self._apply(edit)
            self._undone.clear()
            return self.state

    def undo(self) -> State:
        """Undo the last correction and return the new state."""
        with self.lock:
            if self.can_undo:
                self._undone.append((self.log.edits[-1], self._states.pop()))
                self.log = replace(self.log, edits=self.log.edits[:-1])
            return self.state

    def redo(self) -> State:
        """Redo the correction that was undone last and return the new state."""
        with self.lock:
            if self._undone:
                edit, state = self._undone.pop()
                self._states.append(state)
                self.log = replace(self.log, edits=(*self.log.edits, edit))
            return self.state

    def measure(self) -> Measured:
        """Return the volume and length after the corrections."""
        with self.lock:
            now = self.state
            if self._measured is None or self._measured[0] is not now:
                if self.can_undo:
                    solid = self.solid
                    volumes = solid.volumes_mm3(now.pieces, now.gone)
                    total = float(volumes.sum())
                else:
                    solid = self._undivided if self._divided is None else self.solid
                    volumes = solid.measured_mm3
                    total = float(self._undivided.measured_mm3.sum())
                self._measured = now, Measured(total, now.length_mm, len(now.lines), volumes, solid)
            return self._measured[1]

    @property
    def unsaved(self) -> int:
        """Return the number of corrections in which the current log and the saved log differ."""
        return sum(a is not b for a, b in zip_longest(self.log.edits, self._saved))

    def save(self) -> Path:
        """Write the log of corrections to the result's folder and return its path. The result itself is not changed.

        Raises
        ------
        UserError
            If another session has saved corrections since this session was opened, or the folder is temporary.
        """
        with self.lock:
            if self._temporary:
                raise UserError(
                    "the result exists only in memory; save it first with result.save(folder), then correct it in rt.view(folder)"
                )
            if self._file_hash() not in (self._known, None):
                raise UserError(f"{self._path} was changed by another session; move it before you save, or open the result again")
            logs.write(self._path, self.log, follow=False)
            self._saved, self._known = self.log.edits, self._file_hash()
            return self._path

    def _file_hash(self) -> str | None:
        """Return the hash of the saved log. It is None if there is no saved log."""
        return file_sha256(self._path) if self._path.is_file() else None

    def _resume(self) -> None:
        """Apply the saved corrections."""
        try:
            self._replay(logs.read(self._path, self.folder))
        except UserError as error:
            raise UserError(
                f"the saved corrections cannot be applied ({error}); move {self._path} to open the result without them"
            ) from None
        self._saved = self.log.edits

    def _replay(self, log: Log) -> None:
        for edit in log.edits:
            self._apply(edit)

    def _apply(self, edit: Edit) -> None:
        solid = self.solid  # without the tubes of corrections that were undone, which a replayed log does not contain
        self._states.append(states.apply(self.state, edit, solid, refit=self._refit))
        self._divided = solid
        self.log = replace(self.log, edits=(*self.log.edits, edit))
