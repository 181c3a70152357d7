"""Who gets an answer from the console: tokens, passwords, cookies and the header against foreign pages."""

import http.client
import socket
import time
from collections.abc import Callable
from urllib.parse import urlencode

import pytest

from rhizotwin.console.client import Console
from rhizotwin.scenes.errors import UserError
from tests.rhizotwin.console.conftest import Lab


def ask(lab: Lab, method: str, path: str, body: str = "", **headers: str) -> tuple[int, dict[str, str], str]:
    """Send one request; return status, headers and text."""
    line = http.client.HTTPConnection("127.0.0.1", lab.served.port, timeout=30)
    line.request(method, path, body=body or None, headers={name.replace("_", "-"): value for name, value in headers.items()})
    answer = line.getresponse()
    text = answer.read().decode("utf-8", "replace")
    line.close()
    return answer.status, {name.lower(): value for name, value in answer.getheaders()}, text


CLOSED = ["", "console.js", "api/state", "api/picture.jpg", "api/openapi.json", "results/x/report.html", "login", "?token=", "?token=x"]


def session(lab: Lab) -> tuple[str, str]:
    """Return the cookie of a browser that opened the address, and the secret of its page."""
    status, headers, _ = ask(lab, "GET", f"/?token={lab.served.access.token}")
    assert (status, headers["location"]) == (303, "/")
    assert "HttpOnly; SameSite=Strict" in headers["set-cookie"]
    cookie = headers["set-cookie"].partition(";")[0]
    status, _, text = ask(lab, "GET", "/", Cookie=cookie)
    assert status == 200
    return cookie, text.partition('name="secret" content="')[2].partition('"')[0]


def test_nothing_without_a_secret(lab: Lab) -> None:
    answers = [ask(lab, "GET", f"/{path}") for path in CLOSED]
    assert [status for status, *_ in answers] == [401] * len(CLOSED)
    assert all("token" in text for *_, text in answers)
    assert all("frame-ancestors 'none'" in headers["content-security-policy"] for _, headers, _ in answers)
    assert ask(lab, "POST", "/api/control", "{}")[0] == 401
    assert ask(lab, "GET", "/api/state", Authorization="Bearer x")[0] == 401
    assert ask(lab, "GET", "/api/state", Authorization=f"Bearer {lab.served.access.token}")[0] == 200
    assert ask(lab, "GET", "/api/state", Cookie="rhizotwin_console_8760=x; a=\x01")[0] == 401


def test_a_cookie_reads_and_changes_nothing_without_the_header(lab: Lab) -> None:
    cookie, secret = session(lab)
    assert len(secret) > 20
    headers = ask(lab, "GET", "/", Cookie=cookie)[1]
    assert "default-src 'none'" in headers["content-security-policy"]
    assert "unsafe" not in headers["content-security-policy"]
    expected = {"x-content-type-options": "nosniff", "referrer-policy": "no-referrer", "cache-control": "no-store"}
    assert headers.items() >= expected.items()
    assert "server" not in headers
    assert ask(lab, "GET", "/api/state", Cookie=cookie)[0] == 200
    other_cookie, other_secret = session(lab)
    assert other_cookie != cookie
    named = {"Cookie": cookie, "Content_Type": "application/json", "X_Rhizotwin_Client": "1"}
    tokens = ({"X_Rhizotwin_Token": token} if token else {} for token in ("", "x", other_secret, secret))
    assert [ask(lab, "POST", "/api/control", '{"name": "Eve"}', **named, **token)[0] for token in tokens] == [403, 403, 403, 200]


@pytest.fixture
def closed(make_lab: Callable[..., Lab]) -> Lab:
    return make_lab(password="Wurzelfüße корень")


def test_password(closed: Lab) -> None:
    assert ask(closed, "GET", "/")[1]["location"] == "/login"
    assert "Password" in ask(closed, "GET", "/login")[2]
    assert ask(closed, "GET", "/console.css")[0] == 200
    form = {"Content_Type": "application/x-www-form-urlencoded"}
    begun = time.monotonic()
    status, _, text = ask(closed, "POST", "/login", urlencode({"password": "wrong"}), **form)
    assert status == 401
    assert "The password is wrong" in text
    assert time.monotonic() - begun >= 1.0
    status, headers, _ = ask(closed, "POST", "/login", urlencode({"password": closed.served.access.password}), **form)
    assert (status, headers["location"]) == (303, "/")
    assert ask(closed, "GET", "/", Cookie=headers["set-cookie"].partition(";")[0])[0] == 200
    address = f"http://127.0.0.1:{closed.served.port}/"
    Console(address, password=closed.served.access.password).state()
    with pytest.raises(UserError, match="token or password is wrong"):
        Console(address, password="another").state()


CHUNKED = "Transfer-Encoding: chunked"


@pytest.mark.parametrize("length", ["Content-Length: 65537", f"Content-Length: 1\r\n{CHUNKED}", CHUNKED])
def test_bodies_are_limited_before_they_are_read(closed: Lab, length: str) -> None:
    with socket.create_connection(("127.0.0.1", closed.served.port), timeout=30) as line:
        line.sendall(f"POST /login HTTP/1.1\r\nHost: localhost\r\n{length}\r\n\r\n".encode())
        assert line.recv(100).startswith(b"HTTP/1.1 413 ")
    secret = {"Authorization": f"Bearer {closed.served.access.token}", "X_Rhizotwin_Client": "1"}
    assert ask(closed, "DELETE", "/api/control", **secret)[0] == 200  # without a body, as browsers send it
