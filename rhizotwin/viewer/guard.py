"""A viser server that answers only those who know its token.

The printed address carries the token; the first answer turns it into a cookie, which the browser then sends with the
page and with the websocket. A websocket must also come from the page's own origin: a page of another port of this
machine shares its cookies.
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
REFUSED = b"This page needs the whole address that `rhizotwin` printed, with its token.\n"
_LOOK_S = 0.01
"""Between two looks whether pages may have what is shown."""
Answer = Callable[[Any, Request], Response | None]


@dataclass(frozen=True)
class Served:
    """A running server and how to reach it."""

    server: viser.ViserServer
    host: str
    port: int
    token: str
    open: threading.Event
    """Set when pages may have what is shown; until then they load, and wait for it."""

    @property
    def address(self) -> str:
        """Return the address to open in a browser."""
        return f"http://{self.host}:{self.port}/?token={self.token}"

    def stop(self) -> None:
        """End it."""
        with redirect_stdout(io.StringIO()):  # viser says that it stopped
            self.server.stop()


def serve(*, host: str = LOCAL, port: int = 8080, title: str = "rhizotwin") -> Served:
    """Start a server; where the port is taken, at the next free one.

    Browsers may load the page at once, while what is shown is being read: they get it when `Served.open` is set.

    Raises
    ------
    UserError
        Where the address is not this machine's, or no port is free.
    """
    token, is_open = secrets.token_urlsafe(24), threading.Event()
    try:
        with _guarded(token, is_open), redirect_stdout(io.StringIO()):  # viser's own greeting lacks the token
            server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
    except OSError as error:
        raise UserError(f"nothing can be served at {host}:{port} ({error}); choose another --host or --port") from None
    return Served(server, host, server.get_port(), token, is_open)


@contextmanager
def _guarded(token: str, is_open: threading.Event) -> Iterator[None]:
    """Let servers that start meanwhile ask for the token; viser has no hook for it of its own."""
    started = websockets.asyncio.server.serve

    def ask_first(*arguments: Any, process_request: Answer, **more: Any) -> Any:
        async def ask(connection: Any, request: Request) -> Response | None:
            found = answer(token, process_request, connection, request)
            while found is None and not is_open.is_set():  # a websocket
                await asyncio.sleep(_LOOK_S)
            return found

        return started(*arguments, process_request=ask, **more)

    with patch.object(websockets.asyncio.server, "serve", ask_first):
        yield


def answer(token: str, inner: Answer, connection: Any, request: Request) -> Response | None:
    """Refuse a request without the token, turn one in the address into a cookie, and let ``inner`` answer the rest."""
    host = _only(request, "Host")
    name = f"rhizotwin_{host.rpartition(':')[2]}"
    asked = parse_qs(urlsplit(request.path).query).get("token", [""])[0]
    is_socket = _only(request, "Upgrade").lower() == "websocket"
    if not host or (is_socket and _netloc(_only(request, "Origin")) != host):
        return _refused()
    if not (_same(asked, token) or _same(_cookie(request, name), token)):
        return _refused()
    found = inner(connection, request)
    if found is not None and _same(asked, token):
        found.headers["Set-Cookie"] = f"{name}={token}; HttpOnly; SameSite=Strict; Path=/"
    if found is not None:
        found.headers["Referrer-Policy"] = "no-referrer"
        found.headers["X-Content-Type-Options"] = "nosniff"
        found.headers["X-Frame-Options"] = "DENY"
        found.headers["Cache-Control"] = "no-store"
    return found


def _only(request: Request, name: str) -> str:
    """Return a header's value; empty where it is missing or there several times, which no browser sends."""
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
