"""The checks of what the pictures show of roots and canister together.

Motion, dirt, and whether the views agree and see.
"""

from rhizotwin.recon.settings import TrustSettings
from rhizotwin.recon.uncertainty.checks import Check, judged, state_of, stated, untold


def of_motion(sway_mm: float | None, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that the roots stood still from picture to picture."""
    if sway_mm is None:
        return untold("motion", "no thin roots were found that could tell whether they moved", unit="mm")
    said = f"roots lie {sway_mm:.3f} mm (root mean square) from where all pictures together put them"
    return judged("motion", sway_mm, "mm", trust.sway_mm, said, "wait longer after each step of the table, and turn it more gently")


def of_dirt(share: float | None, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that the wall is clean enough to look through."""
    if share is None:
        return untold("dirt", "too few views to tell dirt on the wall from roots", unit="share")
    said = f"films, bubbles and glare lie on {100.0 * share:.1f} % of what is seen of the wall"
    return judged("dirt", share, "share", trust.dirt, said, "clean the canister inside and outside, and knock the bubbles off")


def of_sight(*, missed: float, unexplained: float, fill: float, structure: float | None, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that the views agree, that the shape explains them, and that they see past the roots.

    The worst of them is told.

    Parameters
    ----------
    missed : float
        Share of what the pictures show that the hull of all views leaves out.
    unexplained, fill : float
        As in `Budget`.
    structure : float or None
        What is left beside the tubes over what they cover; None where there are none.
    trust : TrustSettings
        The limits.
    """
    agree = "check strip, canister and water in the scene, and that nothing moved"
    crowded = "take more pixels and a second ring, or a younger plant"
    rows = [
        (missed, trust.missed, f"the views disagree about {100.0 * missed:.1f} % of what they show", agree),
        (unexplained, trust.unexplained, f"the shape leaves {100.0 * unexplained:.1f} % of what the pictures show unexplained", agree),
        (fill, trust.fill, f"thin roots cover {100.0 * fill:.0f} % of the root zone's picture", crowded),
    ]
    if structure is not None:
        said = f"what is left beside the tubes is {100.0 * structure:.0f} % of what they cover: roots that are no plain absorbers"
        rows.append((structure, trust.structure, said, "look at the pictures: glassy or hairy roots, motion, or focus"))
    value, limits, found, advice = max(rows, key=lambda row: row[0] / row[1][1])
    if state_of(value, *limits) == "good":
        found = f"the views agree: {100.0 * missed:.1f} % of what they show is left out by the hull of all"
        return stated("sight", "good", missed, "share", trust.missed, found)
    return judged("sight", value, "share", limits, found, advice)
