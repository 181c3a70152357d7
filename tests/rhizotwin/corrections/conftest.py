"""A small plant whose result the tests of corrections share."""

import shutil
from pathlib import Path

import pytest

from tests.rhizotwin import plant as plants
from tests.rhizotwin.plant import Plant


@pytest.fixture(scope="session")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Plant:
    """Return a plant that all tests share. None may save corrections in its result, see `own`."""
    return plants.make(tmp_path_factory.mktemp("plant"))


@pytest.fixture
def own(plant: Plant, tmp_path: Path) -> Path:
    """Return a copy of the result, in which a test may save corrections."""
    return Path(shutil.copytree(plant.result, tmp_path / "own"))
