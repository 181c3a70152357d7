"""Stages from silhouettes to a solid: outlines, hull, trimming, surface and extents."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.measure import Coverage
from rhizotwin.recon.coverage.silhouettes import Silhouette
from rhizotwin.recon.hull import agreement, carve, surface, trimming
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.hull.distance_maps import DistanceMaps
from rhizotwin.recon.hull.leaves import Hull, Leaves
from rhizotwin.recon.optics import projection
from rhizotwin.recon.results import parts
from rhizotwin.recon.results.result import Solid, triple
from rhizotwin.recon.roots import crown, rooting, tube_volume
from rhizotwin.recon.roots.root_tree import RootSystem, RootTree
from rhizotwin.recon.settings import Settings
from rhizotwin.recon.tubes.tube_attenuation import TubeAttenuation
from rhizotwin.recon.uncertainty import (
    bare_uncertainty,
    canister_uncertainty,
    diameter_uncertainty,
    hidden_top,
    occlusion,
    root_uncertainty,
    shape_checks,
    solid_uncertainty,
    tube_uncertainty,
    wall_contact,
)
from rhizotwin.recon.uncertainty.budget import Budget, Term
from rhizotwin.recon.uncertainty.calibration import NOT_CALIBRATED, Calibration, find_calibration
from rhizotwin.recon.uncertainty.checks import Check
from rhizotwin.scenes import rsml
from rhizotwin.scenes.dataset import Dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.rsml import Root

_MISSED_VIEWS = 8
"""Number of views in which the coverage outside the projected hull is measured. These are the first views in processing
order, which are spread over the turn."""
_MISSED_LEAVES = 100_000
"""Maximum number of octree leaves that are projected to measure the coverage outside the hull. Larger hulls are
subsampled: in a picture, the leaves of a solid are less than one pixel apart, and hide each other."""
_SURFACE_LEAVES = 1_000_000
"""Maximum number of finest leaves from which the surface is computed. Larger numbers of leaves are merged first."""
_MUCH_KEPT = 0.2
"""Maximum fraction of the volume that may be untrimmed hull without a warning. Untrimmed hull is the part of the visual
hull that was kept because round roots do not explain it."""


@dataclass(frozen=True, kw_only=True)
class CarvedHull:
    """Carved hull with the silhouettes and cameras from which it was carved."""

    hull: Hull
    """The carved visual hull."""
    bank: projection.ViewBank
    """Views of the silhouettes, as arrays on the device for projection."""
    maps: DistanceMaps
    """Distance maps of the silhouettes' outlines."""
    silhouettes: tuple[Silhouette, ...]
    """Silhouettes of the views, in the order of ``bank``."""
    cameras: Cameras
    """Cameras of the views, in the order of ``bank``."""
    water: Water
    """Space in which the hull was carved."""


def carve_hull(
    dataset: Dataset,
    cameras: Cameras,
    coverage: Coverage,
    *,
    finest_mm: float,
    slack_px: float,
    monitor: Monitor,
    ignore_blindness: bool = False,
) -> CarvedHull:
    """Carve the visual hull of the silhouettes.

    Carving starts with all water between the floor and the net pot.

    Parameters
    ----------
    finest_mm : float
        Edge length of the finest octree nodes, mm.
    slack_px, ignore_blindness : float, bool
        See `carve.carve`.

    Raises
    ------
    UserError
        If the silhouettes have no volume in common.
    """
    numbers = sorted(cameras.order)
    order = [numbers[place] for place in carve.spread(len(numbers))]
    cameras = cameras.reorder(order)
    with monitor.stage("outlines"):
        drawn = tuple(coverage.silhouettes[k] for k in order)
        maps = DistanceMaps.compute(drawn, "outlines", monitor)
    with monitor.stage("carve"):
        bank = projection.ViewBank.pack(cameras.views, cameras.optics)
        water = water_space(dataset.scene, cameras)
        grid = water.grid(finest_mm)
        with monitor.steps("carve", grid.levels + 1, "level") as step:
            hull = carve.carve(bank, maps, grid, water, slack_px=slack_px, ignore_blindness=ignore_blindness, progress=step)
    if hull.leaves.volume_mm3() == 0.0:
        raise UserError(
            f"{dataset.folder}: the silhouettes have no volume in common, so no shape can be reconstructed. "
            "The camera poses or the scene file do not match the pictures."
        )
    return CarvedHull(hull=hull, bank=bank, maps=maps, silhouettes=drawn, cameras=cameras, water=water)


