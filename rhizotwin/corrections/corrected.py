"""Write a corrected result to a new folder. It contains the same measurements as the result of a reconstruction."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from rhizotwin.corrections import log as logs
from rhizotwin.corrections import reliability, surface
from rhizotwin.corrections.session import Measured, Session
from rhizotwin.recon.results import by_plant, divide_by_plant, result_traits
from rhizotwin.recon.results.parts import Json, Leaves, Mesh, shape_npz
from rhizotwin.recon.roots import plants
from rhizotwin.recon.uncertainty.budget import Term
from rhizotwin.recon.uncertainty.calibration import Calibration
from rhizotwin.scenes import atomic, rsml, subject
from rhizotwin.scenes.plants import Plant
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.schema import to_plain
from rhizotwin.stored import result_files, save, stored_traits

_EMPTY_MM3 = 1e-9
"""Volume, mm3, up to which a voxel is regarded as empty."""
_OWN = ("plant", "species", "treatment")
"""Fields of `Subject` that differ between plants of the same scan."""


def share(before_mm3: float, after_mm3: float) -> float:
    """Return the relative change of the volume due to the corrections.

    A value of 0.1 means that the volume is 10 % larger.
    """
    return after_mm3 / before_mm3 - 1.0 if before_mm3 > 0.0 else 0.0


def write(
    session: Session, output: Path, *, dataset: Path | None = None, last: Callable[[Path], object] = lambda _: None
) -> dict[str, Any]:
    """Write a corrected result to a folder and return the content of its ``result.json``.

    The contributions to the error budget keep their size relative to the volume, because a correction does not make a
    measurement more precise. Disagreement with the pictures is an additional contribution and may make the volume
    unreliable.

    Parameters
    ----------
    session : Session
        Result and its corrections.
    output : path
        Output folder. It is new or empty, or contains an earlier result, which is replaced.
    dataset : path, optional
        Folder of the dataset. Default: the dataset recorded in the result.
    last : callable
        Function that adds further files to the folder. It is called with the folder's temporary path.

    Raises
    ------
    UserError
        If the output folder contains files other than a result, or a file of the result is missing.
    """
    mesh = _corrected_mesh(session)
    roots = session.state.roots()
    surface_mesh = Mesh.of(mesh)
    voxels = _voxels(session.measure())
    summary = summarise(session, surface_mesh)
    summary |= reliability.judge_volume(session, summary, dataset)
    if summary.get("plants"):
        roots, summary["plants"] = _by_plant(session, summary, surface_mesh, voxels)
    traits = stored_traits.of_summary(summary, surface_mesh, roots)
    summary["estimates"] = reliability.unreliable_estimates(session.summary, traits)
    with save.new_result(output, source=session.folder) as building:
        for name in ("silhouettes", "seen"):
            if (session.folder / name).is_dir():
                shutil.copytree(session.folder / name, building / name)
        if (session.folder / "shoot.ply").is_file():
            shutil.copyfile(session.folder / "shoot.ply", building / "shoot.ply")
        hull = result_files.read_leaves(session.folder, hull=True)  # corrections do not change the hull
        atomic.write_bytes(building / "shape.npz", shape_npz(voxels, hull))
        atomic.write_bytes(building / "shape.ply", bytes(trimesh.exchange.ply.export_ply(mesh)))
        if roots:
            rsml.write_rsml(building / "roots.rsml", roots)
        logs.write(building / logs.APPLIED_NAME, replace(session.log, earlier=logs.read_applied(session.folder)))
        for name, text in result_traits.trait_files(traits, summary, roots, mass_g=summary.get("mass_g")).items():
            atomic.write_text(building / name, text)
        summary |= {"traits": to_plain(traits)}
        atomic.write_json(building / "result.json", summary)
        last(building)
    return summary


def summarise(session: Session, mesh: Mesh) -> dict[str, Any]:
    """Return the content of ``result.json`` for a corrected result, without its traits, estimates and verdicts.

    Parameters
    ----------
    session : Session
        Result and its corrections.
    mesh : Mesh
        Corrected surface.
    """
    old = session.summary
    state = session.state
    measured = session.measure()
    before = float(old["volume_mm3"])
    after = measured.volume_mm3
    low, high = old["volume_bounds_mm3"]
    points = [mesh.vertices_mm, *(line.points_mm for line in state.lines.values())]
    corners = np.concatenate(points) if sum(len(part) for part in points) else np.zeros((1, 3))
    roots = state.roots()
    made, earlier = session.log.edits, old.get("edits") or {}  # earlier corrections, if the result is itself a corrected one
    first = float(earlier.get("volume_before_mm3", before))
    edits = {
        "count": len(made) + earlier.get("count", 0),
        "who": sorted({*(edit.who for edit in made), *earlier.get("who", ())}),
        "last": max((edit.when for edit in made), default=earlier.get("last")),
        "volume_share": share(first, after),
        "volume_before_mm3": first,
        "base_mm": earlier.get("base_mm") if state.base_mm is None else state.base_mm,
    }
    changed = {
        "volume_mm3": after,
        "volume_bounds_mm3": [min(low, after), max(high, after)],
        "length_mm": measured.length_mm,
        "tips": sum(bool(root.tip_seen) for root in roots),
        "extents_min_mm": corners.min(axis=0).tolist(),
        "extents_max_mm": corners.max(axis=0).tolist(),
        "edits": edits,
    }
    kept = {key: value for key, value in old.items() if key not in ("traits", "estimates")}
    return dict(json.loads(json.dumps({**kept, **changed})))


def _by_plant(session: Session, summary: Json, mesh: Mesh, voxels: Leaves) -> tuple[tuple[Root, ...], list[Json]]:
    """Return the roots, ordered by plant, and the entries for the plants in ``result.json``.

    The height of the highest root replaces the height of the net pot, which is not stored with a result.
    """
    where = str(session.folder / "result.json")
    known = [Plant(**{n: getattr(one.subject, n) for n in _OWN}, at_mm=one.at_mm) for one in by_plant.from_summary(session.summary, where)]
    grid_z_mm = max((float(root.points_mm[:, 2].max()) for root in session.roots), default=0.0)
    planted = plants.check_assignment(session.state.roots(), known, grid_z_mm=grid_z_mm)
    if not planted.roots:
        return (), []
    shape = divide_by_plant.Shape(
        leaves=voxels,
        surface=mesh,
        finest_mm=result_files.finest_mm(summary),
        volume_mm3=float(summary["volume_mm3"]),
        terms=tuple(Term(**term) for term in summary["volume_budget"]),
        calibration=Calibration.from_plain(summary.get("calibration")),
    )
    return planted.roots, [one.plain() for one in divide_by_plant.measure(shape, planted, known, subject.from_summary(summary, where))]


def _voxels(measured: Measured) -> Leaves:
    """Return the voxels that are not empty after the corrections."""
    solid, volumes_mm3 = measured.solid, measured.volumes_mm3
    kept = volumes_mm3 > _EMPTY_MM3
    if not kept.any():
        kept[0] = True  # the file format needs at least one voxel
    room = (solid.size[kept] * solid.voxel_mm) ** 3
    return Leaves(
        low=solid.low[kept].astype(np.int32),
        size=solid.size[kept].astype(np.int32),
        occupancy=(volumes_mm3[kept] / room).astype(np.float32),
        origin_mm=solid.origin_mm,
        voxel_mm=solid.voxel_mm,
    )


def read_mesh(session: Session) -> Mesh:
    """Return the surface mesh after the corrections."""
    return Mesh.of(_corrected_mesh(session))


def _corrected_mesh(session: Session) -> trimesh.Trimesh:
    measured = session.measure()
    return surface.corrected(result_files.read_mesh(session.folder / "shape.ply"), measured.solid, session.state, measured.volumes_mm3)
