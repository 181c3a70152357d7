"""The tube stage: from coverage to a tree of tubes, whatever their thickness, and the solids that no tube explains."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import drjit as dr
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from rhizotwin.recon.calibration.cameras import Cameras
from rhizotwin.recon.coverage import evidence
from rhizotwin.recon.coverage.evidence import CORE_PX, Evidence
from rhizotwin.recon.coverage.silhouettes import Image, Silhouette, Window
from rhizotwin.recon.coverage.translucency import Attenuation
from rhizotwin.recon.device import Float
from rhizotwin.recon.hull import carve, parsimony
from rhizotwin.recon.hull.carve import DistanceMaps, Grid, Water
from rhizotwin.recon.hull.parsimony import Spheres
from rhizotwin.recon.roots import density, ghosts, hierarchy, linking, organs, proof, residue, tracing
from rhizotwin.recon.roots.density import Cells
from rhizotwin.recon.roots.proof import Proof
from rhizotwin.recon.tubes import root_calibration, tube_attenuation, tube_fit, tube_picture, tube_profiles, tubes
from rhizotwin.recon.tubes.tube_attenuation import TubeAttenuation
from rhizotwin.recon.tubes.tube_profiles import ResidualGradient
from rhizotwin.recon.tubes.tubes import Tubes
from rhizotwin.scenes.monitor import Monitor
from rhizotwin.scenes.rsml import Root

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_CELL_PX = 0.75
"""Edge of the cells of the search space, seen from the cameras."""
_MOST_CELLS = 2_000_000
"""A search space with more cells is made coarser: its footprints in all views must fit in memory."""
_THIN_MM = (0.05, 0.3)
"""Radii that shadows can tell at the start; thicker roots shade their own cells."""
_FLANK_PX = 0.5
"""About `CORE_PX` and this beyond a core point lies the flank of a thick organ."""
_BEYOND_PX = 1.25
"""Beyond `CORE_PX` about a core point, the rest of a thick organ's flank: half a pixel of outline, and its swelling."""
_BLURS_PX = (0.0, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8)
"""Standard deviations of blurs that are tried, beside the square pixel's own."""
_BLUR_VIEWS = 24
"""Views in which blurs are tried: they come in an order that spreads neighbours over the turn."""
_SEARCHES = 2
"""Searches for roots that the tubes leave unexplained; the second finds what hung on the first's."""
_FIRST_STEPS = 3
"""Steps of the fits, fewer than a whole one (`tube_fit.STEPS`): before the blur is known ..."""
_BETWEEN_STEPS = 4
"""... between searches ..."""
_LAST_STEPS = 4
"""... before ends are judged ..."""
_AFTER_STEPS = 2
"""... and after something that all roots share has changed a little."""


@dataclass(frozen=True, kw_only=True)
class RootTree:
    """Roots found as tubes, with what they were fitted to."""

    tubes: Tubes
    buried: Mask
    """(N,) nodes within thick organs, whose shape the trimmed hull gives."""
    organ: Mask
    """(N,) nodes that are thick organs: they are not fitted."""
    solid: Mask
    """(N,) nodes in what no root explains: spheres, boxes and bulbs."""
    core_mm: Array
    """(M, 3) points deep inside thick organs."""
    margin_mm: float
    """Within this of a core point lies the whole of a thick organ."""
    px_a_mm: float
    attenuation: TubeAttenuation
    """How much light roots let through, and how blurred the pictures are."""
    seen: Evidence
    """What it was fitted to."""
    cameras: Cameras
    """Those of ``seen``."""

    @property
    def blur_px(self) -> float:
        """Return the standard deviation of the pictures' blur."""
        return self.attenuation.blur_px