def find_wrong_views(dataset: Dataset, cameras: Cameras, coverage: Coverage, *, monitor: Monitor) -> dict[int, str]:
    """Find the views that contradict all others.

    The result is the reason for each of these views, keyed by frame number.

    Parameters
    ----------
    dataset, cameras, coverage : Dataset, Cameras, Coverage
        Dataset with the scene, cameras, and silhouettes of the views.
    monitor : Monitor
        Receives progress messages.
    """
    with monitor.stage("wrong views"):
        bank = projection.ViewBank.pack(cameras.views, cameras.optics)
        silhouettes = [coverage.silhouettes[k] for k in cameras.order]
        found = agreement.find_wrong_views(bank, silhouettes, water_space(dataset.scene, cameras))
    return {cameras.order[view]: "it contradicts all other pictures, for example because it is mirrored or cropped" for view in found}


def water_space(scene: Scene, cameras: Cameras) -> Water:
    """Return the space in which roots may lie.

    It extends from the floor to the grid of the net pot, or to the surface of the water if this is lower.
    """
    return Water(cameras.optics.inner_radius_mm, min(scene.water.level_mm, scene.net_pot.grid_z_mm), scene.canister.floor_z_mm)


def find_hull(dataset: Dataset, cameras: Cameras, coverage: Coverage, settings: Settings, *, monitor: Monitor) -> CarvedHull:
    """Carve the visual hull of the silhouettes with the voxel size of the settings.

    Parameters
    ----------
    dataset, cameras, coverage : Dataset, Cameras, Coverage
        Dataset with the scene, cameras, and silhouettes of the views.
    settings : Settings
        Voxel size, and slack of the outlines.
    monitor : Monitor
        Receives progress messages.
    """
    halvings = max(0, math.ceil(math.log2(settings.voxel_mm / settings.hull.finest_mm)))
    finest_mm = settings.voxel_mm / 2**halvings
    return carve_hull(dataset, cameras, coverage, finest_mm=finest_mm, slack_px=settings.hull.slack_px, monitor=monitor)


