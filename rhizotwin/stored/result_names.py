"""Names by which results are told apart on pages and in tables."""

import os
from collections.abc import Sequence
from pathlib import Path


def names_of(folders: Sequence[Path]) -> list[str]:
    """Return the name of each result's folder. If several names are equal, the folders above are prepended."""
    parts = [Path(os.path.abspath(folder)).parts for folder in folders]  # noqa: PTH100 - links keep their names

    def is_unique(part: tuple[str, ...], depth: int) -> bool:
        return all(other == part or other[-depth:] != part[-depth:] for other in parts)

    depths = [next((depth for depth in range(1, len(part)) if is_unique(part, depth)), 1) for part in parts]
    return ["/".join(part[-depth:]) for part, depth in zip(parts, depths, strict=True)]
