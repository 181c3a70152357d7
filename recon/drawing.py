"""From pictures to silhouettes: the empty backlight of every view, and what roots cover of it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rhizotwin.recon.coverage import background, silhouettes, translucency, wall
from rhizotwin.recon.coverage.silhouettes import Image, Mask, Silhouette
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.recon.run import Run
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError

_RING_VIEWS = 8
"""With fewer views of a still camera the turn does not show the empty backlight."""


Outline = Callable[[Image, Image, Mask], Silhouette]
"""From picture, empty backlight and seen pixels to a silhouette."""


_LEARN_VIEWS = 16
"""Views from which the law of the roots' translucency is learnt."""


def draw(run: Run, views: dict[int, View], optics: Optics, *, outline: Outline | None = None) -> dict[int, Silhouette]:
    """Draw every view's silhouette.

    Parameters
    ----------
    views : the cameras by index of the frame.
    outline : how a silhouette comes from a picture, if not by measuring coverage.

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


def _measured(run: Run, views: dict[int, View], optics: Optics, outline: Outline | None) -> dict[int, Silhouette]:
    """Draw silhouettes against the empty backlight."""
    keys = list(views)
    with run.stage("background"):
        inside = {k: background.water_mask(view, optics, run.dataset.scene) for k, view in views.items()}
        empty, glare = _backgrounds(run, views, optics, inside)
        seen = {k: background.bright_enough(empty[k], inside[k]) & ~glare[k] for k in keys}
    if outline is not None:
        with run.stage("silhouettes"):
            return {k: outline(run.images[k].astype(np.float32), empty[k], seen[k]) for k in keys}
    opacity = {k: silhouettes.opacity(run.images[k].astype(np.float32), empty[k], seen[k]) for k in keys}
    with run.stage("wall"):
        opacity, seen = _without_wall(run, views, optics, opacity, seen)
    with run.stage("silhouettes"):
        some = keys[:: max(1, len(keys) // _LEARN_VIEWS)]
        px_a_mm = float(np.median([_scale(views[k], optics) for k in some[::4]]))
        law = translucency.learn([opacity[k] for k in some], [seen[k] for k in some], px_a_mm)
        run.law = law

        def one(k: int) -> Silhouette:
            clear = opacity[k] / np.float32(1.0 - law.own)  # noise and all, so that no faint root loses its flanks
            if law.mu_per_mm is None:
                drawn = silhouettes.measure(opacity[k], seen[k], own=law.own)
            else:
                covered = translucency.covered(opacity[k], law, px_a_mm)
                drawn = silhouettes.without_noise(covered, silhouettes.above_noise(opacity[k], seen[k]), seen[k])
            return replace(drawn, opacity=clear)

        return dict(zip(keys, run.each(one, "silhouettes", keys), strict=True))


def _without_wall(
    run: Run, views: dict[int, View], optics: Optics, opacity: dict[int, Image], seen: dict[int, Mask]
) -> tuple[dict[int, Image], dict[int, Mask]]:
    """Take off what clings to the wall; in air nothing does."""
    if len(views) < _RING_VIEWS or optics.n_water == 1.0:
        return opacity, seen
    keys = list(views)
    where = dict(zip(keys, run.each(lambda k: wall.crossings(views[k], optics), "wall", keys), strict=True))
    found = wall.study(opacity, seen, where, optics, run.each)
    cleared = run.each(lambda k: wall.cleared(opacity[k], seen[k], where[k], found), "clear", keys)
    return {k: part for k, (part, _) in zip(keys, cleared, strict=True)}, {k: part for k, (_, part) in zip(keys, cleared, strict=True)}


def _scale(view: View, optics: Optics) -> float:
    """Return px/mm across the canister's axis at half the water's depth."""
    middle = np.array([0.0, 0.0, 0.5 * (optics.water_z_mm + optics.floor_z_mm)])
    x, y, _ = view.centre_mm / view.rho_mm
    px, _ = cameras.project(view, optics, middle + 0.5 * np.array([[-y, x, 0.0], [y, -x, 0.0]]))
    return float(np.linalg.norm(px[0, 0] - px[1, 0]))


def _backgrounds(
    run: Run, views: dict[int, View], optics: Optics, inside: dict[int, Mask]
) -> tuple[dict[int, Image], dict[int, Mask | np.bool_]]:
    """Estimate the empty backlight of each view, and where glare lies on it, which only a turn tells.

    Ring by ring where the camera stood still, else picture by picture.
    """
    empty: dict[int, Image] = {}
    glare: dict[int, Mask | np.bool_] = dict.fromkeys(views, np.False_)
    walls = dict(zip(views, run.each(lambda k: background.wall_light(views[k], optics), "walls", list(views)), strict=True))
    for ring in sorted({run.frames[k].ring for k in views}):
        members = [k for k in views if run.frames[k].ring == ring]
        if len(members) >= _RING_VIEWS and _still(run, [views[k] for k in members]):
            stack = np.stack([run.images[k] / walls[k] for k in members]).astype(np.float32)
            panel, spots = background.estimate(stack, np.stack([inside[k] for k in members]))
            empty.update({k: panel * walls[k] for k in members})
            glare.update(dict.fromkeys(members, spots))
        else:

            def from_itself(k: int) -> Image:
                return np.asarray(walls[k] * background.estimate_single((run.images[k] / walls[k]).astype(np.float32), inside[k]))

            single = run.each(from_itself, "background", members)
            empty.update(dict(zip(members, single, strict=True)))
    return empty, glare


def _still(run: Run, views: list[View]) -> bool:
    """Tell whether a ring's camera stood still: the canister, a few millimetres off the table's axis, hardly moves in the picture."""
    heights = [float(view.centre_mm[2]) for view in views]
    axis = np.array([frames.apply(view.cam_from_canister, np.array([0.0, 0.0, np.mean(heights)])) for view in views])
    focal = run.dataset.scene.camera.focal_px[0]
    column, row = focal * axis[:, 0] / axis[:, 2], focal * axis[:, 1] / axis[:, 2]
    few_mm_px = 4.0 * focal / float(np.median(axis[:, 2]))
    return bool(np.ptp(column) < 2.0 * few_mm_px and np.ptp(row) < 2.0 * few_mm_px and np.ptp(axis[:, 2]) < 8.0)
