"""A small plant, scanned and reconstructed on paper without a renderer: a main root with three laterals and a thick beginning."""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import trimesh

from rhizotwin.drawing.root_mesh import tubes as meshed
from rhizotwin.recon.calibration.cameras import Camera as FoundCamera
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.hull.leaves import Grid
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.results.parts import Leaves
from rhizotwin.recon.results.result import Result, Solid
from rhizotwin.recon.tubes.tubes import Tubes
from rhizotwin.recon.uncertainty.budget import Term, Volume
from rhizotwin.scenes import atomic, frames, plan
from rhizotwin.scenes.dataset import Dataset, Frame, file_sha256, save_dataset
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from rhizotwin.scenes.rsml import Root

VOXEL_MM = 0.27
VIEWS = 8


@dataclass(frozen=True)
class Plant:
    """Folders of a dataset and of a result, and what they were made of."""

    dataset: Path
    result: Path
    roots: tuple[Root, ...]


def line(
    begin: tuple[float, float, float], end: tuple[float, float, float], *, wide: float, thin: float, count: int = 40
) -> dict[str, np.ndarray]:
    """Return a slightly bent line with its diameters, and how uncertain they are."""
    share = np.linspace(0.0, 1.0, count)
    points = np.array(begin) + share[:, None] * (np.array(end) - np.array(begin))
    points[:, 0] += 0.8 * np.sin(np.pi * share)
    return {"points_mm": points, "diameters_mm": np.linspace(wide, thin, count), "diameter_sigma_mm": np.linspace(0.01, 0.05, count)}


def roots(*, fibre: bool = False) -> tuple[Root, ...]:
    """Return the roots, parents before children; with ``fibre`` a straight fibre of debris as the last."""
    tap = Root(**line((0.0, 0.0, -15.0), (2.0, 1.0, -60.0), wide=1.6, thin=0.4), order=0, parent=-1)
    laterals = [
        Root(**line(tuple(tap.points_mm[10]), (12.0, 5.0, -33.0), wide=0.5, thin=0.3), order=1, parent=0),
        Root(**line(tuple(tap.points_mm[20]), (-11.0, 6.0, -47.0), wide=0.4, thin=0.25), order=1, parent=0),
        Root(**line(tuple(tap.points_mm[26]), (3.0, -12.0, -52.0), wide=0.4, thin=0.3), order=1, parent=0, tip_seen=False),
    ]
    debris = [Root(**line((-14.0, -10.0, -30.0), (-14.0, 10.0, -38.0), wide=0.3, thin=0.3), order=0, parent=-1)] if fibre else []
    return (tap, *laterals, *debris)


def painted(found: tuple[Root, ...]) -> Leaves:
    """Paint roots into voxels as the reconstruction does, overlaps counted once."""
    from rhizotwin.recon.roots import tube_volume  # loads Dr.Jit, which must not be loaded before the tests begin

    edges = np.cumsum([0, *(len(root.points_mm) for root in found)])
    branches = tuple(np.arange(a, b) for a, b in pairwise(edges))
    radius = np.concatenate([root.diameters_mm for root in found]) / 2.0
    tubes = Tubes(np.concatenate([root.points_mm for root in found]), radius, branches)
    leaves = tube_volume.paint(tubes, np.ones(len(tubes.segments), bool), Grid.over([-80.0] * 3, [80.0, 80.0, 0.0], VOXEL_MM)).split()
    return Leaves(low=leaves.index, size=leaves.size, occupancy=leaves.occupancy, origin_mm=leaves.grid.origin_mm, voxel_mm=VOXEL_MM)


