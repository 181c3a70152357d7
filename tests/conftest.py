"""Start the engine once for every test: Mitsuba's variant is the one global state of the project."""

import pytest

from rhizotwin import engine


@pytest.fixture(scope="session", autouse=True)
def engine_started() -> str:
    """Choose the CPU engine before any test touches Mitsuba's types."""
    return engine.start("cpu")
