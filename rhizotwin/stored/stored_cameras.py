"""Calibrated cameras of a result."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rhizotwin.recon.optics.cameras import STILL, View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.model import Camera


@dataclass(frozen=True)
class Cameras:
    """Pictures of a result with their calibrated cameras. All tuples have one entry per picture, in the same order."""

    files: tuple[str, ...]
    views: tuple[View, ...]
    table_deg: tuple[float | None, ...]
    optics: Optics

    @classmethod
    def of(cls, dataset: Dataset, summary: dict[str, Any]) -> Cameras:
        """Read the cameras of a result.

        The scale, the focal length and the refractive index of water are those that the reconstruction calibrated.
        Earlier versions did not store the scale of pictures without markers. For their results, the scale of the scene
        is used.
        """
        rig = summary.get("rig") or {}
        given = dataset.scene.camera
        scaled = replace(given, mm_per_px=rig.get("mm_per_px") or given.mm_per_px)
        camera = scaled.as_pinhole().focused(rig.get("focal_scale") or 1.0)
        optics = Optics.from_scene(dataset.scene)
        if rig.get("n_water"):
            optics = replace(optics, n_water=rig["n_water"])
        known = {frame.file for frame in dataset.frames}
        used = [view for view in summary["views"] if view["used"] and view.get("cam_from_canister") is not None and view["file"] in known]
        return cls(
            files=tuple(view["file"] for view in used),
            views=tuple(_view(camera, view) for view in used),
            table_deg=tuple(view.get("table_deg") for view in used),
            optics=optics,
        )


def _view(camera: Camera, stored: dict[str, Any]) -> View:
    """Return the view of an entry of ``views``."""
    aside, along, turned = stored.get("sway", STILL)
    return View(
        camera=camera,
        cam_from_canister=np.array(stored["cam_from_canister"], np.float64),
        cam_from_tank=None if stored.get("cam_from_tank") is None else np.array(stored["cam_from_tank"], np.float64),
        sway=(aside, along, turned),
    )
