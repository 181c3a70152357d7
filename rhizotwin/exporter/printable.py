"""Export of the specimen of a scene for 3D printing.

The printed specimen can then be scanned, and the reconstruction compared with the original.
"""

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
"""Relative tolerance of the volume of the written file. STL has single precision, so a coordinate of 100 mm is rounded
to 4e-6 mm, which changes the volume of a 1 mm root by a few millionths."""


def write_specimen_stl(scene: str, path: Path) -> list[str]:
    """Write the specimen of a scene as binary STL, and verify that the file has a closed surface of the same volume.

    Parameters
    ----------
    scene : str
        Name of a library scene, or path of a scene file.
    path : Path
        STL file to write, in the canister frame, mm.

    Returns
    -------
    list of str
        Messages for the user.

    Raises
    ------
    UserError
        If the scene has no specimen, the suffix is not ``.stl``, or the file cannot be written correctly.
    """
    if path.suffix.lower() != ".stl":
        raise UserError(f"the suffix of {path} must be .stl")
    solid = build_specimen(files.load_scene(scene))
    write_bytes(path, bytes(trimesh.Trimesh(solid.vertices, solid.faces, process=False).export(file_type="stl")))
    back = float(meshes.load_solid(path)[0].volume())
    if not math.isclose(back, solid.volume_mm3, rel_tol=SAME_VOLUME):
        raise UserError(
            f"the volume in the written file {path} is {back:.3f} mm3 instead of {solid.volume_mm3:.3f} mm3; write the file to another disk"
        )
    x, y, z = np.ptp(solid.vertices, axis=0)
    return [
        f"wrote {path}: closed surface with {solid.volume_mm3 / 1000.0:.3f} ml and {x:.1f} x {y:.1f} x {z:.1f} mm, z up",
        f"next: print the file as a solid, scan and reconstruct the print, then run: rhizotwin score my_result --truth {path}",
    ]
