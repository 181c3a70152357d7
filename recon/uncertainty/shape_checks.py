"""The checks of what the pictures show of roots and canister together.

Motion, dirt, and whether the views agree and see.
"""

from rhizotwin.recon.settings import TrustSettings
from rhizotwin.recon.uncertainty.checks import Check, foremost, judged, state_of, stated, untold


def of_motion(sway_mm: float | None, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that the roots stood still from picture to picture."""
    if sway_mm is None:
        return untold("motion", "no thin roots were found that could tell whether they moved", unit="mm")
    said = f"roots lie {sway_mm:.3f} mm (root mean square) from where all pictures together put them"
    return judged("motion", sway_mm, "mm", trust.sway_mm, said, "wait longer after each step of the table, and turn it more gently")


def of_dirt(share: float | None, spread: float | None = None, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that wall and water are clear enough to look through.

    Parameters
    ----------
    share : float or None
        Of the wall, that is fouled.
    spread : float or None
        Of the light, that is spread about roots (`halo.spread`).
    trust : TrustSettings
        The limits.
    """
    made = []
    if spread is not None:
        said = (
            f"{100.0 * abs(spread):.1f} % of what roots take of the light is missing beside them{' (or too bright)' if spread < 0 else ''}"
        )
        advice = "change the water, clean the lens, and switch off what sharpens pictures or evens out their tones"
        made.append(judged("dirt", abs(spread), "share", trust.spread, said, advice))
    if share is None:
        made.append(untold("dirt", "too few views to tell dirt on the wall from roots", unit="share"))
    else:
        said = f"films, bubbles and glare lie on {100.0 * share:.1f} % of what is seen of the wall"
        made.append(judged("dirt", share, "share", trust.dirt, said, "clean the canister inside and outside, and knock the bubbles off"))
    return foremost(*made)


def of_sight(*, missed: float, unexplained: float, fill: float, trust: TrustSettings = TrustSettings()) -> Check:
    """Check that the views agree, that the shape explains them, and that they see past the roots.

    The worst of them is told.

    Parameters
    ----------
    missed : float
        Share of what the pictures show that the hull of all views leaves out.
    unexplained, fill : float
        As in `Budget`.
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
    value, limits, found, advice = max(rows, key=lambda row: row[0] / row[1][1])
    if state_of(value, *limits) == "good":
        found = f"the views agree: {100.0 * missed:.1f} % of what they show is left out by the hull of all"
        return stated("sight", "good", missed, "share", trust.missed, found)
    return judged("sight", value, "share", limits, found, advice)
