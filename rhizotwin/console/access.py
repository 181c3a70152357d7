"""Authentication of requests to the console by token, password, session cookie and page secret.

All requests pass through `Guard`. A browser receives a session cookie after it has opened the address with the token,
or after the user has entered the password. The cookie is sufficient for reading. A request that changes the state must
also have a header with the secret of the page, which pages of other origins can neither read nor send. Programs send
the token or the password in the header ``Authorization: Bearer SECRET``.
"""

from __future__ import annotations

import asyncio
import hmac
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

HEADER = "x-rhizotwin-token"
MOST_BYTES = 64 * 1024
"""Maximum length of a request's body, bytes."""
MOST_SESSIONS = 1000
WAIT_S = 1.0
"""Delay, in seconds, of the answer to a wrong password."""
MOST_WAITING = 100
"""Maximum number of wrong passwords whose answers are delayed at the same time, so that most connections
(`connections.MOST_CONNECTIONS`) remain for other clients."""
PUBLIC = ("/console.css", "/login")
"""Paths that are served without authentication, because the login page needs them."""
REFUSED = "The address is incomplete. Open the complete address printed by `rhizotwin console`, which includes a token.\n"
FORWARD = '<!doctype html><meta http-equiv="refresh" content="0; url=/"><a href="/">Open the console</a>\n'
"""Answer to the address with the token, which leads to the same address without it."""
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    ),
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}


@dataclass
class Access:
    """Secrets that grant access to a running console."""

    password: str = ""
    """Password of the console. If it is empty, only the token grants access."""
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24))
    sessions: dict[str, str] = field(default_factory=dict)
    """Secret that the console's page must send with each change, keyed by session cookie."""
    _waiting: int = 0

    def new_session(self) -> str:
        """Create a session, and return its cookie."""
        cookie = secrets.token_urlsafe(24)
        self.sessions[cookie] = secrets.token_urlsafe(24)
        while len(self.sessions) > MOST_SESSIONS:
            del self.sessions[next(iter(self.sessions))]
        return cookie

    async def allows(self, secret: str) -> bool:
        """Return whether a secret is the token or the password.

        A correct secret is never delayed. If the console has a password, a wrong secret is answered after `WAIT_S`, or
        at once if `MOST_WAITING` answers are already delayed.
        """
        if _same(secret, self.token) or (self.password and _same(secret, self.password)):
            return True
        if self.password and self._waiting < MOST_WAITING:
            self._waiting += 1
            try:
                await asyncio.sleep(WAIT_S)
            finally:
                self._waiting -= 1
        return False


class Guard:
    """ASGI middleware that forwards authorised requests to an application and rejects all other requests.

    Parameters
    ----------
    app : ASGI application
        Application of the console.
    access : Access
        Secrets that authorise a request.
    """

    def __init__(self, app: App, access: Access) -> None:
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Forward an authorised request to the application, or send an error response."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
        elif scope["type"] == "http":
            await self._request(scope, receive, _with_headers(send))

    async def _request(self, scope: Scope, receive: Receive, send: Send) -> None:
        path, method = scope["path"], scope["method"]
        cookie_name = cookie_of(scope)
        changes = method not in ("GET", "HEAD")
        if changes and _is_too_long(scope):
            await _answer(send, 413, "the body of the request must not exceed 64 KiB, and the header Content-Length is required\n")
            return
        bearer = _header(scope, "authorization")
        if bearer.lower().startswith("bearer "):
            if await self._access.allows(bearer[7:].strip()):
                await self._app(scope, receive, send)
            else:
                await _answer(send, 401, "the token or password is wrong\n")
            return
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        if path == "/" and _same(given, self._access.token):
            # Not a redirect: browsers send a strict cookie only if the site's own page leads to the next one, but the
            # user may come from a file (`rhizotwin.viewer.private_page`).
            cookie = login_headers(cookie_name, self._access.new_session())["Set-Cookie"]
            await _answer(send, 200, FORWARD, Content_Type="text/html; charset=utf-8", Set_Cookie=cookie)
            return
        page_secret = self._access.sessions.get(_cookie(scope, cookie_name))
        if page_secret is not None and (not changes or _same(_header(scope, HEADER), page_secret)):
            scope.setdefault("state", {})["page_secret"] = page_secret
            await self._app(scope, receive, send)
        elif path in PUBLIC and (path != "/login" or self._access.password):
            await self._app(scope, receive, send)
        elif page_secret is None and path == "/" and self._access.password:
            await _answer(send, 303, "", Location="/login")
        elif page_secret is None:
            await _answer(send, 401, REFUSED)
        else:
            await _answer(send, 403, f"a request that changes the state of the console needs the header {HEADER} with the page's secret\n")


def cookie_of(scope: Scope) -> str:
    """Return the name of the session cookie.

    The name contains the port, because browsers send cookies to all ports of a host.
    """
    return f"rhizotwin_console_{_header(scope, 'host').rpartition(':')[2] or 'default'}"


def login_headers(cookie_name: str, cookie: str) -> dict[str, str]:
    """Return the response headers that set a session cookie and redirect to the console's page."""
    return {"Location": "/", "Set-Cookie": f"{cookie_name}={cookie}; HttpOnly; SameSite=Strict; Path=/"}


def _with_headers(send: Send) -> Send:
    """Wrap the ASGI function ``send`` so that it adds missing security headers to each response."""

    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            there = {name.decode("latin-1").lower() for name, _ in message.get("headers", [])}
            more = [(name.encode(), value.encode()) for name, value in HEADERS.items() if name.lower() not in there]
            message = {**message, "headers": [*message.get("headers", []), *more]}
        await send(message)

    return sent


async def _answer(send: Send, status: int, text: str, **headers: str) -> None:
    body = text.encode()
    named = {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body)), **headers}
    lines = [(name.replace("_", "-").encode(), value.encode("latin-1")) for name, value in named.items()]
    await send({"type": "http.response.start", "status": status, "headers": lines})
    await send({"type": "http.response.body", "body": body})


def _header(scope: Scope, name: str) -> str:
    """Return the value of a request header. The value is empty if the header is missing or occurs more than once."""
    found = [value.decode("utf-8", "replace") for key, value in scope["headers"] if key.decode("latin-1").lower() == name]
    return found[0] if len(found) == 1 else ""


def _is_too_long(scope: Scope) -> bool:
    """Return whether the body of a request exceeds `MOST_BYTES`.

    Bodies without a valid Content-Length header are rejected, too.
    """
    headers = {key.lower() for key, _ in scope["headers"]}
    if b"transfer-encoding" in headers:
        return True
    text = _header(scope, "content-length")
    return b"content-length" in headers and not (text.isascii() and text.isdigit() and len(text) < 12 and int(text) <= MOST_BYTES)


def _cookie(scope: Scope, name: str) -> str:
    try:
        found = SimpleCookie(_header(scope, "cookie")).get(name)
    except CookieError:
        return ""
    return "" if found is None else found.value


def _same(given: str, secret: str) -> bool:
    return hmac.compare_digest(given.encode(), secret.encode())
