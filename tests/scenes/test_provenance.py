"""Versions and memory, as files that we write record them."""

import platform
import resource
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from rhizotwin.scenes.provenance import peak_memory_mib, versions


def test_versions_are_those_of_the_libraries_and_a_missing_one_is_unknown() -> None:
    found = versions(["numpy", "no-such-distribution"])
    assert list(found) == ["rhizotwin", "python", "numpy", "no-such-distribution"]
    assert (found["python"], found["numpy"], found["no-such-distribution"]) == (platform.python_version(), np.__version__, "unknown")


@pytest.mark.parametrize(("system", "mib"), [("linux", 2048.0), ("darwin", 2.0)])
def test_unit_of_the_system(system: str, mib: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrusage", lambda _: SimpleNamespace(ru_maxrss=2 * 1024**2))
    monkeypatch.setattr(sys, "platform", system)
    assert peak_memory_mib() == mib
