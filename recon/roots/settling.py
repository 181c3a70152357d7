"""A tree of tubes is brought to rest: fitted, cut back to what explains pixels, linked, and searched beside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.coverage.evidence import Evidence
from rhizotwin.recon.device import Float
from rhizotwin.recon.hull.spheres import Spheres
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
    """Beside taproot and hypocotyl."""
    whole: Evidence
    """With them."""
    core: Cells
    spheres: Spheres
    near_mm: float
    blur_px: float
    flank_mm: float
    """Within this of an organ's radius, what is found is the organ's."""
    px_a_mm: float
    """Scale in the middle of the water."""

    def settled(self, tree: Tubes, steps: int) -> tuple[Tubes, Mask, Mask]:
        """Return the tree at rest, the nodes (N,) buried in taproot and hypocotyl, and those that are its axis."""
        tree, _, organ = organs.centred(tree, self.core, self.spheres, self.near_mm)
        tree, _ = tube_fit.fit(self.seen, tree, organ, blur_px=self.blur_px, steps=steps)
        tree = tips.placed(self.whole, tree, self.blur_px, self.px_a_mm)
        proved = proof.find(self.seen, tree, self.blur_px)
        gone = ghosts.unexplaining(tree, proved, organ) | ghosts.inside_another(tree, organ, self.flank_mm)
        return self.joined(tree.keep(tree.staying(gone)))

    def searched(self, tree: Tubes, organ: Mask, outside: Cells) -> tuple[Tubes, Mask, Mask]:
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
            depth = tube_picture.optical_depth(seen, tree, seen.project(tree.centre_mm), blur_px)
            grown = residue.grow(seen, tree, organ, outside, depth, self.px_a_mm)
            tree, _, organ = self.settled(grown, _BETWEEN_STEPS)
        tree, _ = tube_fit.fit(seen, tree, organ, blur_px=blur_px, steps=_LAST_STEPS)
        tree, organ = self.alone(tree, organ)
        tree = tips.placed(self.whole, tree, blur_px, self.px_a_mm)
        tree, residual = tube_fit.fit(seen, tree, organ, blur_px=blur_px, steps=AFTER_STEPS)
        return self.ended(tree, residual, organ)

    def alone(self, tree: Tubes, organ: Mask) -> tuple[Tubes, Mask]:
        """Return a tree without the tubes that the others, fitted without them, can do without; and its organs (N,)."""
        proved = proof.find(self.seen, tree, self.blur_px)
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
        return tube_picture.compared(self.seen, tree, self.seen.project(tree.centre_mm), self.blur_px)[1]

    def ended(self, tree: Tubes, residual: ResidualGradient, organ: Mask) -> tuple[Tubes, Mask, Mask]:
        """Join the ends that are none where they can go on; return as `settled` does.

        Parameters
        ----------
        residual : ResidualGradient
            What the pictures said of each node of the tree at rest.
        organ : (N,) bool array
            Nodes of organs.
        """
        uncertain = ghosts.uncertain_ends(tree, residual.visible, proof.find(self.seen, tree, self.blur_px), organ)
        tree, kept = linking.link(tree, uncertain)
        inner = ghosts.inside_another(tree, organ[kept], self.flank_mm)
        return self.joined(tree.keep(tree.staying(inner)))

    def joined(self, tree: Tubes) -> tuple[Tubes, Mask, Mask]:
        """Return the tree with its pieces connected, and the nodes (N,) as above."""
        tree = tubes.without_gaps(tubes.without_stubs(linking.link(tree)[0]))
        return organs.centred(tubes.from_axes(tree), self.core, self.spheres, self.near_mm)