@dataclass(frozen=True, kw_only=True)
class RootSystem(RootTree):
    """Roots at rest."""

    uncertain: Mask
    """(N,) nodes of ends whose tips are likely none."""

    def roots(self) -> tuple[Root, ...]:
        """Return the branches as roots, parents before children."""
        number = np.full(len(self.solid), -1)  # the root that each node is of
        roots: list[Root] = []
        for k, nodes in enumerate(self.tubes.branches):
            diameters = 2.0 * self.tubes.radii(k)
            for run in np.split(np.arange(len(nodes)), np.flatnonzero(np.diff(self.solid[nodes].astype(np.int64))) + 1):
                own = nodes[run]
                if self.solid[own[0]] or len(own) < 2:
                    continue
                parent = int(number[own[0]]) if run[0] == 0 and k > 0 else -1
                number[own[number[own] < 0]] = len(roots)
                order, seen = (roots[parent].order + 1 if parent >= 0 else 0), not (self.uncertain | self.solid)[nodes[run[-1]]]
                root = Root(points_mm=self.tubes.centre_mm[own], diameters_mm=diameters[run], order=order, parent=parent, tip_seen=seen)
                roots.append(root)
        return hierarchy.arrange(roots)


def find(
    seen: Evidence, cameras: Cameras, spheres: Spheres, water: Water, learned: Attenuation | None, *, monitor: Monitor
) -> RootTree | None:
    """Find the roots as a tree of tubes; None where there are none.

    Parameters
    ----------
    seen, cameras : Evidence, Cameras
        Measured coverage, and the cameras of its views in their order.
    spheres : Spheres
        Inside the hull, as `parsimony.trim` grew them.
    learned : Attenuation or None
        With which opacity became coverage; None where the pictures were silhouettes already.
    """
    px_a_mm = _scale(seen, water)
    margin_mm = (CORE_PX + _BEYOND_PX) / px_a_mm
    with monitor.stage("search"):
        cells, core = _search_space(seen, water, _CELL_PX / px_a_mm, monitor)
        if not len(cells.index):
            return None
        dr.flush_malloc_cache()  # what carving left to be used again is in the footprints' way, and these in what follows
    with monitor.stage("density"):
        cells, depth = _weighed(seen, cells, core, px_a_mm, margin_mm)
        dr.flush_malloc_cache()
    with monitor.stage("trace"):
        paths = tracing.trace(cells, depth) if len(cells.index) else []
        if not paths:
            return None
        start = tubes.string([path.points_mm for path in paths], [_first_radius(path) for path in paths])
    with monitor.stage("tubes"):
        near_mm = 1.5 * cells.grid.size_mm
        seen, core, fitted, organ = _first_fit(seen, start, core, spheres, near_mm, px_a_mm)
        depth = tracing.core_depth(cells, core.index, reach_mm=margin_mm)
    with monitor.stage("translucency"):
        attenuation, seen, fitted = _attenuated(seen, fitted, organ, learned)
    with monitor.stage("branches"):
        settle = _Settling(seen, core, spheres, near_mm, attenuation.blur_px, ghosts.FLANK_PX / px_a_mm)
        fitted, _, organ = settle.settled(fitted, tube_fit.STEPS)
        stays = fitted.staying(ghosts.short_leaves(fitted, organ))
        fitted, organ = fitted.keep(stays), organ[stays]
    with monitor.stage("residue"):
        fitted, buried, organ = settle.searched(fitted, organ, cells.chosen(depth <= depth.min()), px_a_mm)
    solid = organs.in_solids(fitted, core, organ, margin_mm)
    if solid.all():
        return None
    if attenuation.mu_per_mm is not None:
        with monitor.stage("translucency again"):
            attenuation, seen, fitted = _refined(seen, fitted, organ, attenuation)
    return RootTree(
        tubes=fitted,
        buried=buried,
        organ=organ,
        solid=solid,
        core_mm=core.centre_mm,
        margin_mm=margin_mm,
        px_a_mm=px_a_mm,
        attenuation=attenuation,
        seen=seen,
        cameras=cameras,
    )


