"""Access to the console: a token in the address or a password, a cookie for browsers, a header against foreign pages.

Every request passes `Guard` first. A browser that has opened the address with the token, or has given the password,
gets a cookie. The cookie alone allows reading; a request that changes something must carry the secret of the page in a
header as well, which pages of other origins can neither read nor send. Programs send token or password as
``Authorization: Bearer SECRET``.
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
"""Maximum length of a request's body."""
MOST_SESSIONS = 1000
WAIT_S = 1.0
"""Time after a wrong password, during which no other is checked (s)."""
PUBLIC = ("/console.css", "/login")
"""Paths served without authentication, for the login page."""
REFUSED = "This page needs the whole address that `rhizotwin console` printed, with its token.\n"
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
    """Secrets of a running console."""

    password: str = ""
    """Empty: only the token gives access."""
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24))
    sessions: dict[str, str] = field(default_factory=dict)
    """Secret of the page by cookie."""
    _checking: asyncio.Lock = field(default_factory=asyncio.Lock)

    def new_session(self) -> str:
        """Return the cookie of a new session."""
        cookie = secrets.token_urlsafe(24)
        self.sessions[cookie] = secrets.token_urlsafe(24)
        while len(self.sessions) > MOST_SESSIONS:
            del self.sessions[next(iter(self.sessions))]
        return cookie

    async def allows(self, secret: str) -> bool:
        """Check a token or password; after a wrong password the next one has to wait."""
        if _same(secret, self.token):
            return True
        if not self.password:
            return False
        async with self._checking:
            if _same(secret, self.password):
                return True
            await asyncio.sleep(WAIT_S)
        return False


class Guard:
    """ASGI application that lets only authorised requests through to another one.

    Parameters
    ----------
    app : ASGI application
        The console's.
    access : Access
        The secrets.
    """

    def __init__(self, app: App, access: Access) -> None:
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or pass it on."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
        elif scope["type"] == "http":
            await self._request(scope, receive, _with_headers(send))

    async def _request(self, scope: Scope, receive: Receive, send: Send) -> None:
        path, method = scope["path"], scope["method"]
        cookie_name = cookie_of(scope)
        changes = method not in ("GET", "HEAD")
        if changes and _is_too_long(scope):
            await _answer(send, 413, "the body of a request may have at most 64 KiB, and must state its Content-Length\n")
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
            await _answer(send, 303, "", **login_headers(cookie_name, self._access.new_session()))
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
            await _answer(send, 403, f"a request that changes something needs the header {HEADER}\n")


def cookie_of(scope: Scope) -> str:
    """Return the name of the cookie: browsers share cookies among the ports of a computer."""
    return f"rhizotwin_console_{_header(scope, 'host').rpartition(':')[2] or 'default'}"


def login_headers(cookie_name: str, cookie: str) -> dict[str, str]:
    """Return the headers that set a session's cookie and lead to the page."""
    return {"Location": "/", "Set-Cookie": f"{cookie_name}={cookie}; HttpOnly; SameSite=Strict; Path=/"}


def _with_headers(send: Send) -> Send:
    """Add the security headers to a response that does not have its own."""

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
    """Return a header; empty where it is missing or given several times, which no browser sends."""
    found = [value.decode("utf-8", "replace") for key, value in scope["headers"] if key.decode("latin-1").lower() == name]
    return found[0] if len(found) == 1 else ""


def _is_too_long(scope: Scope) -> bool:
    """Return whether a body is too long, or its length is not known before it is read."""
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
