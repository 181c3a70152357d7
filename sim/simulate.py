"""Simulate a scene and write a dataset with ground truth. An interrupted simulation can be resumed."""

import hashlib
import json
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from rhizotwin.scenes import plan
from rhizotwin.scenes.atomic import write_image, write_json
from rhizotwin.scenes.dataset import Dataset, Frame, file_sha256, save_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import contents, lock_folder
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Listener, Monitor
from rhizotwin.scenes.provenance import versions
from rhizotwin.scenes.truth import save_truth
from rhizotwin.sim.bands import scene_in_band
from rhizotwin.sim.exposure import expose, mask_picture
from rhizotwin.sim.render import Fidelity, Image, Renderer, check_samples
from rhizotwin.sim.specimen import SpecimenSolid, build_specimen
from rhizotwin.sim.truth import build_truth, write_specimen
from rhizotwin.sim.world import TrueCamera, World, draw_world, scene_for_reconstruction

PROGRESS_FILE = "truth/simulate.json"
"""File that contains the settings and the finished frames of an interrupted simulation. The path is relative to the
dataset folder."""
_VERSIONED = ("mitsuba", "drjit", "numpy", "opencv-python-headless", "manifold3d")
_NOISE = 31


class CannotContinueError(UserError):
    """Error that is raised if a simulation cannot be resumed.

    Either its settings differ from those of the interrupted run, or its record is damaged.
    """


def simulate(
    scene: Scene,
    folder: Path,
    *,
    profile_name: str,
    seed: int,
    fidelity: Fidelity = "backlit",
    samples: int | None = None,
    monitor: Monitor | type[Any] | Listener | None = None,
) -> Dataset:
    """Render every view of a scene's capture plan to a dataset folder.

    Parameters
    ----------
    scene : Scene
        Scene with the disturbances to draw. The dataset contains the nominal scene without disturbances, but with the
        calibrated distortion of the lens.
    folder : Path
        New or empty folder, or the folder of an interrupted run with the same settings, whose intact frames are kept.
    profile_name : str
        Name of the profile of disturbances, recorded in the dataset.
    seed : int
        Random seed for all noise and errors.
    fidelity, samples : Fidelity, int or None
        Rendering method and number of rays per pixel, see `sim.render.Renderer`.
    monitor : Monitor, type of tqdm, callable or None
        Progress monitor, which may cancel the simulation. Finished frames are kept for the next run.

    Raises
    ------
    CannotContinueError
        If the folder contains a damaged simulation, or one with another scene, settings or program version.
    UserError
        If the specimen is invalid, the folder has other contents, or the disk is full.
    Cancelled
        If the monitor cancels the simulation.
    """
    folder = Path(folder)
    if seed < 0:
        raise UserError(f"seed is {seed}, but the seed must be an integer of at least 0")
    samples = check_samples(scene, fidelity, samples)
    with (monitor := Monitor.of(monitor)).stage("specimen"):
        solid = build_specimen(scene, monitor=monitor)
    settings = {
        "profile": profile_name,
        "seed": seed,
        "fidelity": fidelity,
        "samples": samples,
        "scene_sha256": _scene_hash(scene, solid),
        "variant": mi.variant(),
        "versions": versions(_VERSIONED),
    }
    with lock_folder(folder):
        done = _load_progress(folder, settings)
        world = draw_world(scene, seed=seed)
        write_specimen(folder, solid)
        frames = _render_frames(folder, _Rendering(scene=scene, world=world, solid=solid, settings=settings), done, monitor=monitor)
        save_truth(folder, build_truth(world, solid, zip((frame.file for frame in frames), _cameras(scene, world), strict=True)))
        origin = {"program": "rhizotwin simulate", **settings}
        return save_dataset(Dataset(folder=folder, scene=scene_for_reconstruction(scene), frames=frames, seed=seed, origin=origin))


@dataclass(frozen=True, kw_only=True)
class _Rendering:
    """Scene, world and settings of a rendering."""

    scene: Scene
    world: World
    solid: SpecimenSolid
    settings: dict[str, Any]
    """Settings that are stored with the pictures, among them fidelity and samples."""

    def renderer(self, band: str) -> Renderer:
        """Return a renderer of the scene in a band."""
        lit = scene_in_band(self.scene, band)
        return Renderer(lit, self.world, self.solid, fidelity=self.settings["fidelity"], samples=self.settings["samples"])


