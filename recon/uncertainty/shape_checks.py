"""The checks of what the pictures show of roots and canister together: motion, dirt, and whether the views agree and see."""

from rhizotwin.recon.uncertainty.checks import Check, state_of

SWAY_MM = 0.06, 0.15
"""Root mean square distance of the roots in a picture from where all pictures put them. A bench of the twin has 0.023
(`radish_day05b`); roots that swayed by 0.3 mm lost 10 % of the volume."""
DIRT = 0.1, 0.35
"""Share of the wall before the roots that films, bubbles and glare cover."""
MISSED = 0.05, 0.3
"""Share of what the pictures show that the hull of all views leaves out: views that disagree about where things are carve them away."""
STRUCTURE = 0.25, 0.5
"""What is left beside the tubes over what they cover: roots that are no plain absorbers."""
UNEXPLAINED, FILL = (0.1, 0.2), (0.35, 0.5)
"""Shares of `Budget`: what the shape does not explain, and what thin roots cover of the root zone's picture."""


def of_motion(sway_mm: float | None) -> Check:
    """Check that the roots stood still from picture to picture."""
    if sway_mm is None:
        said = "no thin roots were found that could tell whether they moved"
        return Check(name="motion", state="untold", value=None, unit="mm", fair=None, bad=None, found=said, advice="")
    state = state_of(sway_mm, *SWAY_MM)
    return Check(
        name="motion",
        state=state,
        value=sway_mm,
        unit="mm",
        fair=SWAY_MM[0],
        bad=SWAY_MM[1],
        found=f"roots lie {sway_mm:.3f} mm (root mean square) from where all pictures together put them",
        advice="" if state == "good" else "wait longer after each step of the table, and turn it more gently",
    )


def of_dirt(share: float | None) -> Check:
    """Check that the wall is clean enough to look through."""
    if share is None:
        said = "too few views to tell dirt on the wall from roots"
        return Check(name="dirt", state="untold", value=None, unit="share", fair=None, bad=None, found=said, advice="")
    state = state_of(share, *DIRT)
    return Check(
        name="dirt",
        state=state,
        value=share,
        unit="share",
        fair=DIRT[0],
        bad=DIRT[1],
        found=f"films, bubbles and glare lie on {100.0 * share:.1f} % of what is seen of the wall",
        advice="" if state == "good" else "clean the canister inside and outside, and knock the bubbles off",
    )


def of_sight(*, missed: float, unexplained: float, fill: float, structure: float | None) -> Check:
    """Check that the views agree, that the shape explains them, and that they see past the roots: the worst of them is told.

    Parameters
    ----------
    missed : share of what the pictures show that the hull of all views leaves out.
    unexplained, fill : as in `Budget`.
    structure : what is left beside the tubes over what they cover; None where there are none.
    """
    agree = "check strip, canister and water in the scene, and that nothing moved"
    rows = [
        (missed, MISSED, f"the views disagree about {100.0 * missed:.1f} % of what they show", agree),
        (unexplained, UNEXPLAINED, f"the shape leaves {100.0 * unexplained:.1f} % of what the pictures show unexplained", agree),
        (
            fill,
            FILL,
            f"thin roots cover {100.0 * fill:.0f} % of the root zone's picture",
            "take more pixels and a second ring, or a younger plant",
        ),
    ]
    if structure is not None:
        said = f"what is left beside the tubes is {100.0 * structure:.0f} % of what they cover: roots that are no plain absorbers"
        rows.append((structure, STRUCTURE, said, "look at the pictures: glassy or hairy roots, motion, or focus"))
    value, (fair, bad), found, advice = max(rows, key=lambda row: row[0] / row[1][1])
    state = state_of(value, fair, bad)
    if state == "good":
        found, advice = f"the views agree: {100.0 * missed:.1f} % of what they show is left out by the hull of all", ""
        value, (fair, bad) = missed, MISSED
    return Check(name="sight", state=state, value=value, unit="share", fair=fair, bad=bad, found=found, advice=advice)
