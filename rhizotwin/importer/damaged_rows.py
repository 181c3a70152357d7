"""Detection of damage in pictures whose file format has no checksum.

A picture is damaged if rows of its pixels differ from those in all other pictures of the ring.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.picture_codec import Grey

COLUMNS = 256
"""Approximate number of columns per picture that are compared."""
LEAST = 5
"""Minimum number of pictures in a ring that are compared. With fewer pictures, the one that deviates from the others
could not be identified."""
OTHER = 0.15
"""Difference above which a pixel deviates from the other pictures. It is the absolute difference from the median over
the ring, relative to the brightness of the panel."""
NEAR = 2
"""A row is also compared with this number of rows above it and below it in other pictures. They allow for small
vertical shifts between pictures."""
MORE = 0.2
"""Minimum difference between the fraction of deviating pixels in a damaged row, and the largest such fraction in any
other picture.

In 1,600 intact pictures of the accuracy ladder and of a real rig the difference was at most 0.11, and at most 0.14 with
5 views in a ring.
"""
WHOLE = 0.95
"""Maximum fraction of damaged rows in a damaged picture. A larger fraction indicates that the illumination has changed,
which the checks of the reconstruction detect."""

Similar: TypeAlias = tuple[int, str, bool]
"""Ring and band of a picture, and whether its rows are stored as rows. Pictures that agree in them are similar, and
are compared with each other."""


@dataclass(frozen=True)
class DamagedRows:
    """Rows of a picture that differ from those of all other pictures of the ring."""

    path: Path
    """Picture file."""
    first: int
    """Index of the first deviating row."""
    last: int
    """Index of the last deviating row."""


class RingPictures:
    """Pictures of one ring and band, which are compared with each other.

    Only a subset of the columns of each picture is stored.
    """

    def __init__(self) -> None:
        self._paths: list[Path] = []
        self._rows: list[Grey] = []

    def add(self, path: Path, grey: Grey) -> None:
        """Add a picture (H, W).

        All pictures must have the same size and bit depth.
        """
        self._paths.append(path)
        self._rows.append(np.ascontiguousarray(grey[:, :: max(1, grey.shape[1] // COLUMNS)]))

    @property
    def enough(self) -> bool:
        """Whether the ring has enough pictures for the comparison."""
        return len(self._rows) >= LEAST

    def excess(self) -> NDArray[np.float64]:
        """Return the excess fraction (N, H) of deviating pixels in each row of each picture.

        The excess is the fraction of deviating pixels in the row, minus the largest such fraction in nearby rows of any
        other picture.
        """
        stack = np.stack(self._rows)
        median = np.median(stack, axis=0)
        limit = OTHER * np.percentile(median, 99.0)
        other = np.stack([(np.abs(picture - median) > limit).mean(axis=1) for picture in stack])
        padded = np.pad(other, ((0, 0), (NEAR, NEAR)), mode="edge")
        near = np.max([padded[:, k : k + other.shape[1]] for k in range(2 * NEAR + 1)], axis=0)
        order = np.sort(near, axis=0)
        most = np.where(near == order[-1], order[-2], order[-1])  # maximum over the other pictures
        return np.asarray(other - most)

    def find_damaged(self) -> list[DamagedRows]:
        """Return the deviating rows of each picture that has any. The result is empty if there are too few pictures."""
        if not self.enough:
            return []
        found = []
        for path, excess in zip(self._paths, self.excess(), strict=True):
            rows = np.flatnonzero(excess > MORE)
            if rows.size and (excess > MORE).mean() < WHOLE:
                found.append(DamagedRows(path, int(rows[0]), int(rows[-1])))
        return found


class DamageCheck:
    """Detects damage in pictures whose file format has no checksum.

    Each picture is compared with the other pictures of the same ring and band.
    """

    def __init__(self) -> None:
        self._rings: dict[Similar, RingPictures] = {}
        self._unsealed: dict[Path, Similar] = {}  # pictures without a checksum

    def add(self, path: Path, ring: tuple[int, str], grey: Grey, *, sealed: bool, orientation: int = 1) -> None:
        """Add a picture to the pictures of its ring.

        Parameters
        ----------
        path : Path
            Picture file.
        ring : tuple of int and str
            Ring and band of the picture.
        grey : (H, W) uint8 or uint16 array
            Decoded picture.
        orientation : int
            Orientation tag, by which the picture has been turned. Damaged are rows of the stored picture.
        sealed : bool
            Whether the file format has a checksum, so that damage would already have been detected.
        """
        is_upright = orientation < 5
        similar = (*ring, is_upright)
        self._rings.setdefault(similar, RingPictures()).add(path, grey if is_upright else grey.T)
        if not sealed:
            self._unsealed[path] = similar

    def refuse_damaged(self) -> None:
        """Raise an error if a picture without a checksum is damaged.

        Raises
        ------
        UserError
            If rows of the picture differ from those of all other pictures.
        """
        for ring in sorted(set(self._unsealed.values())):
            for found in self._rings[ring].find_damaged():
                if found.path in self._unsealed:
                    raise UserError(
                        f"{found.path}: rows {found.first} to {found.last} differ from all other pictures, which "
                        "indicates damage. Copy or take the picture again, or remove it; if the picture is correct, convert it to "
                        "PNG, whose checksum replaces this test"
                    )

    def notes(self) -> list[str]:
        """Return notes about pictures that could not be checked for damage."""
        if not self._unsealed:
            return []
        apart = sum(not self._rings[ring].enough for ring in self._unsealed.values())
        but = "damage of less than a fifth of a row cannot be detected"
        if apart:
            but += f", and {apart} of them could not be compared, because their ring has fewer than {LEAST} pictures"
        return [
            f"{len(self._unsealed)} pictures have a format without a checksum (JPEG, TIFF with LZW, PackBits or no compression), so {but}. "
            "In PNG, and in TIFF with Deflate, any damage is detected"
        ]