def _render_frames(folder: Path, rendering: _Rendering, done: dict[str, list[str]], *, monitor: Monitor) -> tuple[Frame, ...]:
    scene = rendering.scene
    world = rendering.world
    renderers: dict[str, Renderer] = {}
    quality = scene.disturbances.jpeg_quality
    suffix = ".png" if quality is None else ".jpg"
    bands = ("", *(band.name for band in scene.camera.bands))
    taken = [(view, band) for view in plan.views(scene, seed=world.seed) for band in plan.ring_bands(scene, view.ring)]
    pictures = {plan.picture_name(view.index, band) + suffix: (view, band) for view, band in taken}

    def paths_of(name: str) -> tuple[Path, Path]:
        return folder / "images" / name, (folder / "truth" / "masks" / name).with_suffix(".png")

    def keep(index: int, band: str, name: str, light: Image, coverage: Image) -> None:
        rng = np.random.default_rng([world.seed, _NOISE, index, *([bands.index(band)] if band else [])])
        image_path, mask_path = paths_of(name)
        wrong = renderers[band].scene.disturbances
        write_image(image_path, expose(light, scene.camera, wrong, rng=rng), jpeg_quality=quality)
        write_image(mask_path, mask_picture(coverage))
        done[name] = _hashes(image_path, mask_path)
        write_json(folder / PROGRESS_FILE, {"settings": rendering.settings, "frames": done})

    # Each picture is exposed and written while the next picture is rendered.
    with monitor.stage("render"), monitor.steps("render", len(pictures), "picture") as step, ThreadPoolExecutor(1) as writer:
        kept: Future[None] | None = None
        for name, (view, band) in pictures.items():
            image_path, mask_path = paths_of(name)
            hashes = done.get(name)
            if hashes is None or not image_path.is_file() or not mask_path.is_file() or _hashes(image_path, mask_path) != hashes:
                if band not in renderers:
                    renderers[band] = rendering.renderer(band)
                light, coverage = renderers[band].view(view.index)
                if kept is not None:
                    kept.result()
                kept = writer.submit(keep, view.index, band, name, light, coverage)
            step()
        if kept is not None:
            kept.result()
    return tuple(
        Frame(
            file=f"images/{name}",
            sha256=done[name][0],
            kind=view.kind,
            band=band,
            view=view.index if band else None,
            ring=view.ring,
            table_deg=view.table_deg,
        )
        for name, (view, band) in pictures.items()
    )


def _cameras(scene: Scene, world: World) -> list[TrueCamera]:
    """Return the true camera of each picture.

    All pictures of a view have the same camera, even if they are taken in several bands.
    """
    return [world.cameras[view.index] for view in plan.views(scene, seed=world.seed) for _ in plan.ring_bands(scene, view.ring)]


def _load_progress(folder: Path, settings: dict[str, Any]) -> dict[str, list[str]]:
    """Return the finished frames of an interrupted run with the same settings, keyed by frame name.

    Raises an error if the folder has other contents.
    """
    progress_path = folder / PROGRESS_FILE
    if progress_path.is_file():
        try:
            before = json.loads(progress_path.read_text(encoding="utf-8"))
            earlier, done = before["settings"], dict(before["frames"])
        except (ValueError, KeyError, TypeError, RecursionError):
            raise CannotContinueError(f"{progress_path} is damaged; delete the folder {folder} and repeat the simulation") from None
        different = _name_differences(earlier, settings)
        if different:
            raise CannotContinueError(
                f"{folder} contains a simulation with different settings ({', '.join(different)}); "
                "choose a new folder, or delete this folder to start again"
            )
        return done
    if any(not path.is_dir() for name in contents(folder) for path in [folder / name, *(folder / name).rglob("*")]):
        # empty subfolders remain if a run was stopped before its first file
        raise UserError(f"{folder} contains files that are not an interrupted simulation; choose a new folder for the dataset")
    write_json(progress_path, {"settings": settings, "frames": {}})
    return {}


def _name_differences(earlier: dict[str, Any], settings: dict[str, Any]) -> list[str]:
    """Return the names of the settings that differ.

    For a program or library, both versions are added.
    """
    named = []
    for key in sorted(settings):
        if key == "versions":
            before = dict(earlier.get(key) or {})
            named += [
                f"{name} ({before.get(name, 'unknown')}, now {now})" for name, now in settings[key].items() if before.get(name) != now
            ]
        elif earlier.get(key) != settings[key]:
            named.append(f"{key} ({earlier.get(key)}, now {settings[key]})" if key == "variant" else key)
    return named


def _scene_hash(scene: Scene, solid: SpecimenSolid) -> str:
    told = {key: value for key, value in asdict(scene).items() if key != "subject"}  # the subject does not affect any picture
    text = json.dumps(told, sort_keys=True).encode()
    shape = np.ascontiguousarray(solid.vertices, dtype=np.float64).tobytes() + np.ascontiguousarray(solid.faces, dtype=np.int32).tobytes()
    return hashlib.sha256(text + shape).hexdigest()


def _hashes(*paths: Path) -> list[str]:
    return [file_sha256(path) for path in paths]
