"""Refinement of a tree of tubes: fit, prune, link, and search the residual for missing roots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.roots import ghosts, linking, organs, proof, residue, tips
from rhizotwin.recon.roots.density import Cells
from rhizotwin.recon.tubes import tube_fit, tube_profiles, tubes
from rhizotwin.recon.tubes.tube_fit import Fit
from rhizotwin.recon.tubes.tube_picture import Rendering
from rhizotwin.recon.tubes.tubes import Tubes

Mask = NDArray[np.bool_]

_SEARCHES = 2
"""Number of searches of the residual; the second finds roots attached to those of the first."""
_STEPS = 4
"""Steps of each fit: tubes that are kept are fitted repeatedly, and new ones are judged before convergence."""


@dataclass(frozen=True)
class Settling:
    """Refinement of a tree of tubes against given evidence."""

    seen: Evidence
    """Evidence outside the solids."""
    whole: Evidence
    """Evidence including the solids."""
    px_a_mm: float
    """Scale at the centre of the water."""

    def settled(self, tree: Tubes) -> Tubes:
        """Fit, prune and link the tree."""
        tree = self.fitted(tree).tubes
        tree = tips.placed(self.whole, tree, self.px_a_mm)
        proved = proof.find(Rendering.of(self.seen, tree))
        gone = ghosts.unexplaining(tree, proved, self.thick(tree)) | self.inside_another(tree)
        tree = tree.without_detours(gone)
        return joined(tree.keep(tree.staying(gone)))

    def searched(self, tree: Tubes, outside: Cells) -> Tubes:
        """Add the roots that the tree leaves unexplained, and refine it.

        Parameters
        ----------
        outside : Cells
            Cells outside the solids that may contain roots.
        """
        for _ in range(_SEARCHES):
            fit = self.proven(tree)
            grown = residue.grow(self.seen, fit.tubes, self.thick(fit.tubes), outside, fit.drawn.passing, self.px_a_mm)
            tree = self.settled(grown)
        return self.ended(tips.placed(self.whole, self.proven(tree).tubes, self.px_a_mm))

    def proven(self, tree: Tubes) -> Fit:
        """Fit a tree and remove tubes that explain little alone: second tubes of a root, or pieces of its flank."""
        fit = self.fitted(tree)
        gone = ghosts.unproven(fit.tubes, proof.find(fit.drawn), self.thick(fit.tubes)) | self.inside_another(fit.tubes)
        tree = fit.tubes.without_detours(gone)
        stays = tree.staying(gone)
        return fit if stays.all() else self.fitted(tree.keep(stays))

    def ended(self, tree: Tubes) -> Tubes:
        """Link ends without a tip to the branches in which they continue."""
        drawn = Rendering.of(self.seen, tree)
        visible = tube_profiles.profiles(drawn).residual_gradient().visible
        tree, _ = linking.link(tree, ghosts.uncertain_ends(tree, visible, proof.find(drawn), self.thick(tree)))
        return joined(tree.keep(tree.staying(self.inside_another(tree))))

    def fitted(self, tree: Tubes) -> Fit:
        """Fit a tree."""
        return tube_fit.fit(self.seen, tree, self.thick(tree), steps=_STEPS)

    def thick(self, tree: Tubes) -> Mask:
        """Return the mask (N,) of nodes of thick roots."""
        return organs.is_thick(tree, self.px_a_mm)

    def inside_another(self, tree: Tubes) -> Mask:
        """Return the mask (N,) of nodes inside other tubes."""
        return ghosts.inside_another(tree, self.thick(tree), ghosts.FLANK_PX / self.px_a_mm)


def joined(tree: Tubes) -> Tubes:
    """Link the pieces of a tree."""
    return tubes.from_axes(tubes.without_gaps(tubes.without_stubs(linking.link(tree)[0])))
