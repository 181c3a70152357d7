"""Page of viser with the style sheet and script of this package."""

import gzip
from importlib.resources import files

from websockets.http11 import Response

from rhizotwin.scenes import html_page

_ROOT = b'<div id="root"></div>'
_LOADING = b'<p class="loading" role="status">The viewer is loading ...</p>'


def extend(page: Response) -> None:
    """Add the style sheet, the script and a text for the time of loading to a response with viser's page."""
    own = files("rhizotwin.viewer").joinpath("page")
    style, script = (own.joinpath(name).read_text("utf-8") for name in ("viewer.css", "viewer.js"))
    head = f"<style>{html_page.palette()}{style}</style><script>{script}</script></head>"
    zipped = page.headers.get("Content-Encoding") == "gzip"
    body = gzip.decompress(page.body) if zipped else page.body
    body = body.replace(b"<title>Viser</title>", b"<title>rhizotwin</title>").replace(_ROOT, _ROOT + _LOADING)
    before, _, after = body.rpartition(b"</head>")
    body = before + head.encode() + after
    page.body = gzip.compress(body, 5) if zipped else body
    del page.headers["Content-Length"]
    page.headers["Content-Length"] = str(len(page.body))
