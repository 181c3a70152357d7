"""Tube stage: reconstruction of a tree of tubes, and of solids that no tube explains, from the measured coverage."""

from __future__ import annotations

from dataclasses import replace
from math import ceil

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.coverage.evidence import CORE_PX, Evidence
from rhizotwin.recon.hull.boxes import CellSet
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.optics import projection
from rhizotwin.recon.roots import density, ghosts, node_support, organs, search_space, tracing
from rhizotwin.recon.roots.density import Cells
from rhizotwin.recon.roots.organs import Core
from rhizotwin.recon.roots.refinement import TreeRefinement
from rhizotwin.recon.roots.root_tree import RootSystem, RootTree
from rhizotwin.recon.tubes import root_calibration, root_light, root_sway, tube_attenuation, tube_fit, tube_profiles, tubes
from rhizotwin.recon.tubes.root_light import LEAST_LONE
from rhizotwin.recon.tubes.tube_attenuation import TubeAttenuation
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.recon.tubes.tubes import Tubes
from rhizotwin.recon.tubes.view_correction import Viewed
from rhizotwin.scenes.monitor import Monitor

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_FLANK_PX = 0.5
"""Distance from the core, in addition to `CORE_PX`, within which cells are part of the taproot or hypocotyl, px."""
_BEYOND_PX = 1.25
"""Distance from the core, in addition to `CORE_PX`, within which the outermost parts of a taproot may lie, px. It is
half a pixel for the outline, plus the dilation."""
_LIGHT_PROFILES, _LIGHT_VIEWS = 100_000, 16
"""Number of profiles (nodes times views) to which attenuation, blur and root hairs are fitted, and minimum number of
views. The remaining views are used from the next fit on, or if too few of these profiles show lone roots.

The covariance of the light parameters depends mostly on the number of roots. Of a bean, 16 of 80 views gave the same
decision with a residual ratio of 0.849 instead of 0.847, in a fifth of the time."""


def find_tree(
    evidence: Evidence,
    cameras: Cameras,
    water: Water,
    learned_per_mm: float,
    *,
    known: TubeAttenuation | None = None,
    monitor: Monitor,
) -> RootTree | None:
    """Reconstruct the roots as a tree of tubes, or return None if there are none.

    Parameters
    ----------
    evidence, cameras : Evidence, Cameras
        Measured coverage, and the cameras of its views in the same order.
    learned_per_mm : float
        Attenuation with which opacity was converted to coverage, 1/mm. It is infinite for opaque roots, and for masks.
    known : TubeAttenuation, optional
        Attenuation of the same roots, estimated with other cameras.
    """
    px_a_mm = projection.px_a_mm(evidence.bank, water.centre_mm)
    margin_mm = (CORE_PX + _BEYOND_PX) / px_a_mm
    if (found := _trace(evidence, water, px_a_mm, margin_mm, monitor=monitor)) is None:
        return None
    cells, core, start = found
    has_crown = bool(start.centre_mm[start.branches[0][0], 2] > water.top_mm)
    with monitor.stage("tubes"):
        whole = evidence.usable
        evidence, solids, fitted, thick = _separate_solids(evidence, start, core, px_a_mm)
        depth = tracing.core_depth(cells, solids.index, reach_mm=margin_mm)
    with monitor.stage("translucency"):
        attenuation, evidence, fitted = _fit_light(evidence, fitted, thick, learned_per_mm, known)
    with monitor.stage("branches"):
        settle = TreeRefinement(evidence, replace(evidence, usable=whole), px_a_mm)
        fitted = settle.refine(fitted)
        fitted = fitted.keep(fitted.prune_mask(ghosts.find_short_leaves(fitted, organs.is_thick(fitted, px_a_mm))))
    with monitor.stage("residue"):
        fitted = settle.search(fitted, cells.select(depth <= depth.min()))
    solid = organs.find_solid_nodes(fitted, solids, margin_mm)
    if solid.all():
        return None
    thick = organs.is_thick(fitted, px_a_mm)
    with monitor.stage("sway"):
        viewed = root_sway.follow(Viewed(evidence, cameras, fitted, thick), px_a_mm=px_a_mm)
    return RootTree(
        tubes=viewed.tubes,
        solid=solid,
        solids_mm=solids.centre_mm,
        core_mm=core.cells.centre_mm,
        margin_mm=margin_mm,
        px_a_mm=px_a_mm,
        has_crown=has_crown,
        attenuation=attenuation,
        learned_per_mm=learned_per_mm,
        evidence=viewed.evidence,
        cameras=viewed.cameras,
    )


def _trace(evidence: Evidence, water: Water, px_a_mm: float, margin_mm: float, *, monitor: Monitor) -> tuple[Cells, Core, Tubes] | None:
    """Find the initial tubes.

    Return the cells that contain roots, the cores of thick parts, and the tubes. Return None if no root is found.
    """
    with monitor.stage("search"):
        cells, deep = search_space.carve_cells(evidence, water, px_a_mm, monitor=monitor)
        if not len(cells.index):
            return None
    with monitor.stage("density"):
        cells, depth = _estimate_density(evidence, cells, deep, px_a_mm, margin_mm)
    with monitor.stage("trace"):
        paths = tracing.trace(cells, depth) if len(cells.index) else []
        if not paths:
            return None
        inside = depth > 0.0
        core = Core(cells.select(inside), depth[inside])
        return cells, core, tubes.place_nodes([path.points_mm for path in paths], [tracing.first_radius(path) for path in paths])


