"""A scene's specimen as a file for a 3D printer: what is scanned can then be scored against what was printed."""

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
"""STL holds single precision: a coordinate of 100 mm is rounded to 4e-6 mm, a root of 1 mm with it by some millionths
of its volume."""


def write_specimen_stl(scene: str, path: Path) -> list[str]:
    """Write a scene's specimen as a binary STL and read it back, which must give a closed surface of the same volume.

    Parameters
    ----------
    scene : str
        A name of the library or a scene file.
    path : Path
        The STL to write, in mm, in the canister frame.

    Returns
    -------
    list of str
        What was written, for people.

    Raises
    ------
    UserError
        For a scene without a specimen, another suffix than ``.stl``, or a folder that cannot be written.
    """
    if path.suffix.lower() != ".stl":
        raise UserError(f"{path}: the specimen is written as STL; give a name that ends in .stl")
    solid = build_specimen(files.load_scene(scene))
    write_bytes(path, bytes(trimesh.Trimesh(solid.vertices, solid.faces, process=False).export(file_type="stl")))
    back = float(meshes.load_solid(path)[0].volume())
    if not math.isclose(back, solid.volume_mm3, rel_tol=SAME_VOLUME):
        raise UserError(f"{path} holds {back:.3f} mm3 and not the specimen's {solid.volume_mm3:.3f} mm3; write it to another disk")
    x, y, z = np.ptp(solid.vertices, axis=0)
    return [
        f"wrote {path}: a closed surface of {solid.volume_mm3 / 1000.0:.3f} ml, {x:.1f} x {y:.1f} x {z:.1f} mm, z up as it hangs",
        f"print it solid, scan it, then try: rhizotwin score my_result --truth {path}",
    ]
