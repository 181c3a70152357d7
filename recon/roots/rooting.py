"""The tube stage: from coverage to a tree of tubes, whatever their thickness, and the solids that no tube explains."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.coverage.evidence import CORE_PX, Evidence
from rhizotwin.recon.coverage.translucency import Attenuation
from rhizotwin.recon.hull.boxes import Scattered
from rhizotwin.recon.hull.carve import Water
from rhizotwin.recon.roots import density, ghosts, organs, proof, search_space, tracing
from rhizotwin.recon.roots.density import Cells
from rhizotwin.recon.roots.organs import Core
from rhizotwin.recon.roots.root_tree import RootSystem, RootTree
from rhizotwin.recon.roots.settling import AFTER_STEPS, Settling
from rhizotwin.recon.tubes import root_calibration, root_hairs, root_sway, tube_attenuation, tube_fit, tube_picture, tubes
from rhizotwin.recon.tubes.tube_attenuation import TubeAttenuation
from rhizotwin.recon.tubes.tubes import Tubes
from rhizotwin.scenes.monitor import Monitor

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_FLANK_PX = 0.5
"""About `CORE_PX` and this beyond a core point lies the flank of a taproot or hypocotyl."""
_BEYOND_PX = 1.25
"""Beyond `CORE_PX` about a core point, the rest of a taproot's flank: half a pixel of outline, and its swelling."""
_BLURS_PX = (0.0, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8)
"""Standard deviations of blurs that are tried, beside the square pixel's own."""
_BLUR_VIEWS = 24
"""Views in which blurs are tried: they come in an order that spreads neighbours over the turn."""
_FIRST_STEPS = 3
"""Steps of the fits, fewer than a whole one (`tube_fit.STEPS`): before the blur is known."""


def find(seen: Evidence, cameras: Cameras, water: Water, learned: Attenuation | None, *, monitor: Monitor) -> RootTree | None:
    """Find the roots as a tree of tubes; None where there are none.

    Parameters
    ----------
    seen, cameras : Evidence, Cameras
        Measured coverage, and the cameras of its views in their order.
    learned : Attenuation or None
        With which opacity became coverage; None where the pictures were silhouettes already.
    """
    px_a_mm = search_space.px_a_mm(seen, water)
    margin_mm = (CORE_PX + _BEYOND_PX) / px_a_mm
    found = _traced(seen, water, px_a_mm, margin_mm, monitor=monitor)
    if found is None:
        return None
    cells, core, start = found
    with monitor.stage("tubes"):
        whole = seen
        seen, solids, fitted, thick = _first_fit(seen, start, core, px_a_mm)
        depth = tracing.core_depth(cells, solids.index, reach_mm=margin_mm, most_mm=0.0)
    with monitor.stage("translucency"):
        attenuation, seen, fitted = _attenuated(seen, fitted, thick, learned)
    with monitor.stage("branches"):
        whole = replace(seen, seen=whole.seen)
        settle = Settling(seen, whole, attenuation.blur_px, px_a_mm)
        fitted = settle.settled(fitted, tube_fit.STEPS)
        fitted = fitted.keep(fitted.staying(ghosts.short_leaves(fitted, organs.is_thick(fitted, px_a_mm))))
    with monitor.stage("residue"):
        fitted = settle.searched(fitted, cells.chosen(depth <= depth.min()))
    solid = organs.in_solids(fitted, solids, margin_mm)
    if solid.all():
        return None
    thick = organs.is_thick(fitted, px_a_mm)
    with monitor.stage("sway"):
        seen, cameras, fitted = root_sway.follow(seen, cameras, fitted, thick, blur_px=attenuation.blur_px, px_a_mm=px_a_mm)
    if attenuation.mu_per_mm is not None:
        with monitor.stage("translucency again"):
            attenuation, seen, fitted = _refined(seen, fitted, thick, attenuation, learned)
    with monitor.stage("hairs"):
        attenuation, seen, fitted = root_hairs.find(seen, fitted, thick, attenuation)
        if seen.hairs is not None and attenuation.mu_per_mm is not None:  # what was fitted without them was fainter and wider
            attenuation, seen, fitted = _refined(seen, fitted, thick, attenuation, learned)
    return RootTree(
        tubes=fitted,
        solid=solid,
        solids_mm=solids.centre_mm,
        margin_mm=margin_mm,
        px_a_mm=px_a_mm,
        attenuation=attenuation,
        seen=seen,
        cameras=cameras,
    )


def _traced(seen: Evidence, water: Water, px_a_mm: float, margin_mm: float, *, monitor: Monitor) -> tuple[Cells, Core, Tubes] | None:
    """Find the first tubes.

    Return the cells that hold root, the cores of what is thick, and the tubes; None where there is no root.
    """
    with monitor.stage("search"):
        cells, deep = search_space.carve_cells(seen, water, px_a_mm, monitor=monitor)
        if not len(cells.index):
            return None
    with monitor.stage("density"):
        cells, depth = _weighed(seen, cells, deep, px_a_mm, margin_mm)
    with monitor.stage("trace"):
        paths = tracing.trace(cells, depth) if len(cells.index) else []
        if not paths:
            return None
        inside = depth > 0.0
        core = Core(cells.chosen(inside), depth[inside])
        return cells, core, tubes.string([path.points_mm for path in paths], [tracing.first_radius(path) for path in paths])


