"""A turn of a canister, without pictures."""

import numpy as np
import pytest

from rhizotwin.recon.coverage import background
from rhizotwin.recon.optics import cameras
from rhizotwin.recon.optics.refraction import Optics
from tests.recon.hull.exact_pictures import ring_of, views_of

Turn = tuple[dict[int, cameras.View], Optics, dict[int, np.ndarray]]


@pytest.fixture(scope="session")
def turn() -> Turn:
    """Return cameras round a canister, its optics, and what of the water each sees."""
    scene = ring_of(24)
    optics, views = Optics.from_scene(scene), dict(enumerate(views_of(scene)))
    return views, optics, {k: background.water_mask(view, optics, scene) for k, view in views.items()}
