"""Tubes strung on polylines, and the pictures they cast, for tests."""

from functools import cache

import numpy as np

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.optics import projection
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.roots.root_tree import RootSystem
from rhizotwin.recon.tubes import tube_picture, tubes
from rhizotwin.recon.tubes.tube_attenuation import TubeAttenuation
from rhizotwin.scenes import plan
from rhizotwin.scenes.model import Camera, CapturePlan, Ring, Scene
from tests.recon.lines import line

TRUNK = line((0.0, 0.0, -20.0), (0.0, 0.0, -50.0))
TWIG = line((0.0, 0.0, -30.0), (9.0, 0.0, -42.0))


def strung(*paths: np.ndarray, radius_mm: float = 0.2) -> tubes.Tubes:
    return tubes.string(paths, [np.full(len(path), radius_mm) for path in paths])


@cache
def standing(views: int = 12) -> Cameras:
    scene = Scene(camera=Camera().resized((400, 300)), plan=CapturePlan(rings=(Ring(views=views),)))
    planned = plan.views(scene)
    found = [View(camera=scene.camera, cam_from_canister=v.cam_from_rig @ plan.rig_from_table(scene, v.table_deg)) for v in planned]
    return Cameras.given(found, Optics.of(scene))


@cache
def cameras(views: int = 12) -> tuple[projection.ViewBank, tuple[int, int]]:
    found = standing(views)
    return projection.ViewBank.of(found.views, found.optics), (400, 300)


def pictured(system: tubes.Tubes, noise: float = 0.0) -> Evidence:
    """Return the coverage that tubes cast, as evidence; noise with a standard deviation."""
    bank, (width, height) = cameras()
    blank = [Silhouette(np.zeros((height, width), np.float32), np.ones((height, width), bool)) for _ in range(bank.count)]
    seen = Evidence.of(bank, blank)
    depth = tube_picture.optical_depth(seen, system, seen.project(system.centre_mm), 0.0)
    coverage = 1.0 - np.exp(-np.array(depth)).reshape(bank.count, height, width)
    coverage += np.random.default_rng(0).normal(0.0, noise, coverage.shape)
    return Evidence.of(bank, [Silhouette(picture.astype(np.float32), np.ones(picture.shape, bool)) for picture in coverage])


def at_rest(found: tubes.Tubes, *, px_a_mm: float, core_mm: np.ndarray | None = None, blur_px: float = 0.0) -> RootSystem:
    """Return tubes as roots without thick organs; ``core_mm`` (M, 3) puts one beside them."""
    no_nodes = np.zeros(len(found.radius_mm), bool)
    return RootSystem(
        tubes=found,
        buried=no_nodes,
        organ=no_nodes,
        solid=no_nodes,
        core_mm=np.zeros((0, 3)) if core_mm is None else core_mm,
        margin_mm=0.6,
        px_a_mm=px_a_mm,
        attenuation=TubeAttenuation.opaque(blur_px),
        seen=pictured(found),
        cameras=standing(),
        uncertain=no_nodes,
    )