def _first_fit(seen: Evidence, start: Tubes, core: Core, px_a_mm: float) -> tuple[Evidence, Cells, Tubes, Mask]:
    """Fit the traced tubes beside the solids.

    Return what the pictures say beside these, their cores, the tubes, and the nodes (N,) that are thick.
    """
    start = tubes.from_axes(organs.thicken(start, core, px_a_mm)[0])
    start, thick = organs.thicken(start, core, px_a_mm)
    solids = organs.without_roots(core, start, thick, px_a_mm)
    seen = seen.beside(organs.footprint(seen, solids, CORE_PX + _BEYOND_PX)) if len(solids.index) else seen
    fitted, _ = tube_fit.fit(seen, start, thick, blur_px=0.0, steps=_FIRST_STEPS)
    return seen, solids, fitted, organs.is_thick(fitted, px_a_mm)


def _weighed(seen: Evidence, cells: Cells, core: Cells, px_a_mm: float, margin_mm: float) -> tuple[Cells, Array]:
    """Estimate how much root is in each cell.

    Return the cells that hold any, those of taproot and hypocotyl last, and their depth (N,), mm.
    """
    depth = tracing.core_depth(cells, core.index, reach_mm=margin_mm)
    organ = depth > -(CORE_PX + _FLANK_PX) / px_a_mm
    hides = cells.chosen(organ)
    rind = hides.chosen(Scattered.of(hides.index).faces()[0])  # one layer covers what is behind
    thin, number = density.estimate(seen, cells.chosen(~organ), rind)
    return density.join(thin, hides), np.concatenate([depth[~organ][number], depth[organ]])


def _refined(
    seen: Evidence, fitted: Tubes, thick: Mask, attenuation: TubeAttenuation, learned: Attenuation | None
) -> tuple[TubeAttenuation, Evidence, Tubes]:
    """Find the attenuation once more with all roots there, and fit the tubes with it; return as `_attenuated`."""
    attenuation, fitted = tube_attenuation.refine(seen, fitted, thick, attenuation, None if learned is None else learned.mu_per_mm)
    seen = replace(seen, mu_per_mm=attenuation.mu_per_mm)
    fitted, _ = tube_fit.fit(seen, fitted, thick, blur_px=attenuation.blur_px, steps=AFTER_STEPS)
    return attenuation, seen, fitted


def _attenuated(seen: Evidence, fitted: Tubes, thick: Mask, learned: Attenuation | None) -> tuple[TubeAttenuation, Evidence, Tubes]:
    """Find how much light thin roots let through; return that, what the pictures say then, and the tubes."""
    attenuation, fitted = tube_attenuation.find(
        seen, fitted, thick, find_blur(seen, fitted), None if learned is None else learned.mu_per_mm
    )
    if attenuation.mu_per_mm is None and learned is not None and learned.mu_per_mm is not None:
        # thick roots seemed translucent, and their coverage was raised, but thin ones are opaque: opacity itself is
        # their coverage
        seen = seen.by_light()
        fitted, _ = tube_fit.fit(seen, fitted, thick, blur_px=0.0, steps=_FIRST_STEPS)
        attenuation = replace(attenuation, blur_px=find_blur(seen, fitted))
    if attenuation.mu_per_mm is not None:
        seen = replace(seen.by_light(), mu_per_mm=attenuation.mu_per_mm)
    return attenuation, seen, fitted


def swayed(tree: RootTree, cameras: Cameras) -> bool:
    """Tell whether roots sway so far from where they were found, with some cameras, that they must be found anew."""
    return root_sway.is_far(tree.seen, cameras, tree.tubes, tree.px_a_mm)


def calibrate(tree: RootTree, *, monitor: Monitor) -> RootTree:
    """Ask the roots for the water's index and the cameras, and fit the tubes with what they told.

    Returns
    -------
    RootTree
        With cameras to go on with; ``cameras.roots`` tells what came of it, None where there are too few roots to tell.
    """
    with monitor.stage("calibration"):
        seen, fitted, cameras = root_calibration.calibrate(tree.seen, tree.cameras, tree.tubes, tree.thick, blur_px=tree.blur_px)
        return replace(tree, seen=seen, tubes=fitted, cameras=cameras)


def settle(tree: RootTree, *, monitor: Monitor) -> RootSystem:
    """Bring the tubes to rest, and tell which ends are likely none."""
    with monitor.stage("last tubes"):
        fitted, residual = tube_fit.fit(tree.seen, tree.tubes, tree.thick, blur_px=tree.blur_px, steps=AFTER_STEPS)
        uncertain = ghosts.uncertain_ends(fitted, residual.visible, proof.find(tree.seen, fitted, tree.blur_px), tree.thick)
    return RootSystem(
        tubes=fitted,
        solid=tree.solid,
        solids_mm=tree.solids_mm,
        margin_mm=tree.margin_mm,
        px_a_mm=tree.px_a_mm,
        attenuation=tree.attenuation,
        seen=tree.seen,
        cameras=tree.cameras,
        uncertain=uncertain,
    )


def find_blur(seen: Evidence, fitted: Tubes) -> float:
    """Find the blur with which the tubes explain the pictures best."""
    seen = seen.of_views(range(min(seen.bank.count, _BLUR_VIEWS)))
    at = seen.project(fitted.centre_mm)
    cost = []
    for blur_px in _BLURS_PX:
        _, difference = tube_picture.compared(seen, fitted, at, blur_px)
        cost.append(float(dr.sum(dr.square(mi.Float64(difference)))[0]))
    return _BLURS_PX[int(np.argmin(cost))]
