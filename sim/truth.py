"""Write the ground truth of rendered pictures.

The module is used by `sim.simulate` and by the rig's twin.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from rhizotwin.scenes.atomic import write_bytes
from rhizotwin.scenes.files import scene_to_dict
from rhizotwin.scenes.rsml import write_rsml
from rhizotwin.scenes.truth import TrueView, Truth
from rhizotwin.sim.bands import true_colour
from rhizotwin.sim.specimen import SpecimenSolid
from rhizotwin.sim.world import TrueCamera, World


def write_specimen(folder: Path, solid: SpecimenSolid) -> None:
    """Write the specimen, its centre lines and the shoot to the ``truth`` folder of the dataset in ``folder``."""
    for name, part in (("specimen", solid), ("shoot", solid.shoot)):
        if part is not None:
            mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
            write_bytes(folder / "truth" / f"{name}.ply", bytes(mesh.export(file_type="ply")))
    if solid.roots:
        write_rsml(folder / "truth" / "skeleton.rsml", solid.roots)


def build_truth(world: World, solid: SpecimenSolid, taken: Iterable[tuple[str, TrueCamera]]) -> Truth:
    """Collect the ground truth of pictures with known true cameras.

    Parameters
    ----------
    world : World
        World with its drawn disturbances.
    solid : SpecimenSolid
        Solid of the specimen.
    taken : Iterable[tuple[str, TrueCamera]]
        File names of the pictures in the dataset, and their true cameras.

    Returns
    -------
    Truth
        Ground truth, which `scenes.truth.save_truth` can write.
    """
    low, high = solid.extents_min_mm, solid.extents_max_mm
    return Truth(
        volume_mm3=solid.volume_mm3,
        extents_min_mm=(float(low[0]), float(low[1]), float(low[2])),
        extents_max_mm=(float(high[0]), float(high[1]), float(high[2])),
        n_water=world.n_water,
        canister_from_strip=_rows(world.canister_from_strip),
        views=tuple(
            TrueView(file=file, cam_from_canister=_rows(camera.cam_from_canister), table_deg=camera.table_deg) for file, camera in taken
        ),
        traits=dict(solid.traits),
        plants=dict(solid.plants),
        shoot={} if solid.shoot is None else solid.shoot.truth() | true_colour(world.scene),
        drawn={
            **world.drawn(),
            "focal_error": world.scene.disturbances.focal_error,
            **{key: scene_to_dict(world.scene)[key] for key in ("specimen", "plants")},
            "notes": list(solid.notes),
        },
    )


def _rows(matrix: NDArray[np.float64]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(value) for value in row) for row in matrix)