def _first_fit(
    seen: Evidence, start: Tubes, core: Cells, spheres: Spheres, near_mm: float, px_a_mm: float
) -> tuple[Evidence, Cells, Tubes, Mask]:
    """Fit the traced tubes beside the thick organs.

    Return what the pictures say beside these, their cores, the tubes, and the nodes (N,) that are organs.
    """
    # what is wide begins wide, a tube or not
    start = tubes.from_axes(organs.thicken(start, core, spheres, near_mm)[0])
    core = organs.thick(core, spheres, organs.LEAST_PX / px_a_mm)
    seen = seen.beside(organs.footprint(seen, core, CORE_PX + _BEYOND_PX))
    start, _, organ = organs.centred(start, core, spheres, near_mm)
    fitted, _ = tube_fit.fit(seen, start, organ, blur_px=0.0, steps=_FIRST_STEPS)
    return seen, core, fitted, organ


def _weighed(seen: Evidence, cells: Cells, core: Cells, px_a_mm: float, margin_mm: float) -> tuple[Cells, Array]:
    """Estimate how much root is in each cell.

    Return the cells that hold any, those of thick organs last, and their depth (N,), mm.
    """
    depth = tracing.core_depth(cells, core.index, reach_mm=margin_mm)
    organ = depth > -(CORE_PX + _FLANK_PX) / px_a_mm
    thin, number = density.estimate(seen, cells.chosen(~organ), cells.chosen(organ))
    return density.join(thin, cells.chosen(organ)), np.concatenate([depth[~organ][number], depth[organ]])


def _refined(seen: Evidence, fitted: Tubes, organ: Mask, attenuation: TubeAttenuation) -> tuple[TubeAttenuation, Evidence, Tubes]:
    """Find the attenuation once more with all roots there, and fit the tubes with it; return as `_attenuated`."""
    attenuation, fitted = tube_attenuation.refine(seen, fitted, organ, attenuation)
    seen = replace(seen, mu_per_mm=attenuation.mu_per_mm)
    fitted, _ = tube_fit.fit(seen, fitted, organ, blur_px=attenuation.blur_px, steps=_AFTER_STEPS)
    return attenuation, seen, fitted


def _attenuated(seen: Evidence, fitted: Tubes, organ: Mask, learned: Attenuation | None) -> tuple[TubeAttenuation, Evidence, Tubes]:
    """Find how much light thin roots let through; return that, what the pictures say then, and the tubes."""
    attenuation, fitted = tube_attenuation.find(seen, fitted, organ, find_blur(seen, fitted))
    if attenuation.mu_per_mm is None and learned is not None and learned.mu_per_mm is not None:
        # thick roots seemed translucent, and their coverage was raised, but thin ones are opaque: opacity itself is
        # their coverage
        seen = seen.by_light()
        fitted, _ = tube_fit.fit(seen, fitted, organ, blur_px=0.0, steps=_FIRST_STEPS)
        attenuation = replace(attenuation, blur_px=find_blur(seen, fitted))
    if attenuation.mu_per_mm is not None:
        seen = replace(seen.by_light(), mu_per_mm=attenuation.mu_per_mm)
    return attenuation, seen, fitted


def calibrate(tree: RootTree, *, monitor: Monitor) -> RootTree:
    """Ask the roots for the water's index and the cameras, and fit the tubes with what they told.

    Returns
    -------
    RootTree
        With cameras to go on with; ``cameras.roots`` tells what came of it, None where there are too few roots to tell.
    """
    with monitor.stage("calibration"):
        seen, fitted, cameras = root_calibration.calibrate(tree.seen, tree.cameras, tree.tubes, tree.organ, blur_px=tree.blur_px)
        return replace(tree, seen=seen, tubes=fitted, cameras=cameras)


def settle(tree: RootTree, *, monitor: Monitor) -> RootSystem:
    """Bring the tubes to rest, and tell which ends are likely none."""
    with monitor.stage("last tubes"):
        fitted, residual = tube_fit.fit(tree.seen, tree.tubes, tree.organ, blur_px=tree.blur_px, steps=_AFTER_STEPS)
        uncertain = ghosts.uncertain_ends(fitted, residual.visible, _proof(tree.seen, fitted, tree.blur_px), tree.organ)
    return RootSystem(
        tubes=fitted,
        buried=tree.buried,
        organ=tree.organ,
        solid=tree.solid,
        core_mm=tree.core_mm,
        margin_mm=tree.margin_mm,
        px_a_mm=tree.px_a_mm,
        attenuation=tree.attenuation,
        seen=tree.seen,
        cameras=tree.cameras,
        uncertain=uncertain,
    )


