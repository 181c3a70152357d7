"""A real Chromium without a screen; tests that need it are skipped with a word where there is none."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest

from benchmarks import browser
from benchmarks.browser import PATIENCE_MS as PATIENCE_MS
from rhizotwin.scenes.errors import UserError


@contextmanager
def chromium() -> Iterator[Any]:
    """Return a browser; where there is none, skip the test, or fail it in CI (RHIZOTWIN_CI=1)."""
    with ExitStack() as stack:
        try:
            started = stack.enter_context(browser.chromium())
        except UserError as error:
            if os.environ.get("RHIZOTWIN_CI"):
                pytest.fail(f"in CI {error}")
            pytest.skip(str(error))
        yield started


def wait(until: Callable[[], Any], what: str) -> Any:
    """Wait for something to become true and return it."""
    end = time.monotonic() + PATIENCE_MS / 1000.0
    while time.monotonic() < end:
        found = until()
        if found:
            return found
        time.sleep(0.05)
    raise AssertionError(f"waited in vain for {what}")
