"""Who gets an answer from the console: tokens, passwords, cookies and the header against foreign pages."""

import http.client
import socket
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from urllib.parse import urlencode

import pytest

from rhizotwin.console import access, connections
from rhizotwin.console.client import Console
from rhizotwin.scenes.errors import UserError
from tests.rhizotwin.browser import until
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
    status, headers, text = ask(lab, "GET", f"/?token={lab.served.access.token}")
    assert (status, 'content="0; url=/"' in text) == (200, True)
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
    status, _, text = ask(closed, "POST", "/login", urlencode({"password": "wrong"}), **form)
    assert status == 401
    assert "The password is wrong" in text
    status, headers, _ = ask(closed, "POST", "/login", urlencode({"password": closed.served.access.password}), **form)
    assert (status, headers["location"]) == (303, "/")
    assert ask(closed, "GET", "/", Cookie=headers["set-cookie"].partition(";")[0])[0] == 200
    address = f"http://127.0.0.1:{closed.served.port}/"
    begun, wrong = time.monotonic(), [Console(address, password="another") for _ in range(60)]
    with ThreadPoolExecutor(60) as pool:
        refused = [pool.submit(one.state) for one in wrong]
        until(lambda: closed.served.access._waiting == 60)
        right = Console(address, password=closed.served.access.password)
        assert right.state()["activity"] == ""
        with pytest.raises(UserError, match="no scan is running"):
            right.stop_scan()
        assert {one.done() for one in refused} == {False}, "the right one is not behind the wrong ones"
        assert {str(one.exception()) for one in refused} == {"the token or password is wrong"}
    assert time.monotonic() - begun >= access.WAIT_S


def test_silent_connections_make_room(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "MOST_CONNECTIONS", 6)
    here = ("127.0.0.1", lab.served.port)
    slow = b"POST /api/control HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer " + lab.served.access.token.encode()
    sent = [b"", b"GET / HT", slow + b"\r\nX-Rhizotwin-Client: a\r\nContent-Length: 9\r\n\r\n{"]
    with ExitStack() as stack:
        lines = [stack.enter_context(socket.create_connection(here, timeout=20)) for _ in range(15)]
        for k, line in enumerate(lines[-3:]):
            line.sendall(sent[k])
        assert {line.recv(1) for line in lines[:9]} == {b""}, "the oldest ones were closed"
        assert lab.client().state()["activity"] == ""
        monkeypatch.setattr(connections, "QUIET_S", 0.0)
        assert {line.recv(1) for line in lines[9:]} == {b""}, "the others after a while"
        assert lab.client().state()["activity"] == ""


CHUNKED = "Transfer-Encoding: chunked"


@pytest.mark.parametrize("length", ["Content-Length: 65537", f"Content-Length: 1\r\n{CHUNKED}", CHUNKED])
def test_bodies_are_limited_before_they_are_read(closed: Lab, length: str) -> None:
    with socket.create_connection(("127.0.0.1", closed.served.port), timeout=30) as line:
        line.sendall(f"POST /login HTTP/1.1\r\nHost: localhost\r\n{length}\r\n\r\n".encode())
        assert line.recv(100).startswith(b"HTTP/1.1 413 ")
    secret = {"Authorization": f"Bearer {closed.served.access.token}", "X_Rhizotwin_Client": "1"}
    assert ask(closed, "DELETE", "/api/control", **secret)[0] == 200  # without a body, as browsers send it
