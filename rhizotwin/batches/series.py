"""Generation of scenes for several plants, ages and treatments from one scene."""

import re
from collections.abc import Sequence

from rhizotwin.scenes import series
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.solution import Factors


def vary(
    scene: Scene, *, plants: int = 1, days: Sequence[float] | None = None, treatments: Sequence[tuple[str, float, Factors]] | None = None
) -> dict[str, Scene]:
    """Return one scene for each combination of plant, age and treatment, keyed by the name of the scene.

    Parameters
    ----------
    scene : Scene
        Scene with a simulated plant.
    plants : int
        Number of plants per treatment, grown from different seeds.
    days : sequence of float or None
        Ages of the plants in days; None: age in the scene.
    treatments : sequence of (str, float, Factors) or None
        Name, growth factor, and factors of the nutrient solution's elements for each treatment; None: as in the scene.

    Returns
    -------
    dict of Scene
        Scenes by name; the name includes treatment, plant and day. Without variation, the original scene only.

    Raises
    ------
    UserError
        If a variation is requested, but the specimen of the scene is not a simulated plant, or if two variations have
        the same name.
    """
    found = {scene.name: scene}
    if treatments is not None:
        found = {
            f"{name}_{_word(what)}": series.apply_treatment(one, what, growth, dict(factors))
            for name, one in found.items()
            for what, growth, factors in treatments
        }
    if plants > 1:
        found = {  # each treatment has its own plants
            f"{name}_plant{k + 1}": series.replicate(one, k, seed=plants * place + k)
            for place, (name, one) in enumerate(found.items())
            for k in range(plants)
        }
    if days is not None:
        from rhizotwin.sim.growth import grow

        reference = series.require_grown(scene)
        found = {
            f"{name}_day{day:04.1f}".removesuffix(".0"): series.at_day(one, day, grow=grow, like=reference)
            for name, one in found.items()
            for day in days
        }
    if len(found) < plants * len(days or (0,)) * len(treatments or (0,)):
        raise UserError("two treatments or two days have the same name, such as low N and low_N, or day 5.01 and day 5.04; change one")
    return found


def _word(text: str) -> str:
    return re.sub(r"\W+", "_", text).strip("_") or "treated"
