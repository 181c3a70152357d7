"""Complete reconstruction from a dataset to a result, in memory.

The stages are called in this order: Dataset -> Cameras -> Coverage -> hull -> roots -> Solid -> Result.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rhizotwin.recon import carved_hull, passes, shaping
from rhizotwin.recon.calibration.cameras import HELD_OUT, Cameras
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
from rhizotwin.recon.settings import Settings
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
    scan = _measure_scan(dataset, settings or Settings(), StageFolder.begin(keep_stages), _start_monitor(monitor))
    shape = _find_shape(scan)
    solid = scan.stages.keep(
        "solid", shaping.make_solid(shape.hull, shape.roots, shape.coverage, scan.settings, scattered=shape.scattered, monitor=scan.monitor)
    )
    checked = checks.name_cause((*shape.checks, *solid.checks, shape_checks.check_forks(solid.roots)))
    divided, of_plants, of_division = _divide_plants(_apply_checks(solid, checked), scan.dataset.scene)
    shoot, of_shoot = find_shoot(scan.dataset, settings=scan.settings, monitor=scan.monitor)
    warnings = (*scan.pictures.warnings, *shape.cameras.warnings, *_root_warnings(divided, shape.roots), *of_division, *of_shoot)
    result = gather(
        scan.pictures,
        shape.cameras,
        shape.coverage,
        divided,
        warnings=warnings,
        checked=checked,
        settings=to_plain(scan.settings),
        monitor=scan.monitor,
    )
    estimates = _estimates(shape, divided, scan.monitor)
    return replace(result, mass_g=mass_g, estimates=estimates, plants=of_plants, shoot=shoot)


@dataclass(frozen=True, kw_only=True)
class _Scan:
    """Pictures of a scan, with the cameras that the markers determine, and the coverage."""

    pictures: Pictures
    """Pictures, without their images."""
    cameras: Cameras
    coverage: Coverage
    settings: Settings
    stages: StageFolder
    monitor: Monitor

    @property
    def dataset(self) -> Dataset:
        """Dataset of the pictures."""
        return self.pictures.dataset

    def carve(self, cameras: Cameras, coverage: Coverage | None = None) -> carved_hull.CarvedHull:
        """Carve the hull with given cameras: from a given coverage, or into voxels from that of the scan."""
        fine = coverage is not None
        return carved_hull.find_hull(self.dataset, cameras, coverage or self.coverage, self.settings, fine=fine, monitor=self.monitor)


def _measure_scan(dataset: Dataset | Path | str, settings: Settings, stages: StageFolder, monitor: Monitor) -> _Scan:
    """Read the pictures, find the cameras, and measure the coverage."""
    read = read_pictures(dataset if isinstance(dataset, Dataset) else load_dataset(dataset), settings=settings.pictures, monitor=monitor)
    pictures = verify_curve(read, monitor=monitor)
    found = find_cameras(pictures, settings=settings.calibration, monitor=monitor)
    marked = stages.keep("cameras", found.hold_out(settings.pictures.hold_out))
    cameras, coverage = measure_coverage(pictures, marked, settings=settings.coverage, monitor=monitor)
    return _Scan(
        pictures=replace(pictures, images=(), measured={}),  # they take as much memory as all later stages
        cameras=cameras.leave_out({}, unread=pictures.left_out),
        coverage=stages.keep("coverage", coverage),
        settings=settings,
        stages=stages,
        monitor=monitor,
    )


@dataclass(frozen=True, kw_only=True)
class _Shape:
    """Hull and roots, with the cameras and the coverage from which they were reconstructed."""

    hull: carved_hull.CarvedHull
    roots: RootSystem | None
    cameras: Cameras
    coverage: Coverage
    checks: tuple[Check, ...]
    """Checks of the pictures."""
    scattered: float | None
    """Fraction of light that is scattered around roots; None if the pictures do not show it."""


def _find_shape(scan: _Scan) -> _Shape:
    """Reconstruct hull and roots, with the cameras and the attenuation that the roots determine."""
    cameras, tree = _follow_sway(scan)
    of_pictures, scattered = _checks(scan, cameras), _scattered_fraction(scan, cameras)
    roots: RootSystem | None = None
    coverage = scan.coverage
    if tree is not None:
        calibrated = rooting.calibrate(tree, monitor=scan.monitor)
        cameras, finished = calibrated.cameras, rooting.finish_tree(calibrated, monitor=scan.monitor)
        top_mm = carved_hull.water_space(scan.dataset.scene, cameras).top_mm
        roots = scan.stages.keep("roots", crown.mark_hidden(finished, top_mm), leave=_ON_DEVICE)
        mu_per_mm = roots.attenuation.light.mu_per_mm
        coverage = remeasure_coverage(coverage, cameras, mu_per_mm, settings=scan.settings.coverage, monitor=scan.monitor)
    hull = scan.stages.keep("hull", scan.carve(cameras, coverage), leave=_ON_DEVICE)
    return _Shape(hull=hull, roots=roots, cameras=cameras, coverage=coverage, checks=of_pictures, scattered=scattered)


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


def _estimates(shape: _Shape, solid: Solid, monitor: Monitor) -> tuple[Estimate, ...]:
    """Estimate total length, number of tips and mean diameter of the roots, with intervals and verdicts."""
    carved, system = shape.hull, shape.roots
    if system is None:
        return ()
    known = root_uncertainty.Known(
        lost=_volume_objections(solid),
        hull=solid.hull_mm3 / max(solid.volume.mm3, 1e-9),
        nodules=solid.nodules,
        flat=sum(term.less_mm3 for term in solid.volume.terms if term.name == "flat roots") / max(solid.volume.mm3, 1e-9),
        hidden_mm=solid.hidden_mm,
        scattered=shape.scattered or 0.0,
    )
    with monitor.stage("compare roots"):
        window = system.evidence.window
        return root_uncertainty.estimates(
            solid.roots,
            carved.bank.crop(window.low_px),
            [silhouette.cut(window) for silhouette in carved.silhouettes],
            system.rendering.coverage,
            known=known,
            calibration=solid.volume.calibration,
        )


def _follow_sway(scan: _Scan) -> tuple[Cameras, RootTree | None]:
    """Return the cameras and the root tree. The tree is reconstructed again if the roots moved between the pictures."""
    hull = _first_hull(scan)
    tree = shaping.find_roots(hull, scan.coverage, scan.dataset.scene, monitor=scan.monitor)
    for _ in range(_SWAYS):
        if tree is None or not rooting.has_swayed(tree, hull.cameras):
            break
        cameras, known = tree.cameras, tree.attenuation
        del hull, tree  # free their memory before they are replaced
        hull = scan.carve(cameras)
        tree = shaping.find_roots(hull, scan.coverage, scan.dataset.scene, known=known, monitor=scan.monitor)
    return hull.cameras, tree


def _first_hull(scan: _Scan) -> carved_hull.CarvedHull:
    """Carve the hull into voxels, and carve it again without the views that contradict all others.

    If the hull is empty, the reasons why checks of the pictures failed are appended to the error message, because they
    are usually the cause.
    """
    hull: carved_hull.CarvedHull | UserError
    try:
        hull = scan.carve(scan.cameras)
        if carved_hull.missed_share(hull) <= scan.settings.trust.missed[0]:
            return hull
    except UserError as error:
        failed = checks.failure_reasons(_checks(scan, scan.cameras))
        hull = UserError("; ".join([str(error).removesuffix("."), *failed]) + ".")
    wrong = carved_hull.find_wrong_views(scan.dataset, scan.cameras, scan.coverage, monitor=scan.monitor)
    if wrong:
        del hull
        return scan.carve(scan.cameras.leave_out(wrong))
    if isinstance(hull, UserError):
        raise hull
    return hull


def _checks(scan: _Scan, cameras: Cameras) -> tuple[Check, ...]:
    """Check the quality of the pictures of some cameras.

    Some checks are skipped if the dataset contains masks instead of pictures, or if it specifies the cameras.
    """
    pictures, coverage, trust = scan.pictures, scan.coverage, scan.settings.trust
    dataset, found, order = scan.dataset, cameras.markers, sorted(cameras.order)
    drawn = [coverage.silhouettes[k] for k in order]
    azimuth_deg = [float(np.rad2deg(np.arctan2(view.centre_mm[1], view.centre_mm[0]))) for view in cameras.views]
    width_px = root_width.thin_width_px(drawn[:: max(1, len(drawn) // _WIDTH_VIEWS)])
    made = [
        picture_checks.check_scan(dataset.origin, pictures.frames),
        picture_checks.check_resolution(width_px, dataset.scene.camera.image_wh, trust),
        picture_checks.check_views(azimuth_deg, len(cameras.all) - len(cameras.held_out), trust),
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


def _scattered_fraction(scan: _Scan, cameras: Cameras) -> float | None:
    """Return the fraction of light that is scattered around roots; None if the pictures do not show it."""
    order = sorted(cameras.order)
    stations = [scan.pictures.frames[k].station for k in order]
    return scattered_light.scattered_fraction([scan.coverage.silhouettes[k] for k in order], stations)


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
    used = {camera.file for camera in cameras.all if camera.used or camera.reason == HELD_OUT}  # other cameras may have no readable file
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
