"""Tables A.1 and 4.1 of Kliman's thesis (2022), and results of its simulated plants, which are part of the package."""

import shutil
from importlib.resources import files
from pathlib import Path

from rhizotwin.scenes import atomic
from rhizotwin.scenes.folders import new_folder

SHIPPED = ("kliman_2022_masses.csv", "kliman_2022_volumes.csv")
"""Names of the files with tables A.1 and 4.1 of Kliman's thesis. The first lines of each file state its source."""

EXAMPLE = "eighteen_plants.tar.xz"
"""Name of the archive with the results of the thesis's plants, simulated and reconstructed by
``examples/eighteen_plants/make.py``."""


def shipped(name: str) -> Path:
    """Return the path of one of the thesis's tables (`SHIPPED`), or of the example (`EXAMPLE`)."""
    return Path(str(files(__package__).joinpath("data", name)))


def write_shipped(folder: Path) -> list[Path]:
    """Write the thesis's tables to a folder and return their paths. Existing files are not replaced."""
    written = []
    for name in SHIPPED:
        atomic.write_text(folder / name, shipped(name).read_text(encoding="utf-8"), new=True)
        written.append(folder / name)
    return written


def write_example(folder: Path) -> None:
    """Write the results of the thesis's eighteen plants, and the table of their masses, to a new or empty folder.

    Raises
    ------
    UserError
        If the folder is not empty or cannot be written.
    """
    with new_folder(folder) as building:
        shutil.unpack_archive(shipped(EXAMPLE), building, filter="data")
        atomic.write_bytes(building / "masses.csv", shipped(SHIPPED[0]).read_bytes())
