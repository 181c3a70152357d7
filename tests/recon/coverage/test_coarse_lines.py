"""Coarse grids of lines of sight, for pictures of any size."""

import numpy as np
import pytest

from rhizotwin.recon.coverage.coarse_lines import CoarseLines
from rhizotwin.recon.optics.refraction import Optics
from rhizotwin.scenes.model import CapturePlan, Ring, Scene
from tests.recon.hull.exact_pictures import views_of


@pytest.mark.parametrize("beyond", [False, True])
@pytest.mark.parametrize("image_wh", [(80, 60), (81, 60), (82, 61), (83, 62), (84, 63)])
def test_every_pixel_has_a_value(image_wh: tuple[int, int], beyond: bool) -> None:
    scene = Scene(plan=CapturePlan(rings=(Ring(views=1),)))
    scene = Scene(plan=scene.plan, camera=scene.camera.resized(image_wh))
    lines = CoarseLines.compute(views_of(scene)[0], Optics.from_scene(scene), step=4, beyond=beyond)
    columns = np.broadcast_to(4.0 * np.arange(lines.shape[1]) + 1.5, lines.shape)
    found = lines.upsample(columns)
    assert found.shape == (image_wh[1], image_wh[0])
    inner = found[:, 2 : 4 * lines.shape[1] - 2]
    np.testing.assert_allclose(inner, np.broadcast_to(np.arange(found.shape[1])[2 : 4 * lines.shape[1] - 2], inner.shape), atol=1e-4)
