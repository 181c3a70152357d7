"""What a person who studies the reconstruction may set; everything else is derived, or stands beside what it is for."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.limits import bounded
from rhizotwin.scenes.schema import Place, from_plain


@dataclass(frozen=True, kw_only=True)
class HullSettings:
    """From silhouettes to a hull."""

    finest_mm: float = bounded(0.14, 0.01, 5.0)
    """Larger voxels are carved finer than this and gathered, so that their occupancy is measured and not guessed."""
    slack_px: float = bounded(0.3, 0.0, 5.0)
    """By how much outlines are moved in and out for the silhouette-consistent bounds."""


@dataclass(frozen=True, kw_only=True)
class RootSettings:
    """When roots are sought as tubes: where much of the trimmed hull is untrimmed and small, or much of what is seen is missed.

    Thin roots are hull (60 %) of small leaves (95 %); a print is trimmed (3 % hull); a solid body is hull, but of large leaves (14 %
    small). Translucent roots of five days that no resolved root told to be so leave a half of their coverage, a print with felt fibres
    about it 1 %.
    """

    least_untrimmed: float = bounded(0.3, 0.0, 1.0)
    """Share of the trimmed volume that is hull still ..."""
    least_finest: float = bounded(0.7, 0.0, 1.0)
    """... and share of it in leaves of the finest size."""
    least_missed: float = bounded(0.3, 0.0, 1.0)
    """Or share of the pictures' coverage before which no trimmed hull stands: roots too faint for any hull."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a reconstruction, a group for each stage."""

    voxel_mm: float = bounded(0.27, 0.01, 20.0)
    """Edge of the voxels that are written (0.27: the thesis's); measuring inside them is finer."""
    hull: HullSettings = field(default_factory=HullSettings)
    roots: RootSettings = field(default_factory=RootSettings)


def load_settings(file: Path | str) -> Settings:
    """Load settings from a TOML file; what it leaves out has its default.

    Raises
    ------
    UserError
        Where the file is missing or damaged, or holds an unknown key or a value beyond its limits.
    """
    path = Path(file)
    if not path.is_file():
        raise UserError(f"{path}: there is no such file; give the settings as TOML, such as `voxel_mm = 0.2`")
    try:
        text = path.read_text(encoding="utf-8")
        mapping = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # no UTF-8, no TOML, or integers of thousands of digits
        raise UserError(f"{path} is not readable TOML: {error}") from None
    return from_plain(Settings, mapping, Place(str(path), text))
