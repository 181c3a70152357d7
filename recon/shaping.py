"""Stages from silhouettes to a solid: outlines, hull, trimming, surface and extents."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import trimesh
from numpy.typing import NDArray

from rhizotwin.recon.carved_hull import CarvedHull
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.measure import Coverage
from rhizotwin.recon.hull import surface, trimming
from rhizotwin.recon.hull.leaves import Hull, Leaves, concatenate, subtract, unite
from rhizotwin.recon.hull.spheres import Spheres
from rhizotwin.recon.results import parts
from rhizotwin.recon.results.result import Solid, triple
from rhizotwin.recon.roots import crown, rooting, tube_volume
from rhizotwin.recon.roots.root_tree import RootSystem, RootTree
from rhizotwin.recon.settings import Settings
from rhizotwin.recon.tubes import tube_mesh
from rhizotwin.recon.tubes.tube_attenuation import TubeAttenuation
from rhizotwin.recon.uncertainty import diameter_uncertainty
from rhizotwin.recon.uncertainty.budget import Budget
from rhizotwin.recon.volume_budget import UnitedShape, assess_volume
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.rsml import Root

_SURFACE_LEAVES = 1_000_000
"""Maximum number of finest leaves from which the surface is computed. Larger numbers of leaves are merged first."""
_MUCH_KEPT = 0.2
"""Maximum fraction of the volume that may be untrimmed hull without a warning. Untrimmed hull is the part of the visual
hull that was kept because round roots do not explain it."""


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
    evidence = replace(Evidence.from_silhouettes(carved.bank, carved.silhouettes, carved.maps.window), tops_mm=crown.tops(scene))
    return rooting.find_tree(evidence, carved.cameras, carved.water, coverage.attenuation.mu_per_mm, known=known, monitor=monitor)


def make_solid(
    carved: CarvedHull, system: RootSystem | None, coverage: Coverage, settings: Settings, *, scattered: float | None, monitor: Monitor
) -> Solid:
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
    scattered : float or None
        Fraction of light that is scattered around roots; None if it is unknown.
    monitor : Monitor
        Receives progress messages.

    Returns
    -------
    Solid
        Voxels, surface, and volume with its interval.
    """
    hull, roots = carved.hull, () if system is None else diameter_uncertainty.add_sigma(system.roots(), system)
    shape = _find_shape(carved, system, roots, monitor)
    solids, volume = shape.solids, shape.leaves.volume_mm3()
    # Upper bound: the hull with outlines moved outwards. Lower bound: the shape, minus the volume that solids lose when
    # outlines are moved inwards.
    moved_in_mm3 = shape.part.volume_mm3() / hull.leaves.volume_mm3() * (hull.leaves.volume_mm3() - hull.moved_in_mm3)
    bounds = max(0.0, volume - moved_in_mm3 - shape.thinner_mm3), max(hull.moved_out_mm3, volume + shape.thicker_mm3)
    with monitor.stage("uncertainty"):
        assessed = assess_volume(carved, shape, settings, scattered=scattered)
    hidden, extrapolate, warnings = assessed.hidden, settings.hull.extrapolate_taproot, _warnings(assessed.budget, solids.kept_mm3)
    if hidden is not None:
        bounds = bounds[0], bounds[1] + hidden.interval_mm3[1] * extrapolate
        warnings = [*warnings, hidden.warning(is_added=extrapolate)]
    with monitor.stage("surface"):
        thin = () if system is None or shape.thin is None else tube_mesh.mesh_parts(system.tubes, shape.thin)
        mesh = make_surface(shape.thick, thin)
        solid = measure(
            hull,
            shape.leaves,
            mesh,
            voxel_mm=settings.voxel_mm,
            budget=assessed.budget,
            bounds_mm3=bounds,
            untrimmed_mm3=solids.kept_mm3,
        )
    if hidden is not None:
        solid = replace(solid, hidden_mm=hidden.length_mm, hidden_height_mm=hidden.height_mm)
    solid = replace(solid, warnings=(*warnings, *solid.warnings), checks=assessed.checks)
    if system is None:
        learned_per_mm = coverage.attenuation.mu_per_mm
        return solid if learned_per_mm == np.inf else replace(solid, mu_per_mm=learned_per_mm)
    solid, light = replace(solid, roots=roots, nodules=system.nodules()), system.attenuation.light
    if light.is_opaque:
        return solid
    return replace(solid, mu_per_mm=light.mu_per_mm, mu_sigma_per_mm=system.attenuation.sigma * light.mu_per_mm)