def _separate_solids(evidence: Evidence, start: Tubes, core: Core, px_a_mm: float) -> tuple[Evidence, Cells, Tubes, Mask]:
    """Separate the solids from the traced tubes.

    Return the evidence without the pixels of solids, the cells in the cores of the solids, the tubes, and the mask (N,)
    of the nodes of thick roots.
    """
    start = tubes.trim_inside_parents(organs.thicken(start, core, px_a_mm)[0])
    start, thick = organs.thicken(start, core, px_a_mm)
    solids = organs.find_solids(core, start, thick, px_a_mm)
    evidence = evidence.exclude(organs.footprint(evidence, solids, CORE_PX + _BEYOND_PX)) if len(solids.index) else evidence
    return evidence, solids, start, thick


def _fit_light(
    evidence: Evidence, fitted: Tubes, thick: Mask, learned_per_mm: float, known: TubeAttenuation | None
) -> tuple[TubeAttenuation, Evidence, Tubes]:
    """Fit attenuation, blur and root hairs, to some of the views if these contain enough profiles.

    Return the attenuation, the evidence with the fitted parameters, and the tubes.
    """
    views = min(max(_LIGHT_VIEWS, ceil(_LIGHT_PROFILES / len(fitted.radius_mm))), evidence.bank.count)
    some = evidence.select_views(range(views))  # successive views have very different directions
    if tube_profiles.profiles(Rendering.draw(some, fitted)).is_lone[:, ~thick].sum() < LEAST_LONE:
        some = evidence
    if known is None:
        attenuation, fit = tube_attenuation.find(some, fitted, thick, learned_per_mm)
    else:
        attenuation, fit = known, tube_attenuation.follow(some, fitted, thick, learned_per_mm, known)
    return attenuation, replace(evidence, light=fit.evidence.light), fit.tubes


def _estimate_density(evidence: Evidence, cells: Cells, core: Cells, px_a_mm: float, margin_mm: float) -> tuple[Cells, Array]:
    """Estimate the density of roots in each cell.

    Return the cells that are not empty, and their depth (N,) below the surface of the core, mm. The cells of taproot
    and hypocotyl come last.
    """
    depth = tracing.core_depth(cells, core.index, reach_mm=margin_mm)
    organ = depth > -(CORE_PX + _FLANK_PX) / px_a_mm
    hides = cells.select(organ)
    rind = hides.select(CellSet.from_cells(hides.index).faces()[0])  # one layer covers everything behind it
    thin, number = density.estimate(evidence, cells.select(~organ), rind)
    return density.join(thin, hides), np.concatenate([depth[~organ][number], depth[organ]])


def has_swayed(tree: RootTree, cameras: Cameras) -> bool:
    """Return whether the roots moved so much between the pictures that they must be reconstructed again.

    The movement is measured relative to the given cameras.
    """
    return root_sway.has_moved(tree.evidence, cameras, tree.tubes, tree.px_a_mm)


def calibrate(tree: RootTree, *, monitor: Monitor) -> RootTree:
    """Estimate the refractive index of the water and refine the cameras from the roots, and refit the tubes.

    Returns
    -------
    RootTree
        Tree with refined cameras. ``cameras.roots`` is the estimate, or None if there are too few roots.
    """
    with monitor.stage("calibration"):
        viewed = root_calibration.calibrate(Viewed(tree.evidence, tree.cameras, tree.tubes, tree.thick))
        return replace(tree, evidence=viewed.evidence, tubes=viewed.tubes, cameras=viewed.cameras)


def finish_tree(tree: RootTree, *, monitor: Monitor) -> RootSystem:
    """Fit the tubes a last time, remove ghosts, and mark branch ends that are probably not root tips."""
    with monitor.stage("last tubes"):
        light = root_light.parameters(tree.evidence, tree.learned_per_mm)
        fit = tube_fit.fit(tree.evidence, tree.tubes, tree.thick, light=light)
        proved = node_support.compute_support(fit.rendering)
        gone = ghosts.find_ghosts(fit.tubes, proved, tree.thick, tree.px_a_mm)
        gone |= ghosts.find_overlapping(fit.tubes, tree.thick, tree.px_a_mm)
        found = fit.tubes.cut_detours(gone)
        stays = found.prune_mask(gone)
        found = found.keep(stays)
        thick = organs.is_thick(found, tree.px_a_mm)
        nodule = ghosts.find_nodules(found)
        uncertain = ghosts.find_uncertain_ends(found, fit.residual.visible[stays], proved.select(stays), thick) & ~nodule
    return RootSystem(
        tubes=found,
        solid=tree.solid[stays],
        solids_mm=tree.solids_mm,
        core_mm=tree.core_mm,
        margin_mm=tree.margin_mm,
        px_a_mm=tree.px_a_mm,
        has_crown=tree.has_crown,
        attenuation=tube_attenuation.update_attenuation(tree.attenuation, fit),
        learned_per_mm=tree.learned_per_mm,
        evidence=fit.evidence,
        cameras=tree.cameras,
        uncertain=uncertain,
        nodule=nodule,
    )
