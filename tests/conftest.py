"""Start the engine once for every test (Mitsuba's variant is the one global state of the project), and know the slow tests."""

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from rhizotwin import engine


@pytest.fixture(scope="session", autouse=True)
def engine_started() -> str:
    """Choose the engine before any test touches Mitsuba's types: the CPU, unless RHIZOTWIN_TEST_DEVICE says cuda."""
    return engine.start(os.environ.get("RHIZOTWIN_TEST_DEVICE", "cpu"))


SLOW_S = 20.0
SLOW = Path(__file__).with_name("slow.txt")
"""Names of slow tests, or of files all of whose tests wait for one slow fixture; one a line."""
_taken_s: dict[str, float] = {}


def pytest_addoption(parser: pytest.Parser) -> None:
    """Offer to measure which tests are slow."""
    parser.addoption("--note-slow", action="store_true", help=f"write {SLOW.name} anew for the files that are run")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that were slow when they were measured."""
    slow = set(SLOW.read_text(encoding="utf-8").splitlines())
    for item in items:
        if item.nodeid in slow or item.nodeid.partition("::")[0] in slow:
            item.add_marker("slow")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    """Time what a test waits for: that is its file's, whose other tests would wait for it too."""
    return (yield from _timed(item.nodeid.partition("::")[0]))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Time a test."""
    return (yield from _timed(item.nodeid))


def _timed(name: str) -> Iterator[None]:
    """Note the processor time (of this process and those it waited for), or the time by the clock where that is less."""
    wall, used = time.perf_counter(), sum(os.times()[:4])
    result = yield
    _taken_s[name] = max(_taken_s.get(name, 0.0), min(time.perf_counter() - wall, sum(os.times()[:4]) - used))
    return result


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the names of the slow tests."""
    if session.config.getoption("--note-slow"):
        run = {name.partition("::")[0] for name in _taken_s}
        kept = {name for name in SLOW.read_text(encoding="utf-8").splitlines() if name.partition("::")[0] not in run}
        found = {name for name, taken_s in _taken_s.items() if taken_s > SLOW_S}
        SLOW.write_text("".join(f"{name}\n" for name in sorted(kept | found)), encoding="utf-8")
