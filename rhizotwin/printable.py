"""Export of the specimen of a scene for 3D printing, so that a scan of the print can be compared with it."""

import math
from pathlib import Path

import numpy as np
import trimesh

from rhizotwin.scenes import files
from rhizotwin.scenes.atomic import write_bytes
from rhizotwin.scenes.errors import UserError
from rhizotwin.sim import meshes
from rhizotwin.sim.specimen import build_specimen

SAME_VOLUME = 1e-4
"""Tolerance of the volume. STL has single precision: a coordinate of 100 mm is rounded to 4e-6 mm, which changes the
volume of a root of 1 mm by a few millionths."""


def write_specimen_stl(scene: str, path: Path) -> list[str]:
    """Write the specimen of a scene as a binary STL, and verify the written file.

    The file must contain a closed surface of the same volume.

    Parameters
    ----------
    scene : str
        Name of a scene of the library, or path of a scene file.
    path : Path
        STL file to write, in mm, in the canister frame.

    Returns
    -------
    list of str
        Messages for the user.

    Raises
    ------
    UserError
        If the scene has no specimen, the suffix is not ``.stl``, or the file cannot be written.
    """
    if path.suffix.lower() != ".stl":
        raise UserError(f"{path} must end in .stl")
    solid = build_specimen(files.load_scene(scene))
    write_bytes(path, bytes(trimesh.Trimesh(solid.vertices, solid.faces, process=False).export(file_type="stl")))
    back = float(meshes.load_solid(path)[0].volume())
    if not math.isclose(back, solid.volume_mm3, rel_tol=SAME_VOLUME):
        raise UserError(f"{path} contains {back:.3f} mm3 instead of {solid.volume_mm3:.3f} mm3 after writing; write it to another disk")
    x, y, z = np.ptp(solid.vertices, axis=0)
    return [
        f"wrote {path}: closed surface, {solid.volume_mm3 / 1000.0:.3f} ml, {x:.1f} x {y:.1f} x {z:.1f} mm, z up",
        f"print it as a solid, scan it, then run: rhizotwin score my_result --truth {path}",
    ]
