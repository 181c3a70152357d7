"""A tree of tubes is brought to rest: fitted, cut back to what explains pixels, linked, and searched beside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.device import Float
from rhizotwin.recon.roots import ghosts, linking, organs, proof, residue, tips
from rhizotwin.recon.roots.density import Cells
from rhizotwin.recon.tubes import tube_fit, tube_picture, tube_profiles, tubes
from rhizotwin.recon.tubes.tube_profiles import ResidualGradient
from rhizotwin.recon.tubes.tubes import Tubes

Mask = NDArray[np.bool_]

_SEARCHES = 2
"""Searches for roots that the tubes leave unexplained; the second finds what hung on the first's."""
_BETWEEN_STEPS = 4
"""Steps of the fits, fewer than a whole one (`tube_fit.STEPS`): between searches ..."""
_LAST_STEPS = 4
"""... before ends are judged ..."""
AFTER_STEPS = 2
"""... and after something that all roots share has changed a little."""


@dataclass(frozen=True)
class Settling:
    """How a tree of tubes is brought to rest: fitted, cut back to what explains pixels, and linked."""

    seen: Evidence
    """Beside solids."""
    whole: Evidence
    """With them."""
    blur_px: float
    px_a_mm: float
    """Scale in the middle of the water."""

    def settled(self, tree: Tubes, steps: int) -> Tubes:
        """Return the tree at rest."""
        tree, _ = tube_fit.fit(self.seen, tree, self.thick(tree), blur_px=self.blur_px, steps=steps)
        tree = tips.placed(self.whole, tree, self.blur_px, self.px_a_mm)
        proved = proof.find(self.seen, tree, self.blur_px)
        gone = ghosts.unexplaining(tree, proved, self.thick(tree)) | self.inside_another(tree)
        return joined(tree.keep(tree.staying(gone)))

    def searched(self, tree: Tubes, outside: Cells) -> Tubes:
        """Add the roots that the tree leaves unexplained, and bring it to rest.

        Parameters
        ----------
        outside : Cells
            Where roots may be, beside solids.
        """
        seen, blur_px = self.seen, self.blur_px
        for _ in range(_SEARCHES):
            tree = self.alone(tree)
            tree, _ = tube_fit.fit(seen, tree, self.thick(tree), blur_px=blur_px, steps=_BETWEEN_STEPS)
            depth = tube_picture.optical_depth(seen, tree, seen.project(tree.centre_mm), blur_px)
            grown = residue.grow(seen, tree, self.thick(tree), outside, depth, self.px_a_mm)
            tree = self.settled(grown, _BETWEEN_STEPS)
        tree, _ = tube_fit.fit(seen, tree, self.thick(tree), blur_px=blur_px, steps=_LAST_STEPS)
        tree = tips.placed(self.whole, self.alone(tree), blur_px, self.px_a_mm)
        tree, residual = tube_fit.fit(seen, tree, self.thick(tree), blur_px=blur_px, steps=AFTER_STEPS)
        return self.ended(tree, residual)

    def alone(self, tree: Tubes) -> Tubes:
        """Return a tree without the tubes that the others, fitted without them, can do without."""
        proved = proof.find(self.seen, tree, self.blur_px)
        others = tree.staying(ghosts.unproven(tree, proved, self.thick(tree)))
        if others.all():
            return tree
        kept = tree.keep(others)
        fitted, _ = tube_fit.fit(self.seen, kept, self.thick(kept), blur_px=self.blur_px, steps=_BETWEEN_STEPS)
        left, more = (np.nansum(tube_profiles.misfit(self.seen, tree, self._unexplained(drawn)), axis=0) for drawn in (tree, fitted))
        return tree.keep(tree.staying(ghosts.dispensable(tree, ~others, more - left, proved)))

    def ended(self, tree: Tubes, residual: ResidualGradient) -> Tubes:
        """Join the ends that are none where they can go on.

        Parameters
        ----------
        residual : ResidualGradient
            What the pictures said of each node of the tree at rest.
        """
        proved = proof.find(self.seen, tree, self.blur_px)
        tree, _ = linking.link(tree, ghosts.uncertain_ends(tree, residual.visible, proved, self.thick(tree)))
        return joined(tree.keep(tree.staying(self.inside_another(tree))))

    def thick(self, tree: Tubes) -> Mask:
        """Tell the nodes (N,) of thick roots."""
        return organs.is_thick(tree, self.px_a_mm)

    def inside_another(self, tree: Tubes) -> Mask:
        """Tell the nodes (N,) inside other tubes."""
        return ghosts.inside_another(tree, self.thick(tree), ghosts.FLANK_PX / self.px_a_mm)

    def _unexplained(self, tree: Tubes) -> Float:
        """Return what a tree leaves of the pictures."""
        return tube_picture.compared(self.seen, tree, self.seen.project(tree.centre_mm), self.blur_px)[1]


def joined(tree: Tubes) -> Tubes:
    """Return a tree with its pieces connected."""
    return tubes.from_axes(tubes.without_gaps(tubes.without_stubs(linking.link(tree)[0])))
