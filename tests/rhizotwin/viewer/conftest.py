"""A small plant, and a viewer that shows its result."""

from collections.abc import Iterator

import pytest

from rhizotwin.viewer import app
from rhizotwin.viewer.app import Viewer
from tests.rhizotwin import plant as plants


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> plants.Plant:
    return plants.make(tmp_path_factory.mktemp("plant"), name="a *plant* <b>")


@pytest.fixture
def viewer(plant: plants.Plant) -> Iterator[Viewer]:
    running = app.start([plant.result], plant.dataset, port=8290)
    yield running
    running.served.server.stop()
