"""Stages from silhouettes to a solid: outlines, hull, trimming, surface and extents."""

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import trimesh
from numpy.typing import NDArray

from rhizotwin.recon.carved_hull import CarvedHull
from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.coverage.measure import Coverage
from rhizotwin.recon.hull import surface, trimming
from rhizotwin.recon.hull.bodies import fill
from rhizotwin.recon.hull.centre_lines import centre_lines
from rhizotwin.recon.hull.leaves import Hull, Leaves, concatenate, fill_up, subtract, unite
from rhizotwin.recon.hull.spheres import Spheres, join
from rhizotwin.recon.hull.trimming import TrimmedHull
from rhizotwin.recon.results import parts
from rhizotwin.recon.results.result import Solid, triple
from rhizotwin.recon.roots import crown, rooting, tube_volume
from rhizotwin.recon.roots.root_tree import RootSystem, RootTree
from rhizotwin.recon.settings import Settings
from rhizotwin.recon.tubes import tube_mesh
from rhizotwin.recon.tubes.tube_attenuation import TubeAttenuation
from rhizotwin.recon.uncertainty.budget import Budget, Volume
from rhizotwin.recon.uncertainty.posterior import Posterior
from rhizotwin.recon.volume_budget import UnitedShape, assess_volume
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.monitor import Monitor

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
    hull, shape = carved.hull, _find_shape(carved, None if system is None else Posterior.compute(system), monitor)
    solids, volume_mm3 = shape.solids, shape.leaves.volume_mm3()
    # Upper bound: the hull with outlines moved outwards. Lower bound: the shape, minus the volume that solids lose when
    # outlines are moved inwards.
    moved_in_mm3 = shape.part.volume_mm3() / hull.leaves.volume_mm3() * (hull.leaves.volume_mm3() - hull.moved_in_mm3)
    thinner_mm3, thicker_mm3 = (0.0, 0.0) if system is None else tube_volume.slack_mm3(system)
    bounds = max(0.0, volume_mm3 - moved_in_mm3 - thinner_mm3), max(hull.moved_out_mm3, volume_mm3 + thicker_mm3)
    with monitor.stage("uncertainty"):
        assessed = assess_volume(carved, shape, settings, scattered=scattered)
    hidden, extrapolate, warnings = assessed.hidden, settings.hull.extrapolate_taproot, _warnings(assessed.budget, solids.kept_mm3)
    if hidden is not None:
        bounds = bounds[0], bounds[1] + hidden.interval_mm3[1] * extrapolate
        warnings = [*warnings, hidden.warning(is_added=extrapolate)]
    with monitor.stage("surface"):
        thin = () if system is None else tube_mesh.mesh_parts(system.tubes, tube_volume.find_thin(system, hull.leaves.grid.size_mm))
        mesh = make_surface(shape.thick, thin)
        volume = assessed.budget.volume(bounds)
        solid = measure(hull, shape.leaves, mesh, volume, voxel_mm=settings.voxel_mm, untrimmed_mm3=solids.kept_mm3)
    if hidden is not None:
        solid = replace(solid, hidden_mm=hidden.length_mm, hidden_height_mm=hidden.height_mm)
    solid = replace(solid, warnings=(*warnings, *solid.warnings), checks=assessed.checks)
    if system is None:
        learned_per_mm = coverage.attenuation.mu_per_mm
        return solid if learned_per_mm == np.inf else replace(solid, mu_per_mm=learned_per_mm)
    solid, light = replace(solid, roots=shape.roots, nodules=system.nodules()), system.attenuation.light
    if light.is_opaque:
        return solid
    return replace(solid, mu_per_mm=light.mu_per_mm, mu_sigma_per_mm=system.attenuation.sigma * light.mu_per_mm)


