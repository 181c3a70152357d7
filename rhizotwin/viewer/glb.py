"""Coloured triangles as binary glTF 2.0, which browsers draw at once.

Written here because the smallest file says what matters for speed: one mesh, rough and not metallic, normals given,
seen from its front only. https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, sections 3.7 and 4.4.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Index = NDArray[np.int64]

_MAGIC, _VERSION, _JSON, _BINARY = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
"""Section 4.4.2 and 4.4.3."""
_FLOAT, _BYTE, _UNSIGNED = 5126, 5121, 5125
_VERTICES, _FACES = 34962, 34963
"""Section 3.6.2: component types and what a buffer is for."""
_MATT = {"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}}
_GLASS = {"alphaMode": "BLEND", "extensions": {"KHR_materials_unlit": {}}}
"""What fills the screen is not lit: software then draws it in a fifth of the time."""


def glb(vertices_mm: Array, normals: Array, faces: Index, colours: Bytes, *, see_through: bool = False) -> bytes:
    """Return triangles as a binary glTF file.

    Parameters
    ----------
    vertices_mm : (N, 3) float64 array
    normals : (N, 3) float64 array
        Outward, of unit length.
    faces : (F, 3) int64 array
        Counter-clockwise from where they are seen.
    colours : (N, 3) or (N, 4) uint8 array
        As a screen shows them, with opacity where there is a fourth column.
    see_through : bool
        Let what lies behind show through, as the opacity says.

    Returns
    -------
    bytes
        The file.
    """
    points = np.ascontiguousarray(vertices_mm, "<f4")
    opacity = colours[:, 3:] if colours.shape[1] == 4 else np.full((len(colours), 1), 255, np.uint8)
    parts: list[tuple[NDArray[Any], int, str, int]] = [
        (points, _FLOAT, "VEC3", _VERTICES),
        (np.ascontiguousarray(normals, "<f4"), _FLOAT, "VEC3", _VERTICES),
        (np.ascontiguousarray(np.hstack([_linear(colours[:, :3]), opacity])), _BYTE, "VEC4", _VERTICES),
        (np.ascontiguousarray(faces.ravel(), "<u4"), _UNSIGNED, "SCALAR", _FACES),
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
            "materials": [_GLASS if see_through else _MATT],
            "buffers": [{"byteLength": at}],
            "bufferViews": views,
            "accessors": accessors,
        }
    ).encode()
    text += b" " * (-len(text) % 4)
    data = b"".join(part.tobytes() for part, *_ in parts)  # each a multiple of four bytes
    body = struct.pack("<II", len(text), _JSON) + text + struct.pack("<II", len(data), _BINARY) + data
    return struct.pack("<III", _MAGIC, _VERSION, 12 + len(body)) + body


def _linear(colours: Bytes) -> Bytes:
    """Return colours (N, 3) linear in light, as glTF keeps those of vertices (IEC 61966-2-1)."""
    value = np.arange(256) / 255.0
    light = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.round(255.0 * light)[colours], np.uint8)
