"""Vessels and lights that can be simulated, but from whose pictures roots cannot be reconstructed."""

from collections.abc import Iterable

import numpy as np

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.picture_codec import Grey

PANEL_SHARE = 0.25
"""Fraction of the pixels, beginning with the brightest, that the panel covers at least, also around a canister."""
SEEN = 0.02
"""Minimum brightness of bright objects, as a fraction of full scale. In a darker picture nothing is visible."""
DARKEST = 0.1
"""Minimum brightness of the panel relative to the brightest parts of a picture, such as the paper of the strip. In the
bright-field scenes of the library the ratio is at least 0.5, and in the dark field at most 0.01."""


def refuse_scene(scene: Scene) -> None:
    """Raise an error if the scene states a vessel or a light that is not supported.

    Raises
    ------
    UserError
        If the vessel is rectangular, or the roots are lit from the side.
    """
    if scene.canister.half_width_mm is not None:
        raise UserError(
            f"scene {scene.name}: rectangular vessels (canister.half_width_mm) are not supported, because the edges between plane walls "
            "hide and double roots; grow the plant in a round canister"
        )
    if scene.lights.side_level > 0.0:
        raise UserError(
            f"scene {scene.name}: roots lit from the side (lights.side_level) are not supported, because their silhouettes must be dark "
            "in front of a bright panel; switch the side lights off and the panel on"
        )


def refuse_dark_ground(pictures: Iterable[tuple[str, Grey]]) -> None:
    """Raise an error if pictures show bright objects on dark ground.

    Parameters
    ----------
    pictures : iterable of (str, (H, W) uint8 or uint16 array)
        Names of a few pictures in which the panel should be lit, and the pictures.

    Raises
    ------
    UserError
        If the ground of each picture is dark.
    """
    ratios = []
    for name, image in pictures:
        ground, bright = np.percentile(image[1::3, 1::3], [100.0 * (1.0 - PANEL_SHARE), 99.5])
        ratios.append((float(ground) / float(bright) if bright > SEEN * np.iinfo(image.dtype).max else 1.0, name))
    if ratios and max(ratios)[0] < DARKEST:
        ratio, name = ratios[0]
        raise UserError(
            f"{name}: the ground is dark ({100.0 * ratio:.0f} % of the brightest parts), so that the roots are lit from the side (dark "
            "field), which is not supported, or the panel was off; take pictures in front of the bright panel"
        )
