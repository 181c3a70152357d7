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
    for path in (
        "/",
        "/console.js",
        "/api/state",
        "/api/picture.jpg",
        "/api/openapi.json",
        "/results/x/report.html",
        "/login",
        "/?token=",
        "/?token=x",
    ):
        status, headers, text = ask(lab, "GET", path)
        assert status == 401, path
        assert "token" in text
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert ask(lab, "POST", "/api/control", "{}")[0] == 401
    assert ask(lab, "GET", "/api/state", Authorization="Bearer x")[0] == 401
    assert ask(lab, "GET", "/api/state", Authorization=f"Bearer {lab.served.access.token}")[0] == 200
    assert ask(lab, "GET", "/api/state", Cookie="rhizotwin_console_8760=x; a=\x01")[0] == 401


def test_a_cookie_reads_and_changes_nothing_without_the_header(lab: Lab) -> None:
    cookie, secret = session(lab)
    assert len(secret) > 20
    assert ask(lab, "GET", "/api/state", Cookie=cookie)[0] == 200
    body = '{"name": "Eve"}'
    named = {"Cookie": cookie, "Content_Type": "application/json", "X_Rhizotwin_Client": "1"}
    assert ask(lab, "POST", "/api/control", body, **named)[0] == 403
    assert ask(lab, "POST", "/api/control", body, **named, X_Rhizotwin_Token="x")[0] == 403
    assert ask(lab, "POST", "/api/control", body, **named, X_Rhizotwin_Token=secret)[0] == 200
    other_cookie, other_secret = session(lab)
    assert other_cookie != cookie
    assert ask(lab, "POST", "/api/control", body, **named, X_Rhizotwin_Token=other_secret)[0] == 403


def test_headers_of_the_page(lab: Lab) -> None:
    cookie, _ = session(lab)
    status, headers, _ = ask(lab, "GET", "/", Cookie=cookie)
    assert status == 200
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["referrer-policy"] == "no-referrer"
    assert headers["cache-control"] == "no-store"
    assert "server" not in headers


def test_password(make_lab: Callable[..., Lab]) -> None:
    lab = make_lab("a long password")
    assert ask(lab, "GET", "/")[1]["location"] == "/login"
    assert "Password" in ask(lab, "GET", "/login")[2]
    assert ask(lab, "GET", "/console.css")[0] == 200
    form = {"Content_Type": "application/x-www-form-urlencoded"}
    begun = time.monotonic()
    status, _, text = ask(lab, "POST", "/login", urlencode({"password": "wrong"}), **form)
    assert status == 401
    assert "The password is wrong" in text
    assert time.monotonic() - begun >= 1.0
    status, headers, _ = ask(lab, "POST", "/login", urlencode({"password": "a long password"}), **form)
    assert (status, headers["location"]) == (303, "/")
    assert ask(lab, "GET", "/", Cookie=headers["set-cookie"].partition(";")[0])[0] == 200
    address = f"http://127.0.0.1:{lab.served.port}/"
    Console(address, password="a long password").state()
    with pytest.raises(UserError, match="token or password is wrong"):
        Console(address, password="another").state()


def test_bodies_are_limited_before_they_are_read(make_lab: Callable[..., Lab]) -> None:
    lab = make_lab("a long password")
    for length in ("Content-Length: 65537", "Content-Length: 1\r\nTransfer-Encoding: chunked", "Transfer-Encoding: chunked"):
        with socket.create_connection(("127.0.0.1", lab.served.port), timeout=30) as line:
            line.sendall(f"POST /login HTTP/1.1\r\nHost: localhost\r\n{length}\r\n\r\n".encode())
            assert line.recv(100).startswith(b"HTTP/1.1 413 "), length
    secret = {"Authorization": "Bearer a long password", "X_Rhizotwin_Client": "1"}
    assert ask(lab, "DELETE", "/api/control", **secret)[0] == 200  # without a body, as browsers send it


def test_a_password_in_any_script(make_lab: Callable[..., Lab]) -> None:
    lab = make_lab("Wurzelfüße корень")
    Console(f"http://127.0.0.1:{lab.served.port}/", password="Wurzelfüße корень").state()