def _find_shape(carved: CarvedHull, system: RootSystem | None, roots: Sequence[Root], monitor: Monitor) -> UnitedShape:
    """Unite the tubes with the trimmed hull of the solids, and with the parts of thick roots that they lack.

    A thick root that is not round, or whose axis is tilted, is larger than its tube. Of the hull, only those parts are
    added that the silhouettes require.
    """
    bank, maps, hull = carved.bank, carved.maps, carved.hull
    with monitor.stage("trim"):
        part = hull.leaves if system is None else hull.leaves.near(system.solids_mm, system.margin_mm)
        solids = trimming.trim(bank, maps, part)
    if system is None:
        return UnitedShape(leaves=solids.leaves, thick=solids.leaves, solids=solids, part=part)
    with monitor.stage("unite"):
        tubes = tube_volume.combine(solids.leaves, system, hull.widest)
        lacking, missing = _find_missing(carved, system, tubes.leaves)
        full = replace(missing, occupancy=missing.occupancy + tubes.leaves.occupancy_at(missing.index))
        leaves, thick = unite(tubes.leaves, full), unite(tubes.thick, full)
    return UnitedShape(
        leaves=leaves,
        thick=thick,
        thin=tubes.thin,
        solids=replace(solids, leaves=concatenate([solids.leaves, missing]), kept=np.concatenate([solids.kept, missing.occupancy])),
        part=concatenate([part, lacking]),
        thinner_mm3=tubes.thinner_mm3,
        thicker_mm3=tubes.thicker_mm3,
        system=system,
        roots=roots,
    )


def _find_missing(carved: CarvedHull, system: RootSystem, shape: Leaves) -> tuple[Leaves, Leaves]:
    """Return the finest nodes of the hull beside thick roots, and those of them that the silhouettes require."""
    thick, hull = system.thick, carved.hull.leaves
    if not thick.any():
        return hull.select(slice(0)), hull.select(slice(0))
    inside = Spheres(system.tubes.centre_mm[thick], system.tubes.radius_mm[thick])
    outside = subtract(hull, shape).near(system.core_mm, system.margin_mm)
    return trimming.find_missing(carved.bank, carved.maps, shape, outside, inside)


def make_surface(leaves: Leaves, tubes: Iterable[tuple[NDArray[np.float64], NDArray[np.int64]]] = ()) -> trimesh.Trimesh:
    """Return the closed surface of leaves and of tubes that are thinner than the leaves resolve.

    Parameters
    ----------
    leaves : Leaves
        Leaves of the parts that are thicker than a voxel.
    tubes : iterable
        Vertices (V, 3), mm, and faces (F, 3) of each tube.
    """
    units, merged = 1, (leaves.index, leaves.size, leaves.occupancy)
    while len(merged[1]) > _SURFACE_LEAVES:
        units *= 2
        merged = surface.to_voxels(leaves, units)
    thick = surface.surface(*merged, origin_mm=np.asarray(leaves.grid.origin_mm, np.float64), voxel_mm=units * leaves.grid.size_mm)
    return surface.unite([(np.asarray(thick.vertices), np.asarray(thick.faces)), *tubes])


def measure(
    hull: Hull,
    leaves: Leaves,
    mesh: trimesh.Trimesh,
    *,
    voxel_mm: float,
    budget: Budget,
    bounds_mm3: tuple[float, float],
    untrimmed_mm3: float,
) -> Solid:
    """Merge leaves into voxels, and measure the extents.

    Parameters
    ----------
    hull : Hull
        Carved hull with its grid.
    leaves : Leaves
        Leaves of the solid.
    mesh : trimesh.Trimesh
        Surface of the solid (`make_surface`).
    voxel_mm : float
        Edge length of the output voxels, mm.
    budget : Budget
        Error budget of the volume.
    bounds_mm3 : tuple of float
        Smallest and largest volume that the silhouettes allow.
    untrimmed_mm3 : float
        Volume of untrimmed hull within the solid.
    """
    warnings: tuple[str, ...] = ()
    voxels = _voxels(leaves, voxel_mm)
    if len(mesh.vertices):
        low, high = np.asarray(mesh.bounds, np.float64)
    else:
        warnings = ("the shape is thinner than the voxels everywhere, so its surface is empty. Choose a smaller --voxel-mm.",)
        corners = np.asarray(leaves.grid.origin_mm, np.float64) + voxel_mm * voxels.low
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
