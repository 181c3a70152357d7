"""Exact distance transforms of pictures and of sparse sets of cells.

Distances are found line by line, one axis after another, as the lower envelope of parabolas (Meijster, Roerdink and
Hesselink 2000, in Mathematical Morphology and its Applications to Image and Signal Processing, p. 331). A line is
divided into runs of samples of the same kind. Nothing beyond the ends of a run can be nearer than its ends, so that
each run is processed on its own.
"""

from __future__ import annotations

from math import floor

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.lattice.compiled import compiled

Image = NDArray[np.float32]

_NONE = np.int64(-1)
"""Squared distance of a sample in whose line no sample of the other kind was found yet."""
_FAR = 1e4
"""Distance from the level of a picture that it does not cross, in samples."""


@compiled
def _envelope(square: NDArray[np.int64], begin: int, end: int, vertex: NDArray[np.int64], first: NDArray[np.int64]) -> int:
    """Find the parabola that is lowest at each sample of a run.

    Of equally low parabolas, the first one is used.

    Parameters
    ----------
    square : (W,) int64 array
        Lowest value of the parabola of each sample of the line. It is zero at the two samples beside the run.
    begin, end : int
        First sample of the run, and the one after its last sample.
    vertex, first : (W,) int64 array
        Written: sample of each parabola of the envelope, and first sample at which it is the lowest.

    Returns
    -------
    int
        Number of parabolas of the envelope.
    """
    count = 0
    for u in range(max(begin - 1, 0), min(end + 1, len(square))):
        if square[u] == _NONE:
            continue
        while count > 0:
            at, other = first[count - 1], vertex[count - 1]
            if (at - other) ** 2 + square[other] <= (at - u) ** 2 + square[u]:
                break
            count -= 1
        at = begin
        if count > 0:
            other = vertex[count - 1]
            at = 1 + floor((u * u - other * other + square[u] - square[other]) / (2.0 * (u - other)))
        if at < end:
            vertex[count], first[count] = u, at
            count += 1
    return count


@compiled
def level_distance(value: Image) -> Image:
    """Return the signed distance (H, W) to the zero level of a picture, in samples.

    The distance is positive where the value is positive, and accurate to first order near the level. Elsewhere, it is
    the distance to the nearest sample of the other sign, less the distance of this sample from the level, and at least
    half a sample. Of several samples that are equally near, the one in the first column, and then in the first row, is
    used. Without samples of the other sign, the distance is `_FAR`.
    """
    rows, columns = value.shape
    near, above = _edge_distance(value), np.zeros((rows, columns), np.int64)
    for i in range(1, rows):
        for j in range(columns):
            if (value[i, j] > 0) != (value[i - 1, j] > 0):
                above[i, j] = 1
            elif above[i - 1, j] > 0:
                above[i, j] = above[i - 1, j] + 1
    below, step, square = np.zeros(columns, np.int64), np.zeros(columns, np.int64), np.zeros(columns, np.int64)
    vertex, first = np.zeros(columns, np.int64), np.zeros(columns, np.int64)
    distance = np.empty((rows, columns), np.float32)
    for i in range(rows - 1, -1, -1):
        begin = 0
        for j in range(columns):
            if i + 1 < rows and (value[i, j] > 0) != (value[i + 1, j] > 0):
                below[j] = 1
            elif below[j] > 0:
                below[j] += 1
            step[j] = below[j] if below[j] > 0 and not 0 < above[i, j] <= below[j] else -above[i, j]
        while begin < columns:
            end = begin
            while end < columns and (value[i, end] > 0) == (value[i, begin] > 0):
                square[end] = step[end] ** 2 if step[end] != 0 else _NONE
                end += 1
            for beside in (begin - 1, end):
                if 0 <= beside < columns:
                    square[beside] = 0
            k = _envelope(square, begin, end, vertex, first) - 1
            for j in range(end - 1, begin - 1, -1):
                found = near[i, j]
                if k < 0:
                    found = np.float32(_FAR)
                elif found == 0.0:
                    at = vertex[k]
                    row = i + step[at] if begin <= at < end else i
                    found = max(np.sqrt(np.float32((j - at) ** 2 + square[at])) - near[row, at], np.float32(0.5))
                distance[i, j] = found if value[i, j] > 0 else -found
                if k >= 0 and j == first[k]:
                    k -= 1
            begin = end
    return distance


@compiled
def _edge_distance(value: Image) -> Image:
    """Return the distance (H, W) from samples next to the level to the level, in samples, and 0 for all others."""
    rows, columns = value.shape
    distance = np.zeros((rows, columns), np.float32)
    for i in range(rows):
        for j in range(columns):
            inverse_2 = np.float32(0.0)
            for down, right in ((1, 0), (0, 1)):
                nearest = np.float32(np.inf)
                for side in (-1, 1):
                    k, m = i + side * down, j + side * right
                    if 0 <= k < rows and 0 <= m < columns and (value[k, m] > 0) != (value[i, j] > 0):
                        total = max(abs(value[i, j]) + abs(value[k, m]), np.float32(1e-9))
                        nearest = min(nearest, abs(value[i, j]) / total)
                inverse_2 += np.float32(1.0) / max(nearest, np.float32(1e-3)) ** 2
            if inverse_2 > 0.0:
                distance[i, j] = np.float32(1.0) / np.sqrt(inverse_2)
    return distance


def depth(index: NDArray[np.integer]) -> NDArray[np.float64]:
    """Return the distance (N,) of each cell (N, 3) of a set from the nearest empty cell, in cells."""
    low = index.min(axis=0, initial=0)
    place = index.astype(np.int64) - low
    span = place.max(axis=0, initial=0) + 2  # consecutive numbers are neighbours on one line
    square = np.full(len(index), _NONE)
    for x, y, z in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
        number = (place[:, x] * span[y] + place[:, y]) * span[z] + place[:, z]
        order = np.argsort(number)
        _shorten(number[order], order, square)
    return np.sqrt(square)


@compiled
def _shorten(number: NDArray[np.int64], order: NDArray[np.int64], square: NDArray[np.int64]) -> None:
    """Replace the squared distance of each cell by that to the nearest empty cell along one more axis.

    Parameters
    ----------
    number : (N,) int64 array
        Numbers of the cells in ascending order. Neighbours along the axis have consecutive numbers.
    order : (N,) int64 array
        Index of each of these cells in ``square``.
    """
    line, vertex, first = np.zeros((3, len(number) + 2), np.int64)
    begin = 0
    while begin < len(number):
        end = begin + 1
        while end < len(number) and number[end] == number[end - 1] + 1:
            end += 1
        count = end - begin
        for k in range(count):
            line[k + 1] = square[order[begin + k]]
        line[0] = line[count + 1] = 0
        k = _envelope(line[: count + 2], 1, count + 1, vertex, first) - 1
        for at in range(count, 0, -1):
            square[order[begin + at - 1]] = (at - vertex[k]) ** 2 + line[vertex[k]]
            if at == first[k]:
                k -= 1
        begin = end
