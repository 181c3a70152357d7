"""Scenes and solids that are quick to render."""

from collections.abc import Iterator

import pytest

from rhizotwin.sim import specimen


@pytest.fixture(scope="module")
def coarse_ball() -> Iterator[None]:
    """Make balls of 5120 faces, not of 81920, for tests in whose pictures that makes no difference."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(specimen, "SPHERE_SUBDIVISIONS", 4)
        yield
