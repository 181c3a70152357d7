"""Write a result to a folder, without loss of the dataset, of other files or of manual corrections."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Self

from rhizotwin.recon.results import result as reconstructed
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import contents, new_folder, recover
from rhizotwin.stored.result_files import RESULT_NAMES

STAGES = "stages"
"""Name of the folder of intermediate results in a result folder, which may be written before the result."""


class Result(reconstructed.Result):
    """Result of a reconstruction, as returned by the Python interface.

    The method `save` writes it to a folder, from which `rhizotwin.load_result` reads it.
    """

    @classmethod
    def of(cls, found: reconstructed.Result) -> Self:
        """Return a result of the reconstruction as a result of the Python interface."""
        return cls(**{one.name: getattr(found, one.name) for one in fields(found)})

    def save(self, folder: Path | str) -> None:
        """Write the result to a folder, which then contains either the complete result or what it contained before.

        Parameters
        ----------
        folder : path
            Folder that is new or empty, or contains an earlier result without manual corrections, which is replaced.
            Its subfolder ``stages`` is kept.

        Raises
        ------
        UserError
            If the folder contains other files, such as a dataset or manual corrections, or cannot be written.
        """
        folder = Path(folder)
        with new_result(folder, source=Path(self.dataset) if self.dataset else None, also=(STAGES,)) as building:
            if (folder / STAGES).is_dir():
                shutil.copytree(folder / STAGES, building / STAGES)
            self.write(building)
            self.illustrate(building)

    def illustrate(self, folder: Path) -> None:
        """Add pictures and the report to the files of the result. The Python interface overrides this method."""

    def write(self, folder: Path) -> None:
        """Write the files of the result to a folder that the caller has prepared with `new_result`."""
        super().save(folder)


@contextmanager
def new_result(folder: Path, *, source: Path | None, also: tuple[str, ...] = ()) -> Iterator[Path]:
    """Build a result folder atomically, see `scenes.folders.new_folder`.

    Parameters
    ----------
    folder, source, also : Path, Path or None, tuple of str
        Arguments of `check_place`.

    Yields
    ------
    Path
        Folder inside ``folder``, into which the caller writes the result.

    Raises
    ------
    UserError
        If the folder cannot be used, see `check_place`, or cannot be written.
    """
    check_place(folder, source, also=also)
    with new_folder(folder, replaces=RESULT_NAMES) as building:
        yield building


def check_place(folder: Path, source: Path | None, *, also: tuple[str, ...] = ()) -> None:
    """Check that a result can be written to a folder without overwriting files other than an earlier result.

    A folder that an interrupted run has left behind is restored first.

    Parameters
    ----------
    folder : Path
        Output folder for the result.
    source : Path or None
        Input folder: dataset or result; None if it is unknown.
    also : tuple of str
        Names that may be in the folder although it contains no result.

    Raises
    ------
    UserError
        If other files or the input would be overwritten.
    """
    recover(folder)
    there = contents(folder)
    if set(there).difference(also) and not (folder / "result.json").is_file():
        raise UserError(f"the folder {folder} is not empty and is not a result; choose a new folder for the result")
    strange = [name for name in there if name not in RESULT_NAMES]
    if strange:
        raise UserError(f"{folder} contains {strange[0]}, which would be deleted with the earlier result; move it or choose a new folder")
    if source is not None and (folder.resolve() == source.resolve() or folder.resolve() in source.resolve().parents):
        raise UserError(f"the result would overwrite its input {source}; choose another folder for the result")