@dataclass(frozen=True)
class _Settling:
    """How a tree of tubes is brought to rest: fitted, cut back to what explains pixels, and linked."""

    seen: Evidence
    core: Cells
    spheres: Spheres
    near_mm: float
    blur_px: float
    flank_mm: float
    """Within this of an organ's radius, what is found is the organ's."""

    def settled(self, tree: Tubes, steps: int) -> tuple[Tubes, Mask, Mask]:
        """Return the tree at rest, with the nodes (N,) that are buried in thick organs and those that are organs."""
        tree, _, organ = organs.centred(tree, self.core, self.spheres, self.near_mm)
        tree, _ = tube_fit.fit(self.seen, tree, organ, blur_px=self.blur_px, steps=steps)
        gone = ghosts.unexplaining(tree, _proof(self.seen, tree, self.blur_px), organ) | ghosts.inside_another(tree, organ, self.flank_mm)
        return self.joined(tree.keep(tree.staying(gone)))

    def searched(self, tree: Tubes, organ: Mask, outside: Cells, px_a_mm: float) -> tuple[Tubes, Mask, Mask]:
        """Add the roots that the tree leaves unexplained; return as `settled` does.

        Parameters
        ----------
        organ : (N,) bool array
            Nodes of organs.
        outside : Cells
            Where roots may be, beside organs.
        """
        seen, blur_px = self.seen, self.blur_px
        for _ in range(_SEARCHES):
            tree, organ = self.alone(tree, organ)
            tree, _ = tube_fit.fit(seen, tree, organ, blur_px=blur_px, steps=_BETWEEN_STEPS)
            depth_px = tube_picture.optical_depth(seen, tree, seen.project(tree.centre_mm), blur_px)
            grown = residue.grow(seen, tree, organ, outside, depth_px, px_a_mm)
            tree, _, organ = self.settled(grown, _BETWEEN_STEPS)
        tree, _ = tube_fit.fit(seen, tree, organ, blur_px=blur_px, steps=_LAST_STEPS)
        tree, organ = self.alone(tree, organ)
        tree, residual = tube_fit.fit(seen, tree, organ, blur_px=blur_px, steps=_AFTER_STEPS)
        return self.ended(tree, residual, organ)

    def alone(self, tree: Tubes, organ: Mask) -> tuple[Tubes, Mask]:
        """Return a tree without the tubes that the others, fitted without them, can do without; and its organs."""
        proved = _proof(self.seen, tree, self.blur_px)
        unproven = ghosts.unproven(tree, proved, organ)
        others = tree.staying(unproven)
        if others.all():
            return tree, organ
        fitted, _ = tube_fit.fit(self.seen, tree.keep(others), organ[others], blur_px=self.blur_px, steps=_BETWEEN_STEPS)
        left, more = (np.nansum(tube_profiles.misfit(self.seen, tree, self._unexplained(drawn)), axis=0) for drawn in (tree, fitted))
        stays = tree.staying(ghosts.dispensable(tree, ~others, more - left, proved.alone))
        return tree.keep(stays), organ[stays]

    def _unexplained(self, tree: Tubes) -> Float:
        """Return what a tree leaves of the pictures."""
        depth = tube_picture.optical_depth(self.seen, tree, self.seen.project(tree.centre_mm), self.blur_px)
        return tube_picture.unexplained(self.seen, depth)

    def ended(self, tree: Tubes, residual: ResidualGradient, organ: Mask) -> tuple[Tubes, Mask, Mask]:
        """Join the ends that are none where they can go on; return as `settled` does.

        Parameters
        ----------
        residual : ResidualGradient
            What the pictures said of each node of the tree at rest.
        organ : (N,) bool array
            Nodes of organs.
        """
        uncertain = ghosts.uncertain_ends(tree, residual.visible, _proof(self.seen, tree, self.blur_px), organ)
        tree, kept = linking.link(tree, uncertain)
        inner = ghosts.inside_another(tree, organ[kept], self.flank_mm)
        return self.joined(tree.keep(tree.staying(inner)))

    def joined(self, tree: Tubes) -> tuple[Tubes, Mask, Mask]:
        """Return the tree with its pieces connected, and the nodes (N,) as above."""
        tree = tubes.without_gaps(tubes.without_stubs(linking.link(tree)[0]))
        return organs.centred(tubes.from_axes(tree), self.core, self.spheres, self.near_mm)


