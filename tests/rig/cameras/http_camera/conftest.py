"""A server of numbered pictures on this computer."""

from collections.abc import Iterator

import pytest

from rhizotwin.rig.cameras.server import CameraServer
from tests.rig.cameras.http_camera.numbered import NumberedCamera


@pytest.fixture
def camera() -> NumberedCamera:
    return NumberedCamera()


@pytest.fixture
def server(camera: NumberedCamera) -> Iterator[CameraServer]:
    found = CameraServer(camera)
    found.start()
    yield found
    found.stop()
