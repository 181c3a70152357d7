"""Open a page in a browser without showing its address, which contains a token, to other users of the computer."""

import atexit
import html
import sys
import tempfile
import threading
import webbrowser
from contextlib import suppress
from pathlib import Path

KEPT_S = 60.0
"""Time after which the file with the address is removed, s. A browser that must first be started needs several
seconds."""


def open_page(address: str) -> None:
    """Open an address in a browser.

    All users can read the command line of a browser. Therefore it contains only the path of a file that forwards to the
    address, and that only this user can read. If no file can be written, no browser is opened.
    """
    with suppress(OSError):
        # Browsers that are installed as snaps read files in the home folder only, and none with hidden names.
        place = Path.home() if sys.platform == "linux" else None
        with tempfile.NamedTemporaryFile("w", prefix="rhizotwin-", suffix=".html", dir=place, delete=False, encoding="utf-8") as file:
            shown = html.escape(address)
            file.write(f'<!doctype html><meta http-equiv="refresh" content="0; url={shown}"><a href="{shown}">Open the page</a>\n')
        path = Path(file.name)
        atexit.register(path.unlink, missing_ok=True)
        removal = threading.Timer(KEPT_S, path.unlink, kwargs={"missing_ok": True})
        removal.daemon = True
        removal.start()
        webbrowser.open(path.as_uri())
