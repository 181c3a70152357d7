"""A viser server with token authentication.

The printed address contains the token. The first response stores it in a cookie, which the browser sends with the page
and the websocket. A websocket must also have the origin of the page, because pages of other ports share the cookies.
"""

from __future__ import annotations

import asyncio
import hmac
import http
import io
import secrets
import threading
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

from rhizotwin.scenes.errors import UserError

LOCAL = "127.0.0.1"
REFUSED = b"This page needs the complete address that `rhizotwin` printed, with its token.\n"
_LOOK_S = 0.01
"""Interval in which waiting websockets check `Served.open`."""
Answer = Callable[[Any, Request], Response | None]


@dataclass(frozen=True)
class Served:
    """A running server and its address."""

    server: viser.ViserServer
    host: str
    port: int
    token: str
    open: threading.Event
    """Set when the content is ready; until then pages load and wait."""

    @property
    def address(self) -> str:
        """Return the address to open in a browser."""
        return f"http://{self.host}:{self.port}/?token={self.token}"

    def stop(self) -> None:
        """Stop the server."""
        with redirect_stdout(io.StringIO()):  # viser prints a message
            self.server.stop()


def serve(*, host: str = LOCAL, port: int = 8080, title: str = "rhizotwin") -> Served:
    """Start a server at a port, or at the next free one.

    Browsers can load the page at once; its content follows when `Served.open` is set.

    Raises
    ------
    UserError
        If the address is not of this machine, or no port is free.
    """
    token, is_open = secrets.token_urlsafe(24), threading.Event()
    try:
        with _guarded(token, is_open), redirect_stdout(io.StringIO()):  # viser prints an address without the token
            server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
    except OSError as error:
        raise UserError(f"cannot serve at {host}:{port} ({error}); choose another --host or --port") from None
    return Served(server, host, server.get_port(), token, is_open)


@contextmanager
def _guarded(token: str, is_open: threading.Event) -> Iterator[None]:
    """Make servers that start in this context check the token; viser has no hook for it."""
    started = websockets.asyncio.server.serve

    def start_guarded(*arguments: Any, process_request: Answer, **more: Any) -> Any:
        async def check(connection: Any, request: Request) -> Response | None:
            found = answer(token, process_request, connection, request)
            while found is None and not is_open.is_set():  # a websocket
                await asyncio.sleep(_LOOK_S)
            return found

        return started(*arguments, process_request=check, **more)

    with patch.object(websockets.asyncio.server, "serve", start_guarded):
        yield


def answer(token: str, inner: Answer, connection: Any, request: Request) -> Response | None:
    """Reject requests without the token, store a token in the address as a cookie, and forward the rest."""
    host = _only(request, "Host")
    name = f"rhizotwin_{host.rpartition(':')[2]}"
    given = parse_qs(urlsplit(request.path).query).get("token", [""])[0]
    is_socket = _only(request, "Upgrade").lower() == "websocket"
    if not host or (is_socket and _netloc(_only(request, "Origin")) != host):
        return _refused()
    if not (_same(given, token) or _same(_cookie(request, name), token)):
        return _refused()
    found = inner(connection, request)
    if found is not None and _same(given, token):
        found.headers["Set-Cookie"] = f"{name}={token}; HttpOnly; SameSite=Strict; Path=/"
    if found is not None:
        found.headers["Referrer-Policy"] = "no-referrer"
        found.headers["X-Content-Type-Options"] = "nosniff"
        found.headers["X-Frame-Options"] = "DENY"
        found.headers["Cache-Control"] = "no-store"
    return found


def _only(request: Request, name: str) -> str:
    """Return the value of a header; empty if it is missing or repeated, which no browser does."""
    values = request.headers.get_all(name)
    return values[0] if len(values) == 1 else ""


def _netloc(address: str) -> str:
    try:
        return urlsplit(address).netloc
    except ValueError:
        return ""


def _same(given: str, token: str) -> bool:
    return hmac.compare_digest(given.encode(), token.encode())


def _cookie(request: Request, name: str) -> str:
    try:
        found = SimpleCookie(_only(request, "Cookie")).get(name)
    except CookieError:
        return ""
    return "" if found is None else found.value


def _refused() -> Response:
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(REFUSED))})
    return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", headers, REFUSED)