def missed_share(carved: CarvedHull) -> float:
    """Return the fraction of the coverage that the projected hull does not explain."""
    leaves = carved.hull.leaves
    leaves = leaves.select(np.s_[:: 1 + len(leaves.size) // _MISSED_LEAVES])
    views = list(range(min(_MISSED_VIEWS, carved.bank.count)))
    edge_mm = leaves.grid.size_mm * leaves.size.astype(np.float64)
    return agreement.compare(carved.bank.select(views), [carved.silhouettes[k] for k in views], leaves.middles_mm, edge_mm).share


def find_roots(
    carved: CarvedHull, coverage: Coverage, scene: Scene, *, known: TubeAttenuation | None = None, monitor: Monitor
) -> RootTree | None:
    """Reconstruct the roots as a tree of tubes.

    Parameters
    ----------
    carved : CarvedHull
        Carved hull with its views and silhouettes.
    coverage : Coverage
        Coverage with the attenuation of the roots.
    scene : Scene
        Scene with the positions of the plants.
    known : TubeAttenuation, optional
        See `rooting.find_tree`.
    monitor : Monitor
        Receives progress messages.

    Returns
    -------
    RootTree or None
        Tubes and solids, not yet divided into roots; None if there are no roots.
    """
    evidence = replace(Evidence.from_silhouettes(carved.bank, carved.silhouettes), tops_mm=crown.tops(scene))
    return rooting.find_tree(evidence, carved.cameras, carved.water, coverage.attenuation, known=known, monitor=monitor)


def make_solid(carved: CarvedHull, system: RootSystem | None, coverage: Coverage, settings: Settings, *, monitor: Monitor) -> Solid:
    """Unite the tubes with the trimmed hull of the solids, which no tube explains, and measure the united shape.

    Parameters
    ----------
    carved : CarvedHull
        Carved hull with its views and silhouettes.
    system : RootSystem or None
        Fitted roots; None if there are none.
    coverage : Coverage
        Coverage, with the attenuation of the roots.
    settings : Settings
        Voxel size, slack of the outlines, and limits of trust.
    monitor : Monitor
        Receives progress messages.

    Returns
    -------
    Solid
        Voxels, surface, and volume with its interval.
    """
    hull = carved.hull
    with monitor.stage("trim"):
        part = hull.leaves if system is None else hull.leaves.near(system.solids_mm, system.margin_mm)
        solids = trimming.trim(carved.bank, carved.maps, part)
    leaves, tubes = solids.leaves, None
    if system is not None:
        with monitor.stage("unite"):
            tubes = tube_volume.combine(solids.leaves, system, hull.widest)
        leaves = tubes.leaves
    volume = leaves.volume_mm3()
    # Upper bound: the hull with outlines moved outwards. Lower bound: the shape, minus the volume that solids lose when
    # outlines are moved inwards.
    moved_in_mm3 = part.volume_mm3() / hull.leaves.volume_mm3() * (hull.leaves.volume_mm3() - hull.moved_in_mm3)
    thinner, thicker = (0.0, 0.0) if tubes is None else (tubes.thinner_mm3, tubes.thicker_mm3)
    bounds = max(0.0, volume - moved_in_mm3 - thinner), max(hull.moved_out_mm3, volume + thicker)
    with monitor.stage("uncertainty"):
        missed = missed_share(carved)
        roots = () if system is None else diameter_uncertainty.add_sigma(system.roots(), system)
        hidden = _hidden_top(roots, carved)
        budget = _budget(
            carved, leaves, system, solids, part, wide=leaves if tubes is None else tubes.thick, missed=missed, settings=settings
        )
        if hidden is not None:
            budget = _add_hidden_top(budget, hidden, extrapolate=settings.hull.extrapolate_taproot)
            bounds = bounds[0], bounds[1] + hidden.interval_mm3[1] * settings.hull.extrapolate_taproot
        budget = replace(budget, terms=(*budget.terms, _merged_term(roots, carved, budget.volume_mm3)))
        budget = replace(budget, calibration=_calibration(carved, budget, roots, system, missed))
        checks = _checks(system, budget, missed)
    solid = measure(
        hull, leaves, voxel_mm=settings.voxel_mm, budget=budget, bounds_mm3=bounds, untrimmed_mm3=solids.kept_mm3, monitor=monitor
    )
    concealed = () if hidden is None else (hidden.warning(is_added=settings.hull.extrapolate_taproot),)
    solid = replace(solid, warnings=(*_warnings(budget, solids.kept_mm3), *solid.warnings, *concealed), checks=checks)
    if system is None:
        return replace(solid, mu_per_mm=None if coverage.attenuation is None else coverage.attenuation.mu_per_mm)
    attenuation = system.attenuation
    sigma = None if attenuation.mu_per_mm is None else attenuation.sigma * attenuation.mu_per_mm
    return replace(solid, roots=roots, mu_per_mm=attenuation.mu_per_mm, mu_sigma_per_mm=sigma)


def _hidden_top(roots: Sequence[Root], carved: CarvedHull) -> hidden_top.HiddenTop | None:
    """Estimate the parts of main roots that the net pot hides.

    Main roots are roots without a parent. The result is None if there are no main roots, or if no part of them is
    hidden.
    """
    main = [root for root in roots if root.parent < 0]
    if not main:
        return None
    # the rounded ends of the tubes, whose centre lines begin a radius below
    tops_mm = np.array([root.points_mm[0] + [0.0, 0.0, 0.5 * root.diameters_mm[0]] for root in main])
    return hidden_top.estimate_hidden(main, occlusion.gaps_mm(carved.bank, carved.maps, tops_mm, np.array([0.0, 0.0, 1.0]), carved.water))


def _add_hidden_top(budget: Budget, hidden: hidden_top.HiddenTop, *, extrapolate: bool) -> Budget:
    """Return a budget with the hidden tops of taproots: in the volume if extrapolated, else in the occluded parts."""
    if extrapolate:
        return replace(budget, volume_mm3=budget.volume_mm3 + hidden.volume_mm3, terms=(*budget.terms, hidden.term))
    most_mm3 = occlusion.ANYWHERE * hidden.interval_mm3[1]
    terms = [replace(t, more_mm3=max(t.more_mm3, most_mm3)) if t.name == "occluded" else t for t in budget.terms]
    return replace(budget, terms=tuple(terms))


def _merged_term(roots: Sequence[Root], carved: CarvedHull, volume_mm3: float) -> Term:
    """Return the term of roots that may be merged into thicker ones."""
    share = root_uncertainty.merged_share(roots, carved.bank, carved.silhouettes[0].coverage.shape)
    why = "many roots overlap in few views, so that some may be merged into thicker ones"
    return Term(name="merged roots", less_mm3=share * volume_mm3, more_mm3=0.0, why=why)


def _budget(
    carved: CarvedHull,
    leaves: Leaves,
    system: RootSystem | None,
    solids: trimming.TrimmedHull,
    part: Leaves,
    *,
    wide: Leaves,
    missed: float,
    settings: Settings,
) -> Budget:
    """Assemble the error budget of the volume from the terms of tubes, solids and cameras.

    Parameters
    ----------
    leaves, wide, part : Leaves
        Leaves of the whole shape, of thick roots and solids only, and of the hull around the solids.
    missed : float
        Fraction of the coverage that the hull does not explain, see `missed_share`.
    """
    volume_mm3 = leaves.volume_mm3()
    half = solid_uncertainty.half_excess(carved.bank, carved.cameras.order, carved.maps, carved.hull, solids, carved.water)
    tubes = None if system is None else tube_uncertainty.estimate(system)
    edges = None if carved.cameras.markers is None else carved.cameras.markers.canister
    terms = (
        *(() if tubes is None else tubes.terms),
        *solid_uncertainty.estimate_terms(
            carved.bank,
            carved.hull,
            part,
            solids,
            slack_px=settings.hull.slack_px,
            half_excess=half,
            missed=missed,
            binary=all(silhouette.binary for silhouette in carved.silhouettes),
        ),
        occlusion.occlusion_term(carved.bank, carved.maps, leaves, carved.water),
        wall_contact.wall_contact(wide, carved.water),
        solid_uncertainty.water_term(volume_mm3),
        *bare_uncertainty.camera_terms(
            carved.cameras.bare,
            leaves,
            views=carved.bank.count,
            mm3_per_px=solid_uncertainty.mm3_per_px(carved.hull, slack_px=settings.hull.slack_px),
        ),
        canister_uncertainty.canister_term(carved.cameras.views, carved.bank.optics, leaves, volume_mm3, edges=edges),
    )
    fill, unexplained = (0.0, 0.0) if tubes is None else (tubes.fill, tubes.unexplained)
    return Budget(volume_mm3=volume_mm3, terms=terms, views=carved.bank.count, unexplained=unexplained, fill=fill, trust=settings.trust)


def _calibration(carved: CarvedHull, budget: Budget, roots: Sequence[Root], system: RootSystem | None, missed: float) -> Calibration:
    """Return the calibration of the 90 % intervals.

    Only scans with greyscale photographs of a canister with markers, and without a tank, are calibrated.
    """
    if carved.cameras.markers is None or carved.bank.optics.tank is not None or any(one.binary for one in carved.silhouettes):
        return NOT_CALIBRATED
    hidden_mm3 = sum(term.more_mm3 for term in budget.terms if term.name == "occluded")
    return find_calibration(
        views=carved.bank.count,
        px_a_mm=projection.px_a_mm(carved.bank, carved.water.centre_mm),
        missed=missed,
        translucent=system is not None and system.attenuation.mu_per_mm is not None,
        width_mm=rsml.mean_diameter_mm(roots) if roots else None,
        hidden=hidden_mm3 / max(budget.volume_mm3, 1e-9),
    )


def _checks(system: RootSystem | None, budget: Budget, missed: float) -> tuple[Check, ...]:
    """Check the motion of the roots, and the agreement between the silhouettes and the shape."""
    calibration = None if system is None else system.cameras.roots
    sway_mm = None if system is None or calibration is None else calibration.after_px / system.px_a_mm
    agreed = shape_checks.check_agreement(missed=missed, unexplained=budget.unexplained, fill=budget.fill, trust=budget.trust)
    return shape_checks.check_motion(sway_mm, budget.trust), agreed


def measure(
    hull: Hull,
    leaves: Leaves,
    *,
    voxel_mm: float,
    budget: Budget,
    bounds_mm3: tuple[float, float],
    untrimmed_mm3: float,
    monitor: Monitor,
) -> Solid:
    """Merge leaves into voxels, compute the surface, and measure the extents.

    Parameters
    ----------
    hull : Hull
        Carved hull with its grid.
    leaves : Leaves
        Leaves of the solid.
    voxel_mm : float
        Edge length of the output voxels, mm.
    budget : Budget
        Error budget of the volume.
    bounds_mm3 : tuple of float
        Smallest and largest volume that the silhouettes allow.
    untrimmed_mm3 : float
        Volume of untrimmed hull within the solid.
    monitor : Monitor
        Receives progress messages.
    """
    warnings: tuple[str, ...] = ()
    with monitor.stage("surface"):
        voxels = _voxels(leaves, voxel_mm)
        units, parts = 1, (leaves.index, leaves.size, leaves.occupancy)
        while len(parts[1]) > _SURFACE_LEAVES:
            units *= 2
            parts = surface.to_voxels(leaves, units)
        origin_mm = np.asarray(leaves.grid.origin_mm, np.float64)
        mesh = surface.surface(*parts, origin_mm=origin_mm, voxel_mm=units * leaves.grid.size_mm)
        if len(mesh.vertices):
            low, high = np.asarray(mesh.bounds, np.float64)
        else:
            warnings = ("the shape is thinner than the voxels everywhere, so its surface is empty. Choose a smaller --voxel-mm.",)
            corners = origin_mm + voxel_mm * voxels.low
            low, high = corners.min(axis=0), (corners + voxel_mm * voxels.size[:, None]).max(axis=0)
        return Solid(
            voxels=voxels,
            hull=_voxels(hull.leaves, voxel_mm),
            finest_mm=leaves.grid.size_mm,
            mesh=mesh,
            volume=budget.volume(bounds_mm3),
            hull_mm3=hull.leaves.volume_mm3(),
            untrimmed_mm3=untrimmed_mm3,
            blind_mm3=hull.blind_mm3,
            extents_min_mm=triple(low),
            extents_max_mm=triple(high),
            warnings=warnings,
        )


def _voxels(leaves: Leaves, voxel_mm: float) -> parts.Leaves:
    """Merge leaves into voxels with the given edge length."""
    low, size, occupancy = surface.to_voxels(leaves, round(voxel_mm / leaves.grid.size_mm))
    origin_mm = np.asarray(leaves.grid.origin_mm, np.float64)
    return parts.Leaves(low=low, size=size, occupancy=occupancy, origin_mm=origin_mm, voxel_mm=voxel_mm)


def _warnings(budget: Budget, untrimmed_mm3: float) -> list[str]:
    """Return a list with a warning if much of the volume is untrimmed hull, and an empty list otherwise."""
    kept, found = untrimmed_mm3 / max(budget.volume_mm3, 1e-9), []
    if kept > _MUCH_KEPT:
        found.append(
            f"{100.0 * kept:.0f} % of the volume is untrimmed hull, which is usually too large. These parts are not roots, or they are "
            "roots too thin or too dense for the resolution. Use a higher picture resolution or a second ring."
        )
    return found