def _proof(seen: Evidence, tree: Tubes, blur_px: float) -> Proof:
    """Weigh what every node explains."""
    at = seen.project(tree.centre_mm)
    depth = tube_picture.optical_depth(seen, tree, at, blur_px)
    return proof.weigh(seen, tree, at, depth, tube_picture.unexplained(seen, depth), blur_px)


def _scale(seen: Evidence, water: Water) -> float:
    """Return px/mm at the middle of the water."""
    at = seen.project(np.array([[0.0, 0.0, 0.5 * (water.top_mm + water.bottom_mm)]]))
    return float(np.median(np.sqrt(np.linalg.norm(at.du, axis=-1) * np.linalg.norm(at.dv, axis=-1))))


def _search_space(seen: Evidence, water: Water, size_mm: float, monitor: Monitor) -> tuple[Cells, Cells]:
    """Carve where roots may be, and where thick organs are for certain."""
    generous = _outlines(seen, evidence.generous_outline, "search", monitor)
    low, high = np.array([-water.radius_mm, -water.radius_mm, water.bottom_mm]), np.array([water.radius_mm, water.radius_mm, water.top_mm])
    while True:
        grid = Grid.over(low, high, size_mm)
        cells = density.even_cells(_carve(seen, generous, grid, water))
        if len(cells.index) <= _MOST_CELLS:
            break
        size_mm *= 1.26 ** math.ceil(math.log2(len(cells.index) / _MOST_CELLS))  # each 1.26 halves their number
    del generous
    core = density.even_cells(_carve(seen, _outlines(seen, evidence.core_outline, "core", monitor), grid, water))
    return cells, core


def _outlines(seen: Evidence, outline: Callable[[Silhouette], Image], name: str, monitor: Monitor) -> DistanceMaps:
    """Draw outlines in all views."""
    window = Window.around(seen.silhouettes)
    drawn = monitor.each(lambda silhouette: outline(silhouette.cut(window)), name, seen.silhouettes)
    return DistanceMaps.of(np.stack(drawn), seen.image_wh, window)


def _carve(seen: Evidence, maps: DistanceMaps, grid: Grid, water: Water) -> carve.Leaves:
    """Carve outlines out of the water."""
    least = max(3, math.ceil(parsimony.VOTES * seen.bank.count))
    hull = carve.carve(
        seen.bank,
        maps,
        grid,
        water,
        min_votes=least,
        slack_px=0.0,  # nobody asks for this hull's interval: nodes beside the outline are decided early
    )
    return hull.leaves


def _first_radius(path: tracing.Path) -> Array:
    """Guess radii along a path: the shadow of a millimetre of root is its diameter."""
    way = np.gradient(np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.points_mm, axis=0), axis=1))]))
    share = gaussian_filter1d(path.shadow_mm2, 3.0, mode="nearest") / gaussian_filter1d(way, 3.0, mode="nearest")
    radius: Array = np.clip(0.5 * share, *_THIN_MM)
    return radius


def find_blur(seen: Evidence, fitted: Tubes) -> float:
    """Find the blur with which the tubes explain the pictures best."""
    seen = seen.of_views(range(min(seen.bank.count, _BLUR_VIEWS)))
    at = seen.project(fitted.centre_mm)
    cost = []
    for blur_px in _BLURS_PX:
        difference = tube_picture.unexplained(seen, tube_picture.optical_depth(seen, fitted, at, blur_px))
        cost.append(float(np.square(np.array(difference)).sum(dtype=np.float64)))
    return _BLURS_PX[int(np.argmin(cost))]
