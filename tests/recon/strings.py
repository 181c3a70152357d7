"""Tubes strung on polylines, and the pictures they cast, for tests."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.light import Light
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.projection import ViewBank
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.roots.root_tree import RootSystem
from rhizotwin.recon.tubes import tube_picture, tubes
from rhizotwin.recon.tubes.tube_attenuation import TubeAttenuation
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.rsml import Root
from tests.recon.hull.exact_pictures import cameras_of, ring_of, views_of


def line(*corners: tuple[float, float, float], step: float = 0.1) -> np.ndarray:
    """Return points along straight pieces."""
    counts = [max(2, round(float(np.linalg.norm(np.subtract(b, a))) / step) + 1) for a, b in pairwise(corners)]
    pieces = [np.linspace(a, b, count) for (a, b), count in zip(pairwise(corners), counts, strict=True)]
    return np.concatenate([pieces[0], *(piece[1:] for piece in pieces[1:])])


def root(*corners, diameters=(0.3, 0.3), parent=-1, order=0) -> Root:
    """Return a root along corners, a point every half millimetre or so, with diameters from base to tip."""
    points = line(*corners, step=0.5)
    return Root(points_mm=points, diameters_mm=np.linspace(*diameters, len(points)), order=order, parent=parent)


TRUNK = line((0.0, 0.0, -20.0), (0.0, 0.0, -50.0))
TWIG = line((0.0, 0.0, -30.0), (9.0, 0.0, -42.0))


def strung(*paths: np.ndarray, radius_mm: float = 0.2) -> tubes.Tubes:
    return tubes.place_nodes(paths, [np.full(len(path), radius_mm) for path in paths])


def blank(views: list[View], optics: Optics) -> Evidence:
    """Return pictures without roots, that show everything and whose opacity is known."""
    width, height = views[0].camera.image_wh
    dark = Silhouette(np.zeros((height, width), np.float32), np.ones((height, width), bool), np.zeros((height, width), np.float32))
    return Evidence.from_silhouettes(ViewBank.pack(views, optics), [dark] * len(views))


def blank_of(scene: Scene) -> Evidence:
    return blank(views_of(scene), Optics.from_scene(scene))


def drawn(system: tubes.Tubes, empty: Evidence, *, noise: float = 0.0, opacity: bool = False, seed: int = 0) -> Evidence:
    """Return the coverage that tubes cast into empty pictures, or their opacity; noise with a standard deviation."""
    passing = tube_picture.transmittance(empty, system, empty.project(system.centre_mm))
    pictures = 1.0 - np.array(passing).reshape(empty.bank.count, *empty.silhouettes[0].usable.shape)
    pictures = (pictures + np.random.default_rng(seed).normal(0.0, noise, pictures.shape)).astype(np.float32)
    everywhere = np.ones(pictures.shape[1:], bool)
    shown = [Silhouette(np.clip(one, 0.0, 1.0), everywhere, one) if opacity else Silhouette(one, everywhere) for one in pictures]
    return Evidence.from_silhouettes(empty.bank, shown, empty.window)


SCENE = ring_of(12)


@cache
def standing() -> Cameras:
    return cameras_of(views_of(SCENE), Optics.from_scene(SCENE))


@cache
def nothing() -> Evidence:
    return blank_of(SCENE)


def pictured(system: tubes.Tubes, noise: float = 0.0) -> Evidence:
    """Return the coverage that tubes cast in twelve views."""
    return drawn(system, nothing(), noise=noise)


def at_rest(found: tubes.Tubes, *, px_a_mm: float, blur_px: float = 0.0, seen: Evidence | None = None) -> RootSystem:
    """Return tubes as roots without solids, in given pictures or where nothing is to be seen."""
    no_nodes = np.zeros(len(found.radius_mm), bool)
    return RootSystem(
        tubes=found,
        solid=no_nodes,
        solids_mm=np.zeros((0, 3)),
        core_mm=np.zeros((0, 3)),
        margin_mm=0.6,
        px_a_mm=px_a_mm,
        attenuation=TubeAttenuation.opaque(),
        evidence=replace(nothing() if seen is None else seen, light=Light(blur_px=blur_px)),
        cameras=standing(),
        uncertain=no_nodes,
        nodule=no_nodes,
        has_crown=False,
    )