def make(folder: Path, *, fibre: bool = False, name: str = "plant") -> Plant:
    """Write a dataset and a result."""
    found = roots(fibre=fibre)
    camera = Camera(image_wh=(200, 150), focal_px=(325.0, 325.0), principal_px=(99.5, 74.5), bits=8)
    scene = Scene(name=name, description="a plant <of paper>", camera=camera, plan=CapturePlan(rings=(Ring(views=VIEWS),)))
    dataset = folder / "dataset"
    views, listed, silhouettes = [], [], {}
    for k, planned in enumerate(plan.views(scene)):
        ring = scene.plan.rings[0]
        level = frames.level_camera(distance_mm=ring.distance_mm, height_mm=ring.height_mm, tilt_deg=ring.tilt_deg)
        view = View(camera=camera, cam_from_canister=level @ plan.rig_from_table(scene, planned.table_deg))
        coverage = drawn(view, Optics.from_scene(scene), found)
        file = f"images/view_{k:03d}.png"
        atomic.write_image(dataset / file, np.round(230.0 * (1.0 - coverage)).astype(np.uint8))
        pose = tuple(tuple(float(x) for x in row) for row in view.cam_from_canister)
        same = {"file": file, "ring": 0, "table_deg": planned.table_deg}
        listed.append(Frame(sha256=file_sha256(dataset / file), kind="root", cam_from_canister=pose, **same))
        views.append(FoundCamera(used=True, cam_from_canister=view.cam_from_canister, **same))
        silhouettes[file] = Silhouette(coverage.astype(np.float32), np.ones(coverage.shape, bool))
    save_dataset(Dataset(folder=dataset, scene=scene, frames=tuple(listed)))
    sources = {"dataset": str(dataset), "dataset_sha256": file_sha256(dataset / "dataset.json"), "scene": name, "fill": {}, "rig": {}}
    settings = {"voxel_mm": VOXEL_MM, "finest_mm": VOXEL_MM / 2.0}
    run = {"timings_s": {"carve": 1.0}, "peak_memory_mib": 1.0, "settings": settings, "versions": {"rhizotwin": "0"}}
    result = Result(solid=solid_of(found), cameras=tuple(views), silhouettes=silhouettes, warnings=(), **sources, **run)
    (folder / "result").mkdir()
    result.save(folder / "result")
    return Plant(dataset, folder / "result", found)


def solid_of(found: tuple[Root, ...]) -> Solid:
    """Return the roots' voxels, mesh and volume."""
    leaves, mesh = painted(found), meshed(found, colour="order")
    volume = float(leaves.occupancy.sum(dtype=np.float64)) * VOXEL_MM**3
    term = Term(name="radii", less_mm3=0.05 * volume, more_mm3=0.06 * volume, why="the views disagree about <radii>")
    limits = {"interval_mm3": (0.95 * volume, 1.06 * volume), "bounds_mm3": (0.8 * volume, 1.5 * volume)}
    judged = Volume(mm3=volume, trusted=True, verdict="the true volume is near", terms=(term,), **limits)
    shape = {"voxels": leaves, "hull": leaves, "mesh": trimesh.Trimesh(mesh.vertices, mesh.faces, process=False), "roots": found}
    extents = {"extents_min_mm": tuple(mesh.bounds[0]), "extents_max_mm": tuple(mesh.bounds[1]), "finest_mm": VOXEL_MM / 2.0}
    return Solid(volume=judged, hull_mm3=2.0 * volume, untrimmed_mm3=0.0, blind_mm3=0.0, **shape, **extents)


def drawn(view: View, optics: Optics, found: tuple[Root, ...]) -> np.ndarray:
    """Draw the roots' coverage (H, W): thick lines, four times as fine as the picture."""
    width, height = view.camera.image_wh
    fine = np.zeros((4 * height, 4 * width), np.uint8)
    for root in found:
        px = cameras.project_inner(view, optics, root.points_mm)
        wide = root.diameters_mm * view.camera.focal_px[0] / np.linalg.norm(root.points_mm - view.centre_mm, axis=1) * optics.n_water
        for a, b, thick in zip(px[:-1], px[1:], wide[1:], strict=True):
            if np.isfinite(a).all() and np.isfinite(b).all():
                ends = [tuple(int(x) for x in np.round(64 * (p + 0.5) - 8)) for p in (a, b)]
                cv2.line(fine, *ends, 255, max(1, round(4 * thick)), cv2.LINE_8, 4)
    return cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA).astype(np.float64) / 255.0
