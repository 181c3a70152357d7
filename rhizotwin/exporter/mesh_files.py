"""Contents of mesh files for other programs: PLY, STL, OBJ and 3MF in mm with z up, GLB in metres with y up."""

from __future__ import annotations

import io
import zipfile
from typing import TYPE_CHECKING

import numpy as np

from rhizotwin.scenes.transfer import SRGB

if TYPE_CHECKING:
    import trimesh

SUFFIXES = (".ply", ".stl", ".obj", ".3mf", ".glb")
"""Suffixes of mesh files."""
_CONTENT_TYPES = (
    '<?xml version="1.0" encoding="UTF-8"?>\n<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>\n'
)
_RELATIONSHIPS = (
    '<?xml version="1.0" encoding="UTF-8"?>\n<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    '<Relationship Id="model" Target="/3D/3dmodel.model" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>'
    "</Relationships>\n"
)
_NAMESPACES = 'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" xmlns:m="http://schemas.microsoft.com/3dmanufacturing/material/2015/02"'


def encode(mesh: trimesh.Trimesh, suffix: str) -> bytes:
    """Return the content of a mesh file.

    Parameters
    ----------
    mesh : Trimesh
        Mesh in the canister frame, mm, with or without colours of its vertices (sRGB).
    suffix : str
        One of `SUFFIXES`. STL files have no colours.
    """
    if suffix == ".3mf":
        return _encode_3mf(mesh)
    if suffix == ".glb":
        mesh = mesh.copy()
        x, y, z = np.asarray(mesh.vertices).T
        mesh.vertices = np.stack([x, z, -y], axis=1) / 1000.0
        if mesh.visual.kind == "vertex":
            colours = np.array(mesh.visual.vertex_colors)
            colours[:, :3] = np.round(255.0 * SRGB.of(colours[:, :3] / 255.0))  # glTF 2.0 requires linear colours in COLOR_0
            mesh.visual.vertex_colors = colours
    content = mesh.export(file_type=suffix[1:])
    return content.encode() if isinstance(content, str) else bytes(content)


def _encode_3mf(mesh: trimesh.Trimesh) -> bytes:
    """Return a 3MF archive (3MF Core Specification 1.3; colours by the Materials and Properties Extension).

    Trimesh 5.2 omits colours, and writes different bytes in each call.
    """
    colours = ""
    has_colours = mesh.visual.kind == "vertex"
    triangles = [f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in mesh.faces.tolist()]
    if has_colours:
        shades, index = np.unique(np.asarray(mesh.visual.vertex_colors), axis=0, return_inverse=True)
        colours = "".join(f'<m:color color="#{bytes(shade).hex().upper()}"/>' for shade in shades)
        colours = f'<m:colorgroup id="2">{colours}</m:colorgroup>'
        corners = index.ravel()[mesh.faces].tolist()
        triangles = [f'{line[:-2]} pid="2" p1="{a}" p2="{b}" p3="{c}"/>' for line, (a, b, c) in zip(triangles, corners, strict=True)]
    vertices = "".join(f'<vertex x="{x:.6f}" y="{y:.6f}" z="{z:.6f}"/>' for x, y, z in mesh.vertices.tolist())
    model = (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<model unit="millimeter" {_NAMESPACES}><resources>{colours}'
        f'<object id="1" type="model"><mesh><vertices>{vertices}</vertices><triangles>{"".join(triangles)}</triangles></mesh></object>'
        '</resources><build><item objectid="1"/></build></model>\n'
    )
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in (("[Content_Types].xml", _CONTENT_TYPES), ("_rels/.rels", _RELATIONSHIPS), ("3D/3dmodel.model", model)):
            archive.writestr(zipfile.ZipInfo(name), text, zipfile.ZIP_DEFLATED)
    return packed.getvalue()
