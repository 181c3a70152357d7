"""Checks of the roots and the canister in the pictures.

They cover motion of the roots, dirt, agreement of the views, and forks at which the order of the roots is uncertain.
"""

from collections.abc import Sequence

from rhizotwin.recon.roots import hierarchy
from rhizotwin.recon.settings import TrustSettings
from rhizotwin.recon.uncertainty.checks import Check, judge, make_check, make_unknown, worst
from rhizotwin.scenes import rsml
from rhizotwin.scenes.rsml import Root

_NAMED = 3
"""Maximum number of forks whose positions are stated."""


def check_motion(sway_mm: float | None, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that the roots did not move from picture to picture."""
    if sway_mm is None:
        return make_unknown("motion", "no thin roots were found, so that their motion could not be measured", unit="mm")
    finding = f"the roots deviate by {sway_mm:.3f} mm (root mean square) from their mean positions"
    return judge("motion", sway_mm, "mm", trust.sway_mm, finding, "wait longer after each step of the table, and rotate it more gently")


def check_dirt(share: float | None, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that the wall of the canister is clear. ``share`` is the fraction of the wall that is fouled."""
    if share is None:
        return make_unknown("dirt", "too few views to separate dirt on the wall from roots", unit="share")
    finding = f"films, bubbles and glare cover {100.0 * share:.1f} % of the visible wall"
    return judge("dirt", share, "share", trust.dirt, finding, "clean the canister inside and outside, and remove the bubbles")


def check_agreement(*, missed: float, unexplained: float, fill: float, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that the views agree, that the shape explains them, and that roots are not too dense.

    The worst of the three results is returned; of several in the same state, the one that is largest relative to its
    limit.

    Parameters
    ----------
    missed : float
        Fraction of the coverage that the hull of all views does not explain.
    unexplained, fill : float
        See `Budget`.
    trust : TrustSettings
        The limits.
    """
    agree = "check strip, canister and water in the scene, and that nothing moved"
    crowded = "use a higher resolution and a second ring, or a younger plant"
    rows = [
        (missed, trust.missed, f"the views disagree on {100.0 * missed:.1f} % of their coverage", agree),
        (unexplained, trust.unexplained, f"the shape does not explain {100.0 * unexplained:.1f} % of the coverage in the pictures", agree),
        (fill, trust.fill, f"thin roots cover {100.0 * fill:.0f} % of the root zone's picture", crowded),
    ]
    rows.sort(key=lambda row: row[0] / row[1][1], reverse=True)
    found = worst(*(judge("sight", value, "share", limits, finding, advice) for value, limits, finding, advice in rows))
    if found.state != "good":
        return found
    agreement = f"the views agree: the hull of all views excludes {100.0 * missed:.1f} % of their coverage"
    return make_check("sight", "good", missed, "share", trust.missed, agreement)


def check_forks(roots: Sequence[Root]) -> Check:
    """Check that each root continues at its forks in one line only, so that its order and its laterals are certain."""
    forks = hierarchy.find_ambiguous_forks(roots) if roots else []
    share = sum(fork.length_mm for fork in forks) / max(rsml.length_mm(roots), 1e-9)
    if not forks:
        return make_check("forks", "good", share, "share", None, "at each fork, one line continues the root")
    places = "; ".join("({:.0f}, {:.0f}, {:.0f})".format(*fork.point_mm) for fork in forks[:_NAMED])
    found = (
        f"at {len(forks)} of {max(len(roots) - 1, len(forks))} forks, the root may as well continue in the lateral, so that up to "
        f"{100.0 * min(share, 1.0):.0f} % of the length may have another order; the longest begin at x, y, z = {places} mm"
    )
    return make_check("forks", "fair", share, "share", None, found, "compare these places with the pictures, and correct the roots there")
