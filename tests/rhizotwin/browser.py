"""Chromium without a screen and with software rendering, the slowest configuration of a user.

Tests that need it are skipped where there is none.
"""

import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-dev-shm-usage",
)
PROGRAMS = "chromium", "chromium-browser", "google-chrome", "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome"
PATIENCE_MS = 300_000
"""Time-out; software rendering is slow on a busy machine."""
LONG_S = 600.0
"""Limit of each wait, s. Waits end with their condition; the limit only ends a test that hangs, even on a busy computer."""


@contextmanager
def chromium() -> Iterator[Any]:
    """Return a browser; where there is none, skip the test, or fail it in CI (RHIZOTWIN_CI=1)."""
    path = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if path is None:
        missing = pytest.fail if os.environ.get("RHIZOTWIN_CI") else pytest.skip
        missing("Chromium was not found: apt-get install chromium, on macOS brew install --cask google-chrome")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(FLAGS))
        try:
            yield browser
        finally:
            browser.close()


def until(found: Callable[[], Any], what: str = "a value that is true") -> Any:
    """Wait for a value that is true, and return it."""
    end = time.monotonic() + LONG_S
    while time.monotonic() < end:
        if value := found():
            return value
        time.sleep(0.02)
    raise AssertionError(f"waited in vain for {what}")
