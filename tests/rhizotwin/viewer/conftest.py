"""A small plant, and a viewer that shows its result."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

from rhizotwin.viewer import app
from rhizotwin.viewer.app import Viewer
from rhizotwin.viewer.shown import Shown
from tests.rhizotwin import plant as plants


@pytest.fixture(scope="session")
def shown(plant: plants.Plant) -> Shown:
    """Return the plant's result without a server, for tests that change nothing."""
    return Shown(plant.result, plant.dataset)


@contextmanager
def started(results: Sequence[Path], dataset: Path | None) -> Iterator[Viewer]:
    """Serve results in a viewer."""
    running = app.start(results, dataset, port=8290)
    try:
        yield running
    finally:
        running.served.stop()


@pytest.fixture
def viewer(plant: plants.Plant) -> Iterator[Viewer]:
    with started([plant.result], plant.dataset) as running:
        yield running
