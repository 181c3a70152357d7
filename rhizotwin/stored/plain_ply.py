"""Fast reader for the PLY files of results."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_HEADER = re.compile(
    rb"ply\nformat binary_little_endian 1\.0\n(?:comment [^\n]*\n)*element vertex (\d{1,9})\nproperty float x\nproperty float y\n"
    rb"property float z\nelement face (\d{1,9})\nproperty list uchar u?int vertex_ind(?:ices|ex)\nend_header\n"
)
"""Regular expression of the header that trimesh writes: single-precision vertices, and triangles (PLY, G. Turk
1994)."""
_LONGEST = 1000
"""Maximum length of a header, bytes. Headers of results have 250 bytes."""
_FACE = np.dtype([("corners", "u1"), ("vertices", "<i4", 3)])
"""Binary format of a face: number of corners (3) and vertex indices."""


def read(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]] | None:
    """Return vertices (V, 3) and triangles (F, 3) of a PLY file.

    Return None if the header or the size of the file differs from that of a result.
    """
    with path.open("rb") as stream:
        header = _HEADER.match(stream.read(_LONGEST))
        if header is None:
            return None
        vertices, faces = int(header[1]), int(header[2])
        if path.stat().st_size != header.end() + vertices * 12 + faces * _FACE.itemsize:
            return None
        stream.seek(header.end())
        points = np.fromfile(stream, "<f4", 3 * vertices)
        found = np.fromfile(stream, _FACE, faces)
    if (found["corners"] != 3).any():
        return None
    return points.reshape(-1, 3).astype(np.float64), found["vertices"].astype(np.int64)
