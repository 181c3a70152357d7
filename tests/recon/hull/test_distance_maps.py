"""Distance maps as they are kept, in halves."""

import mitsuba as mi
import numpy as np
from scipy import ndimage

from rhizotwin.recon.coverage.silhouettes import UNSEEN_PX
from rhizotwin.recon.hull.distance_maps import DistanceMaps, read

SHAPE = (3, 40, 60)
"""Views, and twice the pictures' rows and columns."""


def drawn() -> np.ndarray:
    """Distances from far outside to a sphere's depth; one view is silent on the right."""
    values = np.random.default_rng(0).uniform(-300.0, 100.0, SHAPE).astype(np.float32)
    values[1, :, 40:] = UNSEEN_PX
    return values


def test_halves_read_as_the_maps_they_were_made_of() -> None:
    values, rng = drawn(), np.random.default_rng(1)
    maps, px = DistanceMaps.from_arrays(values), rng.uniform((0.5, 0.5), (28.5, 18.5), (500, 2))
    for view in range(SHAPE[0]):
        at = (px[:, ::-1].T + 0.5) * 2.0 - 0.5
        true = ndimage.map_coordinates(values[view].astype(np.float64), at, order=1)
        found, tells = (np.array(part) for part in read(maps, mi.UInt32(view), mi.Vector2f(*px.T.astype(np.float32)), mi.Bool(True)))
        told = ndimage.map_coordinates((values[view] == UNSEEN_PX).astype(np.float64), at, order=1) < 1e-4
        assert (tells == told).mean() > 0.99, "a share of what is not seen is silence"
        # half of the last of eleven bits, from 256 to 512 px; the place in float32 is right to 1e-5 px
        np.testing.assert_allclose(found[tells & told], true[tells & told], atol=0.125 + 0.02)
