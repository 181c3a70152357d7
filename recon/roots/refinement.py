"""Refinement of a tree of tubes: fit, prune, link, and search the residual for missing roots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.roots import ghosts, hierarchy, linking, node_support, organs, residual_search, tips
from rhizotwin.recon.roots.density import Cells
from rhizotwin.recon.tubes import tube_fit, tube_profiles, tubes
from rhizotwin.recon.tubes.tube_fit import Fit
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.recon.tubes.tubes import Tubes

Mask = NDArray[np.bool_]

_SEARCHES = 2
"""Number of searches for missing roots in the residual coverage. The second search finds laterals of roots that were
found in the first."""


@dataclass(frozen=True)
class TreeRefinement:
    """Refinement of a tree of tubes, given the measured coverage."""

    evidence: Evidence
    """Measured coverage of all views, excluding pixels of solids."""
    whole: Evidence
    """Measured coverage of all views, including pixels of solids."""
    px_a_mm: float
    """Image scale at the centre of the water, px/mm."""

    def refine(self, tree: Tubes) -> Tubes:
        """Fit the tubes of a tree, remove ghosts and duplicates, and link the remaining pieces."""
        tree = self.fit(tree).tubes
        tree = tips.place_tips(self.whole, tree, self.px_a_mm)
        proved = node_support.compute_support(Rendering.draw(self.evidence, tree))
        gone = ghosts.find_ghosts(tree, proved, self.thick(tree), self.px_a_mm) | self.find_overlapping(tree)
        tree = tree.cut_detours(gone)
        return link_pieces(tree.keep(tree.prune_mask(gone)))

    def search(self, tree: Tubes, outside: Cells) -> Tubes:
        """Add roots that are visible in the pictures but missing from the tree, and refine the result.

        Parameters
        ----------
        outside : Cells
            Cells outside the solids that may contain roots.
        """
        for _ in range(_SEARCHES):
            fit = self.remove_unsupported(tree)
            grown = residual_search.add_missing_roots(
                self.evidence, fit.tubes, self.thick(fit.tubes), outside, fit.rendering.passing, self.px_a_mm
            )
            tree = self.refine(grown)
        return self.link_ends(tips.place_tips(self.whole, self.remove_unsupported(tree).tubes, self.px_a_mm))

    def remove_unsupported(self, tree: Tubes) -> Fit:
        """Fit a tree, and remove tubes whose coverage is mostly explained by other tubes.

        Such tubes are duplicates of a root, or they run along the side of a thicker root.
        """
        fit = self.fit(tree)
        gone = ghosts.find_unsupported_starts(
            fit.tubes, node_support.compute_support(fit.rendering), self.thick(fit.tubes)
        ) | self.find_overlapping(fit.tubes)
        tree = fit.tubes.cut_detours(gone)
        stays = tree.prune_mask(gone)
        return fit if stays.all() else self.fit(tree.keep(stays))

    def link_ends(self, tree: Tubes) -> Tubes:
        """Link branch ends that are probably not root tips to the branches in which they continue."""
        drawn = Rendering.draw(self.evidence, tree)
        visible = tube_profiles.profiles(drawn).residual_gradient().visible
        tree, _ = linking.link(tree, ghosts.find_uncertain_ends(tree, visible, node_support.compute_support(drawn), self.thick(tree)))
        return link_pieces(tree.keep(tree.prune_mask(self.find_overlapping(tree))))

    def fit(self, tree: Tubes) -> Fit:
        """Fit the tubes of a tree to the measured coverage."""
        return tube_fit.fit(self.evidence, tree, self.thick(tree))

    def thick(self, tree: Tubes) -> Mask:
        """Return the mask (N,) of the nodes of thick roots."""
        return organs.is_thick(tree, self.px_a_mm)

    def find_overlapping(self, tree: Tubes) -> Mask:
        """Return the mask (N,) of nodes inside other tubes."""
        return ghosts.find_overlapping(tree, self.thick(tree), self.px_a_mm)


def link_pieces(tree: Tubes) -> Tubes:
    """Link the pieces of a tree, fill gaps, divide it into roots, and shorten laterals that begin inside a parent."""
    return tubes.trim_inside_parents(hierarchy.divide(tubes.fill_gaps(tubes.merge_stubs(linking.link(tree)[0]))))
