"""From pictures to silhouettes: the empty backlight of every view, and what roots cover of it."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from recon import background, silhouettes
from recon.cameras import View
from recon.refraction import Optics
from recon.run import Run
from recon.silhouettes import Image, Mask, Silhouette
from scenes import frames
from scenes.errors import UserError

_RING_VIEWS = 8
"""With fewer views of a still camera the turn does not show the empty backlight."""


Outline = Callable[[Image, Image, Mask], Silhouette]
"""From picture, empty backlight and seen pixels to a silhouette."""


def draw(run: Run, views: dict[int, View], optics: Optics, *, outline: Outline = silhouettes.measure) -> dict[int, Silhouette]:
    """Draw every view's silhouette.

    Parameters
    ----------
    views : the cameras by index of the frame.
    outline : how a silhouette comes from a picture.

    Raises
    ------
    UserError
        Where a picture shows nothing of the water, or no root.
    """
    drawn = _given(run, views, optics) if run.dataset.masks else _measured(run, views, optics, outline)
    blank = [k for k in views if not drawn[k].seen.any()]
    if blank:
        name = run.frames[blank[0]].file
        raise UserError(f"{name} shows nothing of the water below the net pot: check the camera, the backlight and the scene file.")
    empty = [k for k in views if not (drawn[k].coverage > 0.25).any()]
    if empty:
        raise UserError(
            f"{run.frames[empty[0]].file} has an empty silhouette ({len(empty)} of {len(views)} pictures do): no root is seen in it, "
            "so nothing can be carved; take it out of the dataset or check light and focus."
        )
    return drawn


def _given(run: Run, views: dict[int, View], optics: Optics) -> dict[int, Silhouette]:
    """Take pictures that are silhouettes already: white is root."""
    in_air = optics.n_wall == 1.0 and optics.n_water == 1.0
    drawn = {}
    with run.stage("silhouettes"):
        for k, view in views.items():
            picture = run.images[k].astype(np.float32) / np.iinfo(run.images[k].dtype).max
            seen = np.ones(picture.shape, bool) if in_air else background.water_mask(view, optics, run.dataset.scene)
            drawn[k] = Silhouette(np.where(seen, picture, 0.0).astype(np.float32), seen)
    return drawn


def _measured(run: Run, views: dict[int, View], optics: Optics, outline: Outline) -> dict[int, Silhouette]:
    """Draw silhouettes against the empty backlight."""
    keys = list(views)
    with run.stage("background"):
        inside = {k: background.water_mask(view, optics, run.dataset.scene) for k, view in views.items()}
        empty = _backgrounds(run, views, inside)

    def one(k: int) -> Silhouette:
        return outline(run.images[k].astype(np.float32), empty[k], background.bright_enough(empty[k], inside[k]))

    with run.stage("silhouettes"):
        return dict(zip(keys, run.each(one, "silhouettes", keys), strict=True))


def _backgrounds(run: Run, views: dict[int, View], inside: dict[int, NDArray[np.bool_]]) -> dict[int, NDArray[np.float32]]:
    """Estimate the empty backlight of each view: ring by ring where the camera stood still, else picture by picture."""
    empty: dict[int, NDArray[np.float32]] = {}
    for ring in sorted({run.frames[k].ring for k in views}):
        members = [k for k in views if run.frames[k].ring == ring]
        if len(members) >= _RING_VIEWS and _still(run, [views[k] for k in members]):
            stack = np.stack([run.images[k] for k in members]).astype(np.float32)
            empty.update(dict.fromkeys(members, background.estimate(stack, np.stack([inside[k] for k in members]))))
        else:
            single = run.each(lambda k: background.estimate_single(run.images[k].astype(np.float32), inside[k]), "background", members)
            empty.update(dict(zip(members, single, strict=True)))
    return empty


def _still(run: Run, views: list[View]) -> bool:
    """Tell whether a ring's camera stood still: the canister, a few millimetres off the table's axis, hardly moves in the picture."""
    heights = [float(view.centre_mm[2]) for view in views]
    axis = np.array([frames.apply(view.cam_from_canister, np.array([0.0, 0.0, np.mean(heights)])) for view in views])
    focal = run.dataset.scene.camera.focal_px[0]
    column, row = focal * axis[:, 0] / axis[:, 2], focal * axis[:, 1] / axis[:, 2]
    few_mm_px = 4.0 * focal / float(np.median(axis[:, 2]))
    return bool(np.ptp(column) < 2.0 * few_mm_px and np.ptp(row) < 2.0 * few_mm_px and np.ptp(axis[:, 2]) < 8.0)
