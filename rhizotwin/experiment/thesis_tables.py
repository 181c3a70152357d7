"""Tables A.1 and 4.1 of Kliman's thesis (2022), which are part of the package."""

from importlib.resources import files
from pathlib import Path

from rhizotwin.scenes import atomic

SHIPPED = ("kliman_2022_masses.csv", "kliman_2022_volumes.csv")
"""Names of the files with tables A.1 and 4.1 of Kliman's thesis. The first lines of each file state its source."""


def shipped(name: str) -> Path:
    """Return the path of one of the thesis's tables (`SHIPPED`)."""
    return Path(str(files(__package__).joinpath("data", name)))


def write_shipped(folder: Path) -> list[Path]:
    """Write the thesis's tables to a folder and return their paths. Existing files are not replaced."""
    written = []
    for name in SHIPPED:
        atomic.write_text(folder / name, shipped(name).read_text(encoding="utf-8"), new=True)
        written.append(folder / name)
    return written
