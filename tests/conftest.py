"""Start the engine once for every test: Mitsuba's variant is the one global state of the project."""

import os

import pytest

from rhizotwin import engine


@pytest.fixture(scope="session", autouse=True)
def engine_started() -> str:
    """Choose the engine before any test touches Mitsuba's types: the CPU, unless RHIZOTWIN_TEST_DEVICE says cuda."""
    return engine.start(os.environ.get("RHIZOTWIN_TEST_DEVICE", "cpu"))
