"""Binary silhouettes of a plant in air with known cameras: the simplest input, for methods without refraction."""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from rhizotwin.exporter.exports import write_nerfstudio
from rhizotwin.scenes import atomic, files, key_descriptions
from rhizotwin.scenes.model import CapturePlan, Ring, Scene
from rhizotwin.scenes.truth import load_truth

SCENE, VIEWS, IMAGE_WH = "bean", 60, (1000, 1000)
_SECTIONS = "canister", "water", "net_pot", "camera"
"""Sections of the scene that determine silhouettes in air."""
_HALF = 32768
"""Fraction of full scale from which a mask's pixel is root."""


def scene_in_air() -> Scene:
    """Return the plant in a canister and a liquid without refraction."""
    scene = files.load_scene(SCENE)
    return replace(
        scene,
        canister=replace(scene.canister, n_wall=1.0),
        water=replace(scene.water, n_water=1.0),
        camera=scene.camera.resized(IMAGE_WH),
        plan=CapturePlan(rings=(Ring(views=VIEWS),)),
    )


def write(folder: Path, *, truth: Path | None = None) -> tuple[str, ...]:
    """Write masks, cameras and the scene into a folder.

    Parameters
    ----------
    folder : Path
        Folder for the masks.
    truth : Path or None
        New folder for the ground truth, which a dataset of the masks does not contain; None: it is not kept.

    Returns
    -------
    tuple of str
        Arguments of ``rhizotwin import``, without its output.
    """
    from rhizotwin import engine
    from rhizotwin.sim.simulate import simulate

    engine.ensure()
    scene = scene_in_air()
    masks = folder / "masks"
    masks.mkdir(parents=True)
    with tempfile.TemporaryDirectory(prefix="rhizotwin-air-") as working:
        simulate(scene, Path(working) / "set", profile_name="clean", seed=0)
        posed = []
        for number, view in enumerate(load_truth(Path(working) / "set").views):
            name = f"view_{number:03d}.png"
            coverage = cv2.imread(str(Path(working) / "set" / "truth" / "masks" / name), cv2.IMREAD_UNCHANGED)
            cv2.imwrite(str(masks / name), np.where(coverage >= _HALF, 255, 0).astype(np.uint8))
            posed.append((name, np.asarray(view.cam_from_canister)))
        if truth is not None:
            shutil.copytree(Path(working) / "set" / "truth", truth)
    write_nerfstudio(folder / "transforms.json", scene.camera.as_pinhole(), posed)
    # an older commit does not read keys that were added since, which have their default values here
    usual, plain = (files.scene_to_dict(one) for one in (Scene(), scene))
    given = {name: {key: value for key, value in plain[name].items() if value != usual[name][key]} for name in _SECTIONS}
    atomic.write_text(folder / "scene.toml", key_descriptions.to_commented_toml(given))
    return (
        "import",
        str(masks),
        "--scene",
        str(folder / "scene.toml"),
        "--cameras",
        str(folder / "transforms.json"),
        "--masks",
    )
