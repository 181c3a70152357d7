"""A real Chromium without a screen, its pictures drawn by software: the slowest that a person may have."""

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
PATIENCE_MS = 300_000
"""Software draws slowly while others compute."""


@contextmanager
def chromium() -> Iterator[Any]:
    """Return a browser of Playwright's.

    Raises
    ------
    UserError
        Where there is none.
    """
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None:
        raise UserError("there is no Chromium here; apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(FLAGS))
        try:
            yield browser
        finally:
            browser.close()
