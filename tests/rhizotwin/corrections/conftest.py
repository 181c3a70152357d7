"""A small plant whose result the tests of corrections share."""

import shutil
from pathlib import Path

import pytest

from tests.rhizotwin.plant import Plant


@pytest.fixture
def own(plant: Plant, tmp_path: Path) -> Path:
    """Return a copy of the result, in which a test may save corrections."""
    return Path(shutil.copytree(plant.result, tmp_path / "own"))
