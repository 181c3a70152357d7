"""Versions, as files that we write record them."""

import platform

import numpy as np

from rhizotwin.scenes.provenance import versions


def test_versions_are_those_of_the_libraries_and_a_missing_one_is_unknown() -> None:
    found = versions(["numpy", "no-such-distribution"])
    assert list(found) == ["rhizotwin", "python", "numpy", "no-such-distribution"]
    assert (found["python"], found["numpy"], found["no-such-distribution"]) == (platform.python_version(), np.__version__, "unknown")
