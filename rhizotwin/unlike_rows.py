"""Rows of a picture that no other picture of its turn has: what damage looks like where a file has no checksum."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.picture_codec import Grey

COLUMNS = 256
"""About so many columns of each picture are kept."""
LEAST = 5
"""With fewer pictures nobody can tell which of them is the one that is wrong."""
OTHER = 0.15
"""A pixel is another one when it differs from the median over the turn by this share of the bright panel."""
NEAR = 2
"""A picture may be a little higher or lower: rows so near to a row count as that row."""
MORE = 0.2
"""Share of a row's pixels that must be other ones beyond what any other picture has there. In 1,600 whole pictures of
the accuracy ladder and of a real rig nothing came above 0.11, with 5 views a turn above 0.14."""
WHOLE = 0.95
"""With more rows than that the light was another one, and the reconstruction's checks tell."""


@dataclass(frozen=True)
class Unlike:
    """Where a picture is like no other."""

    name: str
    first: int
    last: int


class Turn:
    """Collects the pictures of one ring, a few columns of each."""

    def __init__(self) -> None:
        self._names: list[str] = []
        self._rows: list[Grey] = []

    def add(self, name: str, grey: Grey) -> None:
        """Keep some columns of a picture (H, W); all pictures have one size and depth."""
        self._names.append(name)
        self._rows.append(np.ascontiguousarray(grey[:, :: max(1, grey.shape[1] // COLUMNS)]))

    @property
    def enough(self) -> bool:
        """Whether there are enough pictures to compare."""
        return len(self._rows) >= LEAST

    def excess(self) -> NDArray[np.float64]:
        """Return (N, H), the share of other pixels in each row beyond the most that another picture has near there."""
        stack = np.stack(self._rows)
        median = np.median(stack, axis=0)
        limit = OTHER * np.percentile(median, 99.0)
        other = np.stack([(np.abs(picture - median) > limit).mean(axis=1) for picture in stack])
        padded = np.pad(other, ((0, 0), (NEAR, NEAR)), mode="edge")
        near = np.max([padded[:, k : k + other.shape[1]] for k in range(2 * NEAR + 1)], axis=0)
        order = np.sort(near, axis=0)
        most = np.where(near == order[-1], order[-2], order[-1])  # of the others
        return np.asarray(other - most)

    def unlike(self) -> list[Unlike]:
        """Return the pictures with rows that are like no other picture's."""
        if not self.enough:
            return []
        found = []
        for name, excess in zip(self._names, self.excess(), strict=True):
            rows = np.flatnonzero(excess > MORE)
            if rows.size and (excess > MORE).mean() < WHOLE:
                found.append(Unlike(name, int(rows[0]), int(rows[-1])))
        return found
