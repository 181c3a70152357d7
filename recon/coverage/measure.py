"""Coverage stage: estimate the empty backlight, and measure the coverage of every view."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from rhizotwin.recon.calibration import exposure
from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.calibration.exposure import Exposures
from rhizotwin.recon.coverage import background, outer_dirt, silhouettes, translucency, wall
from rhizotwin.recon.coverage.silhouettes import Image, Mask, Silhouette, Window, find_bounds
from rhizotwin.recon.coverage.translucency import Attenuation
from rhizotwin.recon.optics.cameras import View, project_inner
from rhizotwin.recon.read_pictures import Pictures
from rhizotwin.recon.settings import CoverageSettings
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.monitor import Monitor

_RING_VIEWS = 8
"""Minimum number of views of a static camera from which the empty backlight is estimated jointly. With fewer views, it
is estimated from each picture alone."""


Outline = Callable[[Image, Image, Mask], Silhouette]
"""Function that draws a silhouette from a picture, its empty backlight and its usable pixels."""


_LEARN_VIEWS = 16
"""Approximate number of views from which the attenuation of the roots is estimated."""
MOST_WRONG = 0.1
"""Maximum fraction of pictures that show no water, and of pictures that show no roots. Up to this fraction, the
pictures are excluded. Above it, the scan is rejected."""
_SAME = 0.2
"""Tolerance for the absolute logarithm of the ratio of two attenuations. Attenuations within the tolerance are treated
as equal. The value is the scatter of estimates from the widest roots."""


@dataclass(frozen=True, kw_only=True)
class Coverage:
    """Coverage of each pixel by roots, in every used view."""

    silhouettes: Mapping[int, Silhouette]
    """Silhouettes of the used views, keyed by frame number."""
    attenuation: Attenuation = Attenuation()
    """Attenuation and brightness of the roots, estimated from sufficiently wide roots. Without such roots, and in
    masks, roots are opaque and black."""
    exposures: Exposures | None = None
    """Exposures of the pictures, in the order of the silhouettes; None if not measured."""
    dirt: float | None = None
    """Fraction of the visible wall covered by films, bubbles and glare. None if there are too few views, or if there is
    no wall."""

    def select_exposures(self, frames: Collection[int]) -> Exposures | None:
        """Return the exposures of the frames with the given numbers; None if exposures were not measured."""
        places = [place for place, frame in enumerate(self.silhouettes) if frame in frames]
        return None if self.exposures is None else self.exposures.select(places)

    def fill(self, frame: int) -> float | None:
        """Return the fraction of the visible water that roots cover in a frame; None if the frame is not used."""
        silhouette = self.silhouettes.get(frame)
        return None if silhouette is None else float((silhouette.coverage[silhouette.usable] > 0.5).mean())


def measure_coverage(
    pictures: Pictures,
    cameras: Cameras,
    *,
    settings: CoverageSettings = CoverageSettings(),
    monitor: Monitor,
    outline: Outline | None = None,
) -> tuple[Cameras, Coverage]:
    """Measure the coverage of each pixel by roots in every view.

    Views that show no water or no root are excluded, and the remaining views are measured again.

    Parameters
    ----------
    pictures : Pictures
        Pictures of the roots.
    cameras : Cameras
        Cameras of the pictures.
    settings : CoverageSettings
        Thresholds for noise, dim pixels, glare, films and bubbles.
    monitor : Monitor
        Receives progress messages.
    outline : callable, optional
        Function that draws a silhouette from a picture. By default, coverage is measured.

    Returns
    -------
    Cameras
        Cameras without the excluded views.
    Coverage
        Coverage of the remaining views.

    Raises
    ------
    UserError
        If more than a tenth of the pictures show no water, or more than a tenth show no root.
    """
    found = _measure_all(pictures, cameras, settings, monitor, outline)
    drawn, names, most = found.silhouettes, pictures.frames, MOST_WRONG * len(cameras.order)
    dark = [False] * len(drawn) if found.exposures is None else found.exposures.dark
    blank = [k for k, is_dark in zip(drawn, dark, strict=True) if is_dark or not drawn[k].usable.any()]
    if len(blank) > most:
        name = names[blank[0]].file
        raise UserError(f"{name} does not show the water below the net pot. Check the camera, the backlight and the scene file.")
    empty = [k for k in cameras.order if k not in blank and not (drawn[k].coverage > 0.25).any()]
    if len(empty) > most:
        raise UserError(
            f"{names[empty[0]].file} has an empty silhouette ({len(empty)} of {len(drawn)} pictures do), because no root is visible. "
            "Exclude these pictures with --leave-out, or check the light and the focus."
        )
    reasons = dict.fromkeys(blank, "it does not show the water below the net pot") | dict.fromkeys(empty, "no root is visible in it")
    if reasons:
        cameras = cameras.leave_out(reasons)
        found = _measure_all(pictures, cameras, settings, monitor, outline)
    return cameras, found


def _measure_all(pictures: Pictures, cameras: Cameras, settings: CoverageSettings, monitor: Monitor, outline: Outline | None) -> Coverage:
    """Measure the coverage in all used views."""
    if pictures.dataset.masks:
        return _read_masks(pictures, cameras, monitor)
    if outline is None:
        return _measure_views(pictures, cameras, settings, monitor)
    return _draw_silhouettes(_estimate_backlight(pictures, cameras, settings, monitor), cameras.lens.image_wh, outline, monitor)


def _read_masks(pictures: Pictures, cameras: Cameras, monitor: Monitor) -> Coverage:
    """Convert masks, in which roots are white, to silhouettes."""
    optics = cameras.optics
    drawn = {}
    with monitor.stage("silhouettes"):
        for k, view in cameras.by_frame.items():
            picture = pictures.images[k].astype(np.float32) / np.iinfo(pictures.images[k].dtype).max
            usable = np.ones(picture.shape, bool) if optics.straight else background.water_mask(view, optics, pictures.dataset.scene)
            drawn[k] = Silhouette(np.where(usable, picture, 0.0).astype(np.float32), usable)
    return Coverage(silhouettes=drawn)


@dataclass(frozen=True)
class _Backlight:
    """Empty backlight of each used view, keyed by frame number.

    Only the window of the pictures that shows the water is stored.
    """

    window: Window
    pictures: Pictures
    """Pictures, cropped to the window."""
    cameras: Cameras
    """Cameras of the cropped pictures."""
    empty: dict[int, Image]
    """(h, w) pictures of the empty backlight."""
    usable: dict[int, Mask]
    """(h, w) masks of usable pixels, which are sufficiently bright and without glare."""
    lit: dict[int, Mask]
    """(h, w) masks of sufficiently bright pixels, including glare."""
    exposures: Exposures
    """Exposures of the pictures."""
    added: dict[int, Image | np.float32]
    """(h, w) light that the wall reflects, which is subtracted from the picture."""

    def subtract_reflections(self, frame: int) -> Image:
        """Return a cropped picture (h, w) without the light that the wall reflects."""
        return self.pictures.images[frame].astype(np.float32) - self.added[frame]


def _estimate_backlight(pictures: Pictures, cameras: Cameras, settings: CoverageSettings, monitor: Monitor) -> _Backlight:
    """Estimate the empty backlight of every view."""
    with monitor.stage("background"):
        scene, order, wh = pictures.dataset.scene, cameras.order, cameras.lens.image_wh
        inside = {k: background.water_mask(view, cameras.optics, scene) for k, view in cameras.by_frame.items()}
        stations = [pictures.frames[k].station for k in order]
        exposures = exposure.measure([pictures.images[k] for k in order], cameras.views, stations, cameras.optics, scene)
        window = _water_window(inside.values(), wh)
        inside = {k: mask[window.part].copy() for k, mask in inside.items()}
        gain = {k: np.broadcast_to(exposures.light(place, wh), wh[::-1])[window.part] for place, k in enumerate(order)}
        pictures = replace(pictures, images=tuple(image[window.part] for image in pictures.images))
        lens = cameras.lens.cropped(window.low_px, window.size_px)
        cameras = cameras.with_views([replace(view, camera=lens) for view in cameras.views], cameras.optics)
        empty, glare, added = _estimate_backgrounds(pictures, cameras, inside, gain, settings, monitor)
        lit = {k: background.bright_pixels(empty[k], inside[k], settings) for k in order}
        usable = {k: lit[k] & ~glare[k] for k in order}
        return _Backlight(window, pictures, cameras, empty, usable, lit, exposures, added)


def _water_window(inside: Collection[Mask], image_wh: tuple[int, int]) -> Window:
    """Return the window of the pictures that shows the water in any view, or whole pictures if none shows it.

    It begins at a point of the coarse grids on which lines of sight are computed.
    """
    low, high = find_bounds(reduce(np.logical_or, inside))
    low -= low % wall.STEP
    return Window.between(low, high) if (high > low).all() else Window((0, 0), image_wh)


def _draw_silhouettes(light: _Backlight, image_wh: tuple[int, int], outline: Outline, monitor: Monitor) -> Coverage:
    """Draw the silhouettes of all views with a given function."""
    with monitor.stage("silhouettes"):
        drawn = {k: outline(light.subtract_reflections(k), light.empty[k], light.usable[k]) for k in light.empty}
        return Coverage(silhouettes={k: one.paste(light.window, image_wh) for k, one in drawn.items()})


def _measure_views(pictures: Pictures, cameras: Cameras, settings: CoverageSettings, monitor: Monitor) -> Coverage:
    """Measure the coverage of all views relative to the empty backlight."""
    keys, image_wh, light = cameras.order, cameras.lens.image_wh, _estimate_backlight(pictures, cameras, settings, monitor)
    opacity = {k: silhouettes.opacity(light.subtract_reflections(k), light.empty[k], light.usable[k]) for k in keys}
    cameras, window, lit, exposures, usable = light.cameras, light.window, light.lit, light.exposures, light.usable
    del light  # it needs as much memory as all pictures
    with monitor.stage("wall"):
        opacity, usable, film = _remove_fouling(cameras, opacity, usable, settings, monitor)
    with monitor.stage("silhouettes"):
        some = keys[:: max(1, len(keys) // _LEARN_VIEWS)]
        px_a_mm = _px_a_mm(cameras)
        attenuation = translucency.learn([opacity[k] for k in some], [usable[k] for k in some], px_a_mm)

        def one(k: int) -> Silhouette:
            return _make_silhouette(opacity.pop(k), usable[k], attenuation, px_a_mm, settings).paste(window, image_wh)

        drawn = dict(zip(keys, monitor.each(one, "silhouettes", keys), strict=True))
    clear = sum(int(usable[k].sum()) for k in keys) / max(1, sum(int(lit[k].sum()) for k in keys))
    dirt = None if film is None else 1.0 - (1.0 - film) * clear
    return Coverage(silhouettes=drawn, attenuation=attenuation, exposures=exposures, dirt=dirt)


def remeasure_coverage(
    coverage: Coverage, cameras: Cameras, mu_per_mm: float, *, settings: CoverageSettings = CoverageSettings(), monitor: Monitor
) -> Coverage:
    """Measure the coverage again, with the attenuation that was estimated from the fitted roots.

    The first estimate of the attenuation uses only wide roots that do not overlap others, of which there may be too
    few. Thin translucent roots then appear opaque and narrow.

    Parameters
    ----------
    coverage : Coverage
        Coverage from the previous measurement.
    cameras : Cameras
        Cameras of the views.
    mu_per_mm : float
        Attenuation of the roots, 1/mm, which is infinite for opaque roots.
    settings : CoverageSettings
        Thresholds for noise.
    monitor : Monitor
        Receives progress messages.

    Returns
    -------
    Coverage
        New coverage. The previous coverage is returned if both attenuations agree, as those of masks do.
    """
    before_per_mm = coverage.attenuation.mu_per_mm
    if before_per_mm == mu_per_mm or abs(np.log(before_per_mm) - np.log(mu_per_mm)) < _SAME:
        return coverage
    attenuation, px_a_mm, drawn = replace(coverage.attenuation, mu_per_mm=mu_per_mm), _px_a_mm(cameras), coverage.silhouettes

    def one(k: int) -> Silhouette:
        dark = np.asarray(drawn[k].opacity, np.float32) * np.float32(1.0 - attenuation.own)
        return _make_silhouette(dark, drawn[k].usable, attenuation, px_a_mm, settings)

    with monitor.stage("silhouettes again"):
        return replace(
            coverage,
            silhouettes=dict(zip(drawn, monitor.each(one, "silhouettes", list(drawn)), strict=True)),
            attenuation=attenuation,
        )


def _make_silhouette(dark: Image, usable: Mask, attenuation: Attenuation, px_a_mm: float, settings: CoverageSettings) -> Silhouette:
    """Compute a silhouette from an opacity picture (H, W)."""
    drawn = silhouettes.suppress_noise(attenuation.coverage(dark, usable, px_a_mm), dark, usable, settings)
    # Noise is kept, so that faint roots do not lose their flanks.
    return replace(drawn, opacity=(dark / np.float32(1.0 - attenuation.own)).astype(np.float16))


def _remove_fouling(
    cameras: Cameras, opacity: dict[int, Image], usable: dict[int, Mask], settings: CoverageSettings, monitor: Monitor
) -> tuple[dict[int, Image], dict[int, Mask], float | None]:
    """Remove films, bubbles and dirt on the canister's wall from the opacity and the masks of usable pixels.

    Return the opacity, the masks of usable pixels, and the fraction of the wall that films cover. In air and with few
    views, the opacity and the masks are returned unchanged, and the fraction is None.

    The argument ``opacity`` is emptied to save memory.
    """
    keys, views, optics = cameras.order, cameras.by_frame, cameras.optics
    if len(keys) < _RING_VIEWS or optics.n_water == 1.0:
        return opacity, usable, None
    where = dict(zip(keys, monitor.each(lambda k: wall.crossings(views[k], optics), "wall", keys), strict=True))
    found = wall.detect_fouling(opacity, usable, where, optics, monitor, settings)
    cleared = monitor.each(lambda k: wall.remove_fouling(opacity.pop(k), usable[k], where[k], found), "clear", keys)
    free = {k: part for k, (part, _) in zip(keys, cleared, strict=True)}
    clear = {k: part for k, (_, part) in zip(keys, cleared, strict=True)}
    face = outer_dirt.outer_face(optics, _px_a_mm(cameras))
    dirty = outer_dirt.detect_dirt(free, clear, views, optics, face, monitor)
    if dirty.any():
        hidden = monitor.each(
            lambda k: outer_dirt.hidden_pixels(free[k], dirty, wall.crossings(views[k], optics, face), face), "outside", keys
        )
        clear = {k: clear[k] & ~part for k, part in zip(keys, hidden, strict=True)}
    return free, clear, float((found.film > 0.0).mean())


def _px_a_mm(cameras: Cameras) -> float:
    """Return the scale of the pictures at the canister's axis, at half the depth of the water, px/mm.

    It is the median over some views.
    """
    optics, scales = cameras.optics, []
    middle = np.array([0.0, 0.0, 0.5 * (optics.water_z_mm + optics.floor_z_mm)])
    for view in cameras.views[:: max(1, len(cameras.views) // _RING_VIEWS)]:
        x, y, _ = view.centre_mm / view.rho_mm
        px = project_inner(view, optics, middle + 0.5 * np.array([[-y, x, 0.0], [y, -x, 0.0]]))
        scales.append(np.linalg.norm(px[0] - px[1]))
    return float(np.median(scales))


def _estimate_backgrounds(
    pictures: Pictures,
    cameras: Cameras,
    inside: dict[int, Mask],
    gain: Mapping[int, Image],
    settings: CoverageSettings,
    monitor: Monitor,
) -> tuple[dict[int, Image], dict[int, Mask | np.bool_], dict[int, Image | np.float32]]:
    """Estimate the empty backlight of each view, its glare, and the light that the wall reflects.

    Views of a ring with a static camera are divided by their exposures (``gain``), and processed together. Other
    pictures are processed separately, without glare and reflections.
    """
    views, images, captured = cameras.by_frame, pictures.images, pictures.frames
    empty: dict[int, Image] = {}
    glare: dict[int, Mask | np.bool_] = dict.fromkeys(views, np.False_)
    added: dict[int, Image | np.float32] = dict.fromkeys(views, np.float32(0.0))
    flat = dict(zip(views, monitor.each(lambda k: background.wall_light(views[k], cameras.optics), "walls", list(views)), strict=True))
    for ring in sorted({captured[k].ring for k in views}):
        members = [k for k in views if captured[k].ring == ring]
        if len(members) >= _RING_VIEWS and _is_static([views[k] for k in members]):
            stack = np.empty((len(members), *images[members[0]].shape), np.float32)
            for view, k in zip(stack, members, strict=True):
                flat[k] = gain[k] * flat[k]
                view[:] = images[k] / flat[k]
            panel = background.estimate(stack, np.stack([inside[k] for k in members]), settings)
            del stack
            empty.update({k: panel.light * flat[k] for k in members})
            added.update({k: panel.added * flat[k] for k in members} if panel.added.any() else {})
            glare.update(dict.fromkeys(members, panel.glare))
        else:

            def from_itself(k: int) -> Image:
                return np.asarray(flat[k] * background.estimate_single((images[k] / flat[k]).astype(np.float32), inside[k], settings))

            single = monitor.each(from_itself, "background", members)
            empty.update(dict(zip(members, single, strict=True)))
    return empty, glare, added


def _is_static(views: list[View]) -> bool:
    """Return whether a ring's camera was static.

    If it was static, the canister's axis moves by at most 8 mm between the pictures, because it is only a few
    millimetres away from the table's axis.
    """
    height_mm = np.mean([view.centre_mm[2] for view in views])
    axis = [frames.apply(view.cam_from_canister, np.array([0.0, 0.0, height_mm])) for view in views]
    return bool(np.ptp(axis, axis=0).max() < 8.0)
