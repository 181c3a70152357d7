"""Chromium without a screen and with software rendering, the slowest configuration of a user."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rhizotwin.scenes.errors import UserError

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
_PROGRAMS = "chromium", "chromium-browser", "google-chrome", "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome"
"""Names on the path, and the location on macOS."""
PATIENCE_MS = 300_000
"""Time-out; software rendering is slow on a busy machine."""


@contextmanager
def chromium() -> Iterator[Any]:
    """Return a Playwright browser.

    Raises
    ------
    UserError
        If there is none.
    """
    path = next(filter(None, map(shutil.which, _PROGRAMS)), None)
    if path is None:
        raise UserError("Chromium was not found; install it: `apt-get install chromium`, on macOS `brew install --cask google-chrome`")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(FLAGS))
        try:
            yield browser
        finally:
            browser.close()