def _find_shape(carved: CarvedHull, posterior: Posterior | None, monitor: Monitor) -> UnitedShape:
    """Unite the tubes with the spheres in the solids, and with the parts of the hull that the silhouettes require.

    A thick root that is not round, or whose axis is tilted, is larger than its tube.
    """
    bank, maps, hull, system = carved.bank, carved.maps, carved.hull, None if posterior is None else posterior.system
    none = hull.leaves.select(slice(0))
    with monitor.stage("trim"):
        part = hull.leaves if system is None else hull.leaves.near(system.solids_mm, system.margin_mm)
        spheres, doubtful = trimming.grow_spheres(bank, maps, centre_lines(part))
        solids = fill(spheres.bodies, part)
    with monitor.stage("unite"):
        wide, thin = (none, none) if system is None else tube_volume.fill_tubes(system, hull)
        wide = unite(solids, wide)
        leaves = unite(wide, thin)
        outside, inside = subtract(hull.leaves, leaves), spheres
        if system is not None:
            thick = system.thick
            outside = outside.near(system.core_mm if thick.any() else system.solids_mm, system.margin_mm)
            inside = join([spheres, Spheres(system.tubes.centre_mm[thick], system.tubes.radius_mm[thick])])
        lacking, missing = trimming.find_missing(bank, maps, leaves, outside, inside)
    return UnitedShape(
        leaves=fill_up(leaves, missing),
        thick=fill_up(wide, missing),
        solids=TrimmedHull(concatenate([solids, missing]), spheres, doubtful, missing.volume_mm3()),
        part=concatenate([solids, lacking]),
        posterior=posterior,
    )


def make_surface(leaves: Leaves, tubes: Iterable[tuple[NDArray[np.float64], NDArray[np.int64]]] = ()) -> trimesh.Trimesh:
    """Return the closed surface of leaves and of tubes that are thinner than the leaves resolve.

    Parameters
    ----------
    leaves : Leaves
        Leaves of the parts that are thicker than a voxel.
    tubes : iterable
        Vertices (V, 3), mm, and faces (F, 3) of each tube.
    """
    while len(leaves.size) > _SURFACE_LEAVES:
        leaves = leaves.merge(1)
    thick = surface.surface(leaves)
    return surface.unite([(np.asarray(thick.vertices), np.asarray(thick.faces)), *tubes])


def measure(hull: Hull, leaves: Leaves, mesh: trimesh.Trimesh, volume: Volume, *, voxel_mm: float, untrimmed_mm3: float) -> Solid:
    """Merge leaves into voxels, and measure the extents.

    Parameters
    ----------
    hull : Hull
        Carved hull with its grid.
    leaves : Leaves
        Leaves of the solid.
    mesh : trimesh.Trimesh
        Surface of the solid (`make_surface`).
    volume : Volume
        Volume of the solid with its interval.
    voxel_mm : float
        Edge length of the output voxels, mm.
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
        volume=volume,
        hull_mm3=hull.leaves.volume_mm3(),
        untrimmed_mm3=untrimmed_mm3,
        blind_mm3=hull.blind_mm3,
        extents_min_mm=triple(low),
        extents_max_mm=triple(high),
        warnings=warnings,
    )


def _voxels(leaves: Leaves, voxel_mm: float) -> parts.Leaves:
    """Merge leaves into voxels with the given edge length."""
    voxels = leaves.merge(round(math.log2(voxel_mm / leaves.grid.size_mm)))
    origin_mm = np.asarray(leaves.grid.origin_mm, np.float64)
    return parts.Leaves(low=voxels.index, size=voxels.size, occupancy=voxels.occupancy, origin_mm=origin_mm, voxel_mm=voxel_mm)


def _warnings(budget: Budget, untrimmed_mm3: float) -> list[str]:
    """Return a list with a warning if much of the volume is untrimmed hull, and an empty list otherwise."""
    kept, found = untrimmed_mm3 / max(budget.volume_mm3, 1e-9), []
    if kept > _MUCH_KEPT:
        found.append(
            f"{100.0 * kept:.0f} % of the volume is untrimmed hull, which is usually too large. These parts are not roots, or they are "
            "roots too thin or too dense for the resolution. Use a higher picture resolution or a second ring."
        )
    return found
