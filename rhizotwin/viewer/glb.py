"""Write coloured triangle meshes as binary glTF 2.0, which browsers display without conversion.

The file contains a single mesh with normals and a rough, non-metallic material that is visible from the front only. A
separate writer is used because small files are drawn fastest. Specification:
https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, sections 3.7 and 4.4.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.transfer import SRGB

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Index = NDArray[np.int64]

_MAGIC, _VERSION, _JSON, _BINARY = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
"""Constants of the binary container (glTF sections 4.4.2 and 4.4.3)."""
_FLOAT, _BYTE, _UNSIGNED = 5126, 5121, 5125
_VERTICES, _FACES = 34962, 34963
"""Component types and buffer targets (glTF section 3.6.2)."""
_MATTE = {"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}}
_TRANSLUCENT = _MATTE | {"alphaMode": "BLEND"}
_UNLIT = {"alphaMode": "BLEND", "extensions": {"KHR_materials_unlit": {}}}
"""Material of large transparent surfaces. It is not lit, because software renders it in a fifth of the time of a lit
material."""


@dataclass(frozen=True)
class Triangles:
    """Triangle mesh with normals and colours."""

    vertices_mm: Array
    """Vertices (N, 3), mm."""
    normals: Array
    """Outward unit normals at the vertices (N, 3)."""
    faces: Index
    """Vertex indices of the faces (F, 3), counter-clockwise as seen from outside."""
    colours: Bytes
    """Colours of the vertices, sRGB, 0 to 255: (N, 3), or (N, 4) with opacity."""


def concatenate(parts: Sequence[Triangles]) -> Triangles:
    """Concatenate several meshes into a single mesh."""
    first = np.cumsum([0, *(len(part.vertices_mm) for part in parts[:-1])])
    return Triangles(
        np.concatenate([part.vertices_mm for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, first, strict=True)]),
        np.concatenate([part.colours for part in parts]),
    )


def glb(triangles: Triangles, *, lit: bool = True) -> bytes:
    """Convert triangles to a binary glTF file.

    Parameters
    ----------
    triangles : Triangles
        Mesh with at least one triangle. Colours with opacity are blended with the background.
    lit : bool
        Whether the surface is lit. Unlit surfaces are always blended with the background.

    Returns
    -------
    bytes
        Content of the file.
    """
    points, colours = np.ascontiguousarray(triangles.vertices_mm, "<f4"), triangles.colours
    opacity = colours[:, 3:] if colours.shape[1] == 4 else np.full((len(colours), 1), 255, np.uint8)
    linear = np.rint(255.0 * SRGB.of(colours[:, :3] / 255.0)).astype(np.uint8)  # glTF stores linear vertex colours
    parts: list[tuple[NDArray[Any], int, str, int]] = [
        (points, _FLOAT, "VEC3", _VERTICES),
        (np.ascontiguousarray(triangles.normals, "<f4"), _FLOAT, "VEC3", _VERTICES),
        (np.ascontiguousarray(np.hstack([linear, opacity])), _BYTE, "VEC4", _VERTICES),
        (np.ascontiguousarray(triangles.faces.ravel(), "<u4"), _UNSIGNED, "SCALAR", _FACES),
    ]
    views, accessors, at = [], [], 0
    for place, (part, component, kind, use) in enumerate(parts):
        views.append({"buffer": 0, "byteOffset": at, "byteLength": part.nbytes, "target": use})
        accessors.append({"bufferView": place, "componentType": component, "count": len(part), "type": kind})
        at += part.nbytes
    accessors[0] |= {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
    accessors[2]["normalized"] = True
    drawn = {"attributes": {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}, "indices": 3, "material": 0}
    text = json.dumps(
        {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [drawn]}],
            "extensionsUsed": ["KHR_materials_unlit"],
            "materials": [_UNLIT if not lit else _TRANSLUCENT if colours.shape[1] == 4 else _MATTE],
            "buffers": [{"byteLength": at}],
            "bufferViews": views,
            "accessors": accessors,
        }
    ).encode()
    text += b" " * (-len(text) % 4)
    data = b"".join(part.tobytes() for part, *_ in parts)  # the length of each part is a multiple of four bytes
    body = struct.pack("<II", len(text), _JSON) + text + struct.pack("<II", len(data), _BINARY) + data
    return struct.pack("<III", _MAGIC, _VERSION, 12 + len(body)) + body
