"""Binary silhouettes of a plant in air with given cameras: the plainest input of methods that know no refraction."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from rhizotwin.nerfstudio import OPENCV_FROM_OPENGL
from rhizotwin.scenes import atomic, files, frames
from rhizotwin.scenes.model import CapturePlan, Ring, Scene
from rhizotwin.scenes.truth import load_truth

SCENE, VIEWS, IMAGE_WH = "bean", 60, (1000, 1000)
_HALF = 32768
"""A mask's pixel is root from half of its full scale."""


def scene_in_air() -> Scene:
    """Return the plant in a canister and a liquid that bend no light."""
    scene = files.load_scene(SCENE)
    return replace(
        scene,
        canister=replace(scene.canister, n_wall=1.0),
        water=replace(scene.water, n_water=1.0),
        camera=scene.camera.resized(IMAGE_WH),
        plan=CapturePlan(rings=(Ring(views=VIEWS),)),
    )


def write(folder: Path) -> tuple[str, ...]:
    """Write masks, cameras and the scene into a folder.

    Returns
    -------
    tuple of str
        Words of ``rhizotwin import``, without its output.
    """
    from rhizotwin import engine
    from rhizotwin.sim.simulate import simulate

    engine.ensure()
    scene = scene_in_air()
    masks = folder / "masks"
    masks.mkdir(parents=True)
    with tempfile.TemporaryDirectory(prefix="rhizotwin-air-") as working:
        simulate(scene, Path(working) / "set", profile_name="clean", seed=0)
        truth = load_truth(Path(working) / "set")
        listed = []
        for number, view in enumerate(truth.views):
            name = f"view_{number:03d}.png"
            coverage = cv2.imread(str(Path(working) / "set" / "truth" / "masks" / name), cv2.IMREAD_UNCHANGED)
            cv2.imwrite(str(masks / name), np.where(coverage >= _HALF, 255, 0).astype(np.uint8))
            pose = frames.invert(np.asarray(view.cam_from_canister)) @ OPENCV_FROM_OPENGL
            listed.append({"file_path": name, "transform_matrix": pose.tolist()})
    camera = scene.camera
    lens = dict(zip(("fl_x", "fl_y", "cx", "cy"), (*camera.focal_px, *(at + 0.5 for at in camera.principal_px)), strict=True))
    size = dict(zip(("w", "h"), camera.image_wh, strict=True))
    atomic.write_json(folder / "transforms.json", {"camera_model": "OPENCV", **size, **lens, "frames": listed})
    files.save_scene(replace(scene, specimen=None), folder / "scene.toml")
    return (
        "import",
        str(masks),
        "--scene",
        str(folder / "scene.toml"),
        "--cameras",
        str(folder / "transforms.json"),
        "--masks",
    )
