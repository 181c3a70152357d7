"""Complete reconstruction from a dataset to a result, in memory.

The stages are called in this order: Dataset -> Cameras -> Coverage -> hull -> roots -> Solid -> Result.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rhizotwin.recon import carved_hull, passes, shaping
from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.calibration.curve import verify_curve
from rhizotwin.recon.calibration.find_cameras import find_cameras
from rhizotwin.recon.coverage.measure import Coverage, measure_coverage, remeasure_coverage
from rhizotwin.recon.device import release, tuned_process
from rhizotwin.recon.read_pictures import Pictures, picture_hash, read_pictures
from rhizotwin.recon.results import calibration_summary, divide_by_plant
from rhizotwin.recon.results.by_plant import PlantResult
from rhizotwin.recon.results.parts import Json
from rhizotwin.recon.results.result import Result, Solid
from rhizotwin.recon.roots import crown, plants, rooting
from rhizotwin.recon.roots.root_tree import RootSystem, RootTree
from rhizotwin.recon.settings import Settings, TrustSettings
from rhizotwin.recon.shoots.find_shoot import find_shoot
from rhizotwin.recon.stages import StageFolder
from rhizotwin.recon.uncertainty import checks, picture_checks, root_uncertainty, root_width, scattered_light, shape_checks
from rhizotwin.recon.uncertainty.checks import Check, Estimate
from rhizotwin.scenes import memory
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Listener, Monitor
from rhizotwin.scenes.provenance import versions
from rhizotwin.scenes.schema import to_plain

_VERSIONED = ("mitsuba", "drjit", "numba", "numpy", "scipy", "scikit-image", "opencv-python-headless", "trimesh")
"""Packages whose versions are recorded in the result."""
_SWAYS = 3
"""Maximum number of times that the hull and the roots are reconstructed again because the roots moved between the
pictures. If the tips move by half a millimetre, a third of the roots is missing in the first reconstruction."""
_WIDTH_VIEWS = 6
"""Number of views in which the width of thin roots is measured."""
_ON_DEVICE = ("evidence", "bank", "maps", "silhouettes")
"""Names of the fields of hull and roots that contain pictures or Dr.Jit arrays. These fields are not written to the
stage folder."""


@tuned_process()
def reconstruct(
    dataset: Dataset | Path | str,
    *,
    settings: Settings | None = None,
    mass_g: float | None = None,
    keep_stages: Path | str | None = None,
    monitor: Monitor | type[Any] | Listener | None = None,
) -> Result:
    """Reconstruct a dataset in memory; `Result.save` writes the result to a folder.

    Parameters
    ----------
    dataset : Dataset or path
        Dataset from `scenes.dataset.load_dataset`, or its folder.
    settings : Settings, optional
        Settings of all stages; by default, `Settings()`.
    mass_g : float, optional
        Measured mass of the roots, g; used only to compute traits.
    keep_stages : path, optional
        Folder for the results of the individual stages (`recon.stages`); by default, they are not written.
    monitor : Monitor, type of tqdm, callable or None
        Receives progress messages, and can cancel the reconstruction.

    Returns
    -------
    Result
        Shape, volume with its interval, roots, cameras and warnings.

    Raises
    ------
    UserError
        If the pictures cannot be used. The message names the file and suggests a correction.
    Cancelled
        If `Monitor.cancel` was called.
    """
    dataset, settings = dataset if isinstance(dataset, Dataset) else load_dataset(dataset), settings or Settings()
    stages, monitor = StageFolder.begin(keep_stages), _start_monitor(monitor)
    pictures = verify_curve(read_pictures(dataset, settings=settings.pictures, monitor=monitor), monitor=monitor)
    cameras = stages.keep("cameras", find_cameras(pictures, settings=settings.calibration, monitor=monitor))
    cameras, coverage = measure_coverage(pictures, cameras, settings=settings.coverage, monitor=monitor)
    cameras, coverage = cameras.leave_out({}, unread=pictures.left_out), stages.keep("coverage", coverage)
    pictures = replace(pictures, images=(), measured={})  # they take as much memory as all later stages
    (hull, tree), roots = _hull_and_tree(pictures, cameras, coverage, settings, stages, monitor), None
    cameras = hull.cameras
    of_pictures, scattered = _checks(pictures, cameras, coverage, settings.trust), _scattered_fraction(pictures, cameras, coverage)
    if tree is not None:
        cameras, settled = _finish_roots(tree, hull.water.top_mm, monitor)
        roots = stages.keep("roots", settled, leave=_ON_DEVICE)
        remeasured = remeasure_coverage(coverage, cameras, roots.attenuation.mu_per_mm, settings=settings.coverage, monitor=monitor)
        if remeasured is not coverage or (cameras.roots is not None and cameras.roots.believed):
            del hull  # later stages use one calibration and one attenuation
            coverage = remeasured
            hull = stages.keep("hull_again", carved_hull.find_hull(dataset, cameras, coverage, settings, monitor=monitor), leave=_ON_DEVICE)
    solid = stages.keep("solid", shaping.make_solid(hull, roots, coverage, settings, scattered=scattered, monitor=monitor))
    checked = checks.name_cause((*of_pictures, *solid.checks, shape_checks.check_forks(solid.roots)))
    solid, of_plants, plants_said = _divide_plants(_apply_checks(solid, checked), dataset.scene)
    shoot, shoot_said = find_shoot(dataset, settings=settings, monitor=monitor)
    warnings = (*pictures.warnings, *cameras.warnings, *_root_warnings(solid, roots), *plants_said, *shoot_said)
    found = gather(pictures, cameras, coverage, solid, warnings=warnings, checked=checked, settings=to_plain(settings), monitor=monitor)
    return replace(found, mass_g=mass_g, estimates=_estimates(hull, solid, scattered, monitor), plants=of_plants, shoot=shoot)


def _finish_roots(tree: RootTree, top_mm: float, monitor: Monitor) -> tuple[Cameras, RootSystem]:
    """Calibrate the cameras from the roots, and refine the roots. Return the cameras and the refined roots."""
    tree = rooting.calibrate(tree, monitor=monitor)
    return tree.cameras, crown.mark_hidden(rooting.finish_tree(tree, monitor=monitor), top_mm)


def _start_monitor(monitor: Monitor | type[Any] | Listener | None) -> Monitor:
    """Reset the counters of passes, and return a monitor that releases unused memory after each stage."""
    passes.begin()
    made = Monitor.of(monitor)
    made.after_stage = release
    return made


def _divide_plants(solid: Solid, scene: Scene) -> tuple[Solid, tuple[PlantResult, ...], tuple[str, ...]]:
    """Assign the roots to plants.

    Return the solid with the assigned roots, the results of the individual plants, and warnings.
    """
    if not scene.plants:
        return solid, (), ()
    if not solid.roots:
        return solid, (), ("no roots were found, so there are no roots to assign to the plants",)
    planted = plants.assign(solid.roots, scene.plants, grid_z_mm=scene.net_pot.grid_z_mm)
    shape = divide_by_plant.Shape(
        leaves=solid.voxels,
        surface=solid.surface,
        finest_mm=solid.finest_mm,
        volume_mm3=solid.volume.mm3,
        terms=solid.volume.terms,
        calibration=solid.volume.calibration,
    )
    found = divide_by_plant.measure(shape, planted, scene.plants, scene.subject)
    return replace(solid, roots=planted.roots), found, divide_by_plant.warnings(planted, found)


def _apply_checks(solid: Solid, checked: tuple[Check, ...]) -> Solid:
    """Mark the volume of a solid as not trusted if a check failed."""
    failed = checks.failure_reasons(checked)
    return replace(solid, volume=solid.volume.distrust(failed)) if failed else solid


def _root_warnings(solid: Solid, roots: RootSystem | None) -> tuple[str, ...]:
    """Return the warnings about the roots, the solid and the trust in the volume."""
    return (*(() if roots is None else roots.attenuation.warnings()), *solid.warnings, *_volume_objections(solid))


def _volume_objections(solid: Solid) -> tuple[str, ...]:
    """Return the reasons why the volume is not trusted. The tuple is empty if the volume is trusted."""
    return () if solid.volume.trusted else (solid.volume.verdict,)


def _estimates(carved: carved_hull.CarvedHull, solid: Solid, scattered: float | None, monitor: Monitor) -> tuple[Estimate, ...]:
    """Estimate total length, number of tips and mean diameter of the roots, with intervals and verdicts."""
    with monitor.stage("compare roots"):
        return root_uncertainty.estimates(
            solid.roots,
            carved.bank,
            carved.silhouettes,
            mu_per_mm=solid.mu_per_mm,
            lost=_volume_objections(solid),
            scattered=scattered,
            calibration=solid.volume.calibration,
        )


def _hull_and_tree(
    pictures: Pictures, cameras: Cameras, coverage: Coverage, settings: Settings, stages: StageFolder, monitor: Monitor
) -> tuple[carved_hull.CarvedHull, RootTree | None]:
    """Reconstruct the hull and the root tree. Both are reconstructed again if the roots moved between the pictures."""
    dataset, hull = pictures.dataset, _first_hull(pictures, cameras, coverage, settings, monitor)
    tree = shaping.find_roots(hull, coverage, dataset.scene, monitor=monitor)
    for _ in range(_SWAYS):
        if tree is None or not rooting.has_swayed(tree, hull.cameras):
            break
        cameras, known = tree.cameras, tree.attenuation
        del hull, tree  # free their memory before they are replaced
        hull = carved_hull.find_hull(dataset, cameras, coverage, settings, monitor=monitor)
        tree = shaping.find_roots(hull, coverage, dataset.scene, known=known, monitor=monitor)
    return stages.keep("hull", hull, leave=_ON_DEVICE), tree


def _first_hull(pictures: Pictures, cameras: Cameras, coverage: Coverage, settings: Settings, monitor: Monitor) -> carved_hull.CarvedHull:
    """Carve the hull, and carve it again without the views that contradict all others.

    If the hull is empty, the reasons why checks of the pictures failed are appended to the error message, because they
    are usually the cause.
    """
    dataset = pictures.dataset
    hull: carved_hull.CarvedHull | UserError
    try:
        hull = carved_hull.find_hull(dataset, cameras, coverage, settings, monitor=monitor)
        if carved_hull.missed_share(hull) <= settings.trust.missed[0]:
            return hull
    except UserError as error:
        failed = checks.failure_reasons(_checks(pictures, cameras, coverage, settings.trust))
        hull = UserError("; ".join([str(error).removesuffix("."), *failed]) + ".")
    wrong = carved_hull.find_wrong_views(dataset, cameras, coverage, monitor=monitor)
    if wrong:
        del hull
        return carved_hull.find_hull(dataset, cameras.leave_out(wrong), coverage, settings, monitor=monitor)
    if isinstance(hull, UserError):
        raise hull
    return hull


def _checks(pictures: Pictures, cameras: Cameras, coverage: Coverage, trust: TrustSettings) -> tuple[Check, ...]:
    """Check the quality of the pictures.

    Some checks are skipped if the dataset contains masks instead of pictures, or if it specifies the cameras.
    """
    dataset, found, order = pictures.dataset, cameras.markers, sorted(cameras.order)
    drawn = [coverage.silhouettes[k] for k in order]
    azimuth_deg = [float(np.rad2deg(np.arctan2(view.centre_mm[1], view.centre_mm[0]))) for view in cameras.views]
    width_px = root_width.thin_width_px(drawn[:: max(1, len(drawn) // _WIDTH_VIEWS)])
    made = [
        picture_checks.check_scan(dataset.origin, pictures.frames),
        picture_checks.check_resolution(width_px, dataset.scene.camera.image_wh, trust),
        picture_checks.check_views(azimuth_deg, len(cameras.all), trust),
    ]
    if not dataset.masks:
        exposures = coverage.select_exposures(order)
        made += [picture_checks.check_exposure(exposures, trust), shape_checks.check_dirt(coverage.dirt, trust)]
    if found is not None:
        made += [
            picture_checks.check_curve(pictures.curve),
            picture_checks.check_sharpness(found.blur_px, found.refocus_px, trust),
            picture_checks.check_markers(found.inset_px, found.after_px, trust),
            picture_checks.check_canister(found.canister, dataset.scene, trust),
        ]
    return tuple(made)


def _scattered_fraction(pictures: Pictures, cameras: Cameras, coverage: Coverage) -> float | None:
    """Return the fraction of light that is scattered around roots; None if the pictures do not show it."""
    order = sorted(cameras.order)
    return scattered_light.scattered_fraction([coverage.silhouettes[k] for k in order], [pictures.frames[k].station for k in order])


def gather(
    pictures: Pictures,
    cameras: Cameras,
    coverage: Coverage,
    solid: Solid,
    *,
    warnings: tuple[str, ...],
    checked: tuple[Check, ...] = (),
    settings: Json,
    monitor: Monitor,
) -> Result:
    """Assemble the result from the output of the stages.

    Parameters
    ----------
    pictures : Pictures
        Pictures of the roots, with their dataset and band.
    cameras, coverage, solid : Cameras, Coverage, Solid
        Output of the stages.
    warnings, checked : tuple of str, tuple of Check
        Warnings for the user, and results of the checks.
    settings : Json
        Settings of the reconstruction, which are recorded in the result.
    monitor : Monitor
        Provides the run times of the stages.

    Returns
    -------
    Result
        The result, not yet written to a folder.
    """
    dataset, files = pictures.dataset, [camera.file for camera in cameras.all]
    used = {camera.file for camera in cameras.all if camera.used}  # other cameras may have no readable file
    contents = {frame.file: picture_hash(dataset, frame) for frame in dataset.frames if frame.sha256 or frame.file in used}
    fill = {files[k]: share for k in range(len(files)) if (share := coverage.fill(k)) is not None}
    return Result(
        dataset=str(dataset.folder),
        dataset_sha256=dataset.sha256,
        scene=dataset.scene.name,
        subject=dataset.scene.subject,
        solution=dataset.scene.solution,
        strip=dataset.scene.strip,
        solid=solid,
        cameras=tuple(replace(camera, sha256=contents.get(camera.file, "")) for camera in cameras.all),
        fill=fill,
        bands=pictures.bands,
        rig=calibration_summary.summarize_cameras(cameras),
        warnings=warnings,
        checks=checked,
        timings_s=dict(monitor.timings_s),
        passes=passes.get_counts(),
        peak_memory_mib=memory.peak_mib(),
        settings=settings | {"finest_mm": solid.finest_mm},
        versions=versions(_VERSIONED),
        silhouettes={files[k]: silhouette for k, silhouette in coverage.silhouettes.items()},
    )
