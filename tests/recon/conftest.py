"""A ball in the canister, scanned and reconstructed on paper: dataset and result folders without a renderer."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import trimesh

from rhizotwin.scenes import atomic, frames, plan
from rhizotwin.scenes.dataset import Dataset, Frame, file_sha256, save_dataset
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from rhizotwin.scenes.truth import TrueView, Truth, save_truth
from tests.recon.hull.exact_pictures import rows

RADIUS_MM = 6.0
CENTRE_MM = np.array([4.0, -3.0, -50.0])
VIEWS = 6


@dataclass(frozen=True)
class Scan:
    """Folders of a dataset and of a result."""

    dataset: Path
    result: Path

    def edit_summary(self, **changes) -> None:
        """Change keys of result.json."""
        path = self.result / "result.json"
        atomic.write_json(path, json.loads(path.read_text()) | changes)


def ball(radius_mm: float, centre_mm: np.ndarray) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=radius_mm)
    mesh.apply_translation(centre_mm)
    return mesh


def disk(image_wh: tuple[int, int], radius_px: float) -> np.ndarray:
    """Return the coverage of a disk in the middle of a picture, its edge soft over a pixel."""
    x, y = np.meshgrid(np.arange(image_wh[0]), np.arange(image_wh[1]))
    away = np.hypot(x - (image_wh[0] - 1) / 2.0, y - (image_wh[1] - 1) / 2.0)
    return np.clip(radius_px + 0.5 - away, 0.0, 1.0)


@pytest.fixture
def scan(tmp_path: Path) -> Callable[..., Scan]:
    """Return a maker of scans; its arguments are what the reconstruction gets wrong."""

    def make(
        *,
        radius_mm: float = RADIUS_MM,
        shift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
        voxel_mm: float = 0.25,
        found_from_true: np.ndarray | None = None,
        disk_px: float = 10.0,
        lost: tuple[int, ...] = (),
    ) -> Scan:
        dataset, result = tmp_path / "scan", tmp_path / "result"
        camera = Camera().resized((160, 120))
        scene = Scene(name="ball", description="a ball <6 mm>", camera=camera, plan=CapturePlan(rings=(Ring(views=VIEWS),)))
        poses = [view.cam_from_rig @ plan.rig_from_table(scene, view.table_deg) for view in plan.views(scene)]
        files = [f"images/view_{k:03d}.png" for k in range(VIEWS)]
        cover = disk(camera.image_wh, 10.0)
        for file in files:
            atomic.write_image(dataset / file, np.round(52000.0 * (1.0 - cover)).astype(np.uint16))
            atomic.write_image(dataset / "truth" / "masks" / Path(file).name, np.round(65535.0 * cover).astype(np.uint16))
        listed = tuple(Frame(file=file, sha256=file_sha256(dataset / file), table_deg=360.0 * k / VIEWS) for k, file in enumerate(files))
        save_dataset(Dataset(folder=dataset, scene=scene, frames=listed, seed=0))
        true = ball(RADIUS_MM, CENTRE_MM)
        atomic.write_bytes(dataset / "truth" / "specimen.ply", bytes(true.export(file_type="ply")))
        extents = dict(zip(("extents_min_mm", "extents_max_mm"), rows(true.bounds), strict=True))
        seen_from = [TrueView(file=files[k], cam_from_canister=rows(pose), table_deg=60.0 * k) for k, pose in enumerate(poses)]
        still = {"n_water": 1.333, "canister_from_strip": rows(np.eye(4))}
        save_truth(dataset, Truth(volume_mm3=float(true.volume), **extents, **still, views=tuple(seen_from)))
        poses = poses if found_from_true is None else [pose @ frames.invert(found_from_true) for pose in poses]
        cover = disk(camera.image_wh, disk_px)
        _write_result(result, dataset, dict(zip(files, poses, strict=True)), radius_mm, CENTRE_MM + shift_mm, voxel_mm, cover, lost)
        return Scan(dataset, result)

    return make


def _write_result(result, dataset, poses, radius_mm, centre_mm, voxel_mm, cover, lost) -> None:
    origin = np.array([-80.0, -80.0, -150.0])
    low = np.floor((centre_mm - radius_mm - origin) / voxel_mm).astype(int) - 1
    high = np.ceil((centre_mm + radius_mm - origin) / voxel_mm).astype(int) + 1
    grid = np.argwhere(np.ones(high - low, bool)) + low
    away = np.linalg.norm(origin + voxel_mm * (grid + 0.5) - centre_mm, axis=1)
    occupancy = np.clip(0.5 + (radius_mm - away) / voxel_mm, 0.0, 1.0).astype(np.float32)
    kept = occupancy > 0.0
    result.mkdir()
    shape = {"leaves": grid[kept].astype(np.int32), "size": np.ones(kept.sum(), np.int32), "occupancy": occupancy[kept]}
    hull = {f"hull_{name}": value for name, value in shape.items()}
    np.savez_compressed(result / "shape.npz", **shape, **hull, origin_mm=origin, voxel_mm=np.float64(voxel_mm))
    mesh = ball(radius_mm, centre_mm)
    atomic.write_bytes(result / "shape.ply", bytes(mesh.export(file_type="ply")))
    seen = np.zeros(cover.shape, np.uint8)
    seen[20:-20, 20:-20] = 255
    views = []
    for k, (file, pose) in enumerate(poses.items()):
        used = {"used": True, "reason": None, "cam_from_canister": rows(pose), "reprojection_px": 0.08, "markers": 20, "fill": 0.02}
        unused = dict.fromkeys(used) | {"used": False, "reason": "2 markers found, 4 are needed", "markers": 2}
        views.append({"file": file, "ring": 0, "table_deg": 60.0 * k} | (unused if k in lost else used))
        if k not in lost:
            atomic.write_image(result / "silhouettes" / Path(file).name, np.round(65535.0 * cover).astype(np.uint16))
            atomic.write_image(result / "seen" / Path(file).name, seen)
    volume = float(mesh.volume)
    about = {"schema_version": 1, "dataset": "scan", "dataset_sha256": file_sha256(dataset / "dataset.json"), "scene": "ball"}
    run = {"timings_s": {"poses": 1.5, "carve": 2.25}, "peak_memory_mib": 512.0}
    run |= {"settings": {"method": "coverage"}, "versions": {"numpy": "2"}}
    found = {"views": views, "warnings": ["view 3 is <dark>"] if lost else [], "voxel_mm": voxel_mm, "volume_mm3": volume}
    interval = {"volume_interval_mm3": [0.95 * volume, 1.05 * volume], "volume_bounds_mm3": [0.9 * volume, 1.2 * volume]}
    verdict = {"volume_trusted": True, "volume_verdict": "the true volume lies near with 90 % confidence"}
    budget = {"volume_budget": [{"name": "outlines", "less_mm3": 0.05 * volume, "more_mm3": 0.05 * volume, "why": "outlines"}]}
    extents = {"extents_min_mm": mesh.bounds[0].tolist(), "extents_max_mm": mesh.bounds[1].tolist()}
    other = {"hull_mm3": 600.0, "untrimmed_mm3": 0.0, "blind_mm3": 12.5}
    atomic.write_json(result / "result.json", about | run | found | interval | verdict | budget | extents | other)
