"""Contents of voxel files for other programs: NRRD, NIfTI, VTK and TIFF stacks, with sizes and positions in mm."""

from __future__ import annotations

import gzip
import io
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import nrrd
import numpy as np
import tifffile
from numpy.typing import NDArray

from rhizotwin.recon.hull.surface import paint
from rhizotwin.recon.results.parts import Leaves

MOST_VOXELS = 1_500_000_000
"""Maximum size, in bytes, of the array of voxels that is written to a file."""
_SLAB = 64
"""Number of horizontal layers that are converted at once, to limit the memory of floats."""
_NIFTI = struct.Struct("<i36x8h14x2h2x8f3f3xB24x80s24x2h3f3f12f16x4s4x")
"""Header of a NIfTI-1 file, and four bytes that state that no extension follows (nifti1.h, R. Cox 2007). The fields are
sizeof_hdr, dim, datatype, bitpix, pixdim, vox_offset, scl_slope, scl_inter, xyzt_units, descrip, qform_code,
sform_code, quatern, qoffset, srow and magic."""
_UINT8, _MM, _SCANNER = 2, 2, 1
"""Codes of NIfTI for bytes, millimetres and coordinates of the device."""
_CONTENT = "root occupancy, 0 to 255, canister frame (mm, z up)"


@dataclass(frozen=True)
class Block:
    """Occupancies of all voxels in the bounding box of a shape."""

    values: NDArray[np.uint8]
    """Occupancies (X, Y, Z), 255 is completely occupied."""
    first_mm: NDArray[np.float64]
    """Centre of the first voxel (3,), canister frame, mm."""
    voxel_mm: float
    """Edge of a voxel, mm."""


def bounding_shape(leaves: Leaves) -> tuple[int, int, int]:
    """Return the number of voxels of the bounding box along x, y and z."""
    x, y, z = (leaves.low + leaves.size[:, None]).max(axis=0) - leaves.low.min(axis=0)
    return int(x), int(y), int(z)


def block_of(leaves: Leaves) -> Block:
    """Return the occupancies of all voxels in the bounding box of a shape."""
    low = leaves.low.min(axis=0)
    shape = bounding_shape(leaves)
    values = np.zeros(shape, np.uint8)
    for first in range(0, shape[2], _SLAB):
        part = np.zeros((shape[0], shape[1], min(_SLAB, shape[2] - first)), np.float32)
        index = leaves.low - low
        touching = (index[:, 2] < first + _SLAB) & (index[:, 2] + leaves.size > first)
        paint(part, index[touching] - np.array([0, 0, first], np.int32), leaves.size[touching], leaves.occupancy[touching])
        values[:, :, first : first + _SLAB] = np.round(part * 255.0).astype(np.uint8)
    return Block(values, leaves.origin_mm + leaves.voxel_mm * (low + 0.5), leaves.voxel_mm)


def encode_nrrd(block: Block) -> bytes:
    """Return an NRRD file. Its space has no name, so that programs use the coordinates as they are."""
    header: dict[str, Any] = {
        "space dimension": 3,
        "space units": ["mm", "mm", "mm"],
        "space directions": np.eye(3) * block.voxel_mm,
        "space origin": block.first_mm,
        "kinds": ["domain", "domain", "domain"],
        "encoding": "gzip",
        "content": _CONTENT,
    }
    written = io.BytesIO()
    nrrd.write(written, block.values, header, index_order="F")
    return written.getvalue()


def encode_nifti(block: Block) -> bytes:
    """Return a NIfTI-1 file in which x, y and z of the canister frame are right, anterior and superior."""
    header = _NIFTI.pack(
        *(348, 3, *block.values.shape, 1, 1, 1, 1, _UINT8, 8),
        *(1.0, *[block.voxel_mm] * 3, 0.0, 0.0, 0.0, 0.0),
        *(_NIFTI.size, 1.0, 0.0, _MM, _CONTENT.encode(), _SCANNER, _SCANNER),
        *(0.0, 0.0, 0.0, *block.first_mm, *np.column_stack([block.voxel_mm * np.eye(3), block.first_mm]).flat, b"n+1"),
    )
    return header + block.values.tobytes(order="F")


def encode_vtk(block: Block) -> bytes:
    """Return a legacy VTK file (structured points)."""
    lines = [
        *("# vtk DataFile Version 3.0", _CONTENT, "BINARY", "DATASET STRUCTURED_POINTS"),
        "DIMENSIONS {} {} {}".format(*block.values.shape),
        "ORIGIN {:.17g} {:.17g} {:.17g}".format(*block.first_mm),
        f"SPACING {block.voxel_mm:.17g} {block.voxel_mm:.17g} {block.voxel_mm:.17g}",
        *(f"POINT_DATA {block.values.size}", "SCALARS occupancy unsigned_char 1", "LOOKUP_TABLE default"),
    ]
    return "\n".join([*lines, ""]).encode() + block.values.tobytes(order="F")


def encode_tiff(block: Block) -> bytes:
    """Return a TIFF stack with ImageJ's description: pages from the lowest z, rows from the lowest y."""
    written = io.BytesIO()
    voxel_mm = block.voxel_mm
    origin = {f"{axis}origin": float(-first / voxel_mm) for axis, first in zip("xyz", block.first_mm, strict=True)}
    sizes = {"axes": "ZYX", "spacing": voxel_mm, "unit": "mm", **origin}
    tifffile.imwrite(
        written, np.ascontiguousarray(block.values.T), imagej=True, resolution=(1.0 / voxel_mm, 1.0 / voxel_mm), metadata=sizes
    )
    return written.getvalue()


ENCODERS: dict[str, Callable[[Block], bytes]] = {
    ".nrrd": encode_nrrd,
    ".nii": encode_nifti,
    ".nii.gz": lambda block: gzip.compress(encode_nifti(block), mtime=0),
    ".vtk": encode_vtk,
    ".tif": encode_tiff,
    ".tiff": encode_tiff,
}
"""Function that returns the content of a voxel file, by suffix."""
