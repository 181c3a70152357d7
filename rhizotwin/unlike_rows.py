"""Detection of damage in pictures whose file format has no checksum.

A picture is damaged if rows of its pixels differ from those in all other pictures of the ring.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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


@dataclass(frozen=True)
class Unlike:
    """Picture in which some rows differ from those of all other pictures of the ring."""

    name: str
    """File name of the picture."""
    first: int
    """Index of the first deviating row."""
    last: int
    """Index of the last deviating row."""


class Turn:
    """Compares the pictures of one ring.

    Only a subset of the columns of each picture is stored.
    """

    def __init__(self) -> None:
        self._names: list[str] = []
        self._rows: list[Grey] = []

    def add(self, name: str, grey: Grey) -> None:
        """Add a picture (H, W).

        All pictures must have the same size and bit depth.
        """
        self._names.append(name)
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

    def unlike(self) -> list[Unlike]:
        """Return the pictures in which some rows differ from those of all other pictures."""
        if not self.enough:
            return []
        found = []
        for name, excess in zip(self._names, self.excess(), strict=True):
            rows = np.flatnonzero(excess > MORE)
            if rows.size and (excess > MORE).mean() < WHOLE:
                found.append(Unlike(name, int(rows[0]), int(rows[-1])))
        return found
