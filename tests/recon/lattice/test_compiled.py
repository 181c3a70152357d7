"""Compilation with and without a folder for the machine code."""

import numpy as np
import pytest
from numba.core import caching

from rhizotwin.recon.lattice import cells, distances
from rhizotwin.recon.lattice.compiled import compiled
from rhizotwin.recon.roots import footprints


def double(values: np.ndarray) -> np.ndarray:
    return 2.0 * values


@pytest.mark.parametrize("folders", [caching.CacheImpl._locator_classes, []])
def test_functions_are_compiled_where_nothing_can_be_written(folders: list[type], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", folders)
    np.testing.assert_array_equal(compiled(double)(np.arange(3.0)), [0.0, 2.0, 4.0])


def test_compiled_functions_call_only_functions_of_their_module() -> None:
    """The stored machine code is not renewed when another module changes."""
    kind = type(compiled(double))
    found = [one for module in (cells, distances, footprints) for one in vars(module).values() if isinstance(one, kind)]
    called = [(one, one.py_func.__globals__.get(name)) for one in found for name in one.py_func.__code__.co_names]
    foreign = [(one.__name__, other.__name__) for one, other in called if isinstance(other, kind) and other.__module__ != one.__module__]
    assert len(found) > 10
    assert foreign == []
