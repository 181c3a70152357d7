"""Viser server with token authentication.

The printed address contains the token. The first response stores the token in a cookie, which the browser sends with
each request for a page or websocket. A websocket must also have the same origin as the page, because pages on other
ports of the same host share the cookies.
"""

from __future__ import annotations

import asyncio
import hmac
import http
import io
import secrets
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import Any
from unittest.mock import patch
from urllib.parse import parse_qs, urlsplit

import viser
import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response
from websockets.protocol import State

from rhizotwin.scenes.errors import UserError
from rhizotwin.viewer import html_page

LOCAL = "127.0.0.1"
"""Address that only accepts connections from the same computer."""
REFUSED = b"This page can only be opened with the complete address that rhizotwin printed, including the token.\n"
"""Response to requests without a valid token."""
_LOOK_S = 0.01
"""Interval at which a waiting websocket checks whether `Served.open` is set, s."""
Answer = Callable[[Any, Request], Response | None]
"""Type of a function that returns the response to a request. It returns None if the request opens a websocket."""


@dataclass(frozen=True)
class Served:
    """Running server with its address."""

    server: viser.ViserServer
    """Server with the 3D scene and the panel."""
    host: str
    """Address on which the server listens."""
    port: int
    """Port on which the server listens."""
    token: str
    """Token that browsers must send."""
    open: threading.Event
    """Event that is set when the content is ready. Browsers that connect earlier load the page and wait."""

    @property
    def address(self) -> str:
        """Return the address to open in a browser, including the token."""
        return f"http://{self.host}:{self.port}/?token={self.token}"

    @property
    def is_running(self) -> bool:
        """Return whether the server answers browsers. Viser ends its thread after an exception of the event loop."""
        thread = self.server._websock_server._server_thread
        return thread is not None and thread.is_alive()

    def stop(self) -> None:
        """Stop the server."""
        with redirect_stdout(io.StringIO()):  # viser prints a message
            self.server.stop()


def serve(*, host: str = LOCAL, port: int = 8080, title: str = "rhizotwin") -> Served:
    """Start a server on a port, or on the next free port.

    Browsers can load the page immediately. The content is sent after `Served.open` is set.

    Raises
    ------
    UserError
        If the address is not an address of this computer, or no port is free.
    """
    # viser warns of each drawing for a browser that has just left; the next browser gets it anyway
    warnings.filterwarnings("ignore", message=r"Queued a \w+ on a closed connection")
    token, is_open = secrets.token_urlsafe(24), threading.Event()
    try:
        with _token_check(token, is_open), redirect_stdout(io.StringIO()):  # viser prints an address without the token
            server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
    except OSError as error:
        raise UserError(f"the server could not be started at {host}:{port} ({error}); choose a different --host or --port") from None
    return Served(server, host, server.get_port(), token, is_open)


@contextmanager
def _token_check(token: str, is_open: threading.Event) -> Iterator[None]:
    """Add the token check to all servers that are started in this context. Viser itself cannot check tokens."""
    started = websockets.asyncio.server.serve

    def start_guarded(*arguments: Any, process_request: Answer, **more: Any) -> Any:
        async def check(connection: Any, request: Request) -> Response | None:
            found = answer(token, process_request, connection, request)
            while found is None and not is_open.is_set():  # only for a websocket
                await asyncio.sleep(_LOOK_S)
                if connection.state is not State.CONNECTING:  # the browser is gone, which websockets takes for a bug
                    raise asyncio.CancelledError
            return found

        return started(*arguments, process_request=check, **more)

    with patch.object(websockets.asyncio.server, "serve", start_guarded):
        yield


def answer(token: str, inner: Answer, connection: Any, request: Request) -> Response | None:
    """Reject requests without a valid token, store the token in a cookie, and forward all other requests."""
    host = _single_header(request, "Host")
    name = f"rhizotwin_{host.rpartition(':')[2]}"
    given = parse_qs(urlsplit(request.path).query).get("token", [""])[0]
    is_socket = _single_header(request, "Upgrade").lower() == "websocket"
    if not host or (is_socket and _netloc(_single_header(request, "Origin")) != host):
        return _refusal()
    if not (_are_equal(given, token) or _are_equal(_cookie(request, name), token)):
        return _refusal()
    found = inner(connection, request)
    if found is not None and found.status_code == http.HTTPStatus.OK and found.headers.get("Content-Type", "").startswith("text/html"):
        html_page.extend(found)
    if found is not None and _are_equal(given, token):
        found.headers["Set-Cookie"] = f"{name}={token}; HttpOnly; SameSite=Strict; Path=/"
    if found is not None:
        found.headers["Referrer-Policy"] = "no-referrer"
        found.headers["X-Content-Type-Options"] = "nosniff"
        found.headers["X-Frame-Options"] = "DENY"
        found.headers["Cache-Control"] = "no-store"
    return found


def _single_header(request: Request, name: str) -> str:
    """Return the value of a header. It is empty if the header is missing or occurs several times."""
    values = request.headers.get_all(name)
    return values[0] if len(values) == 1 else ""


def _netloc(address: str) -> str:
    try:
        return urlsplit(address).netloc
    except ValueError:
        return ""


def _are_equal(given: str, token: str) -> bool:
    return hmac.compare_digest(given.encode(), token.encode())


def _cookie(request: Request, name: str) -> str:
    try:
        found = SimpleCookie(_single_header(request, "Cookie")).get(name)
    except CookieError:
        return ""
    return "" if found is None else found.value


def _refusal() -> Response:
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(REFUSED))})
    return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", headers, REFUSED)
