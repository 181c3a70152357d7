"""Connections of browsers, without a browser."""

import http.client
import os
import stat
import tempfile
import time
import webbrowser
from pathlib import Path

import pytest
from websockets.datastructures import Headers
from websockets.http11 import Request

from rhizotwin.viewer import guard, private_page
from tests.rhizotwin.browser import until

SOCKET = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13", "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}


@pytest.mark.parametrize("twice", ["Host: a", "Origin: http://a", "Cookie: a=b", "Upgrade: x"])
def test_a_header_that_is_there_twice_is_no_error(twice: str):
    headers = Headers([("Host", "here:1"), ("Upgrade", "websocket"), ("Origin", "http://here:1"), ("Cookie", "rhizotwin_1=t")])
    headers[twice.partition(":")[0]] = twice.partition(": ")[2]
    refused = guard.answer("t", lambda *_: None, None, Request("/", headers))
    assert twice[0] == "U" or (refused is not None and refused.status_code == 403)


def test_the_browsers_command_line_has_no_token(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(private_page, "KEPT_S", 1.0)
    private_page.open_page("http://127.0.0.1:1/?token=secret")
    (file,) = tmp_path.iterdir()
    assert opened == [file.as_uri()]
    assert "secret" not in file.name
    assert 'content="0; url=http://127.0.0.1:1/?token=secret"' in file.read_text(encoding="utf-8")
    assert os.name != "posix" or stat.S_IMODE(file.stat().st_mode) == 0o600
    until(lambda: not file.exists())


def test_the_token_is_asked_for_and_pages_wait_for_what_is_shown(caplog: pytest.LogCaptureFixture):
    served = guard.serve(port=8390)

    def asked(path: str, timeout_s: float = 20.0, **headers: str) -> int:
        line = http.client.HTTPConnection(served.host, served.port, timeout=timeout_s)
        try:
            line.request("GET", path, headers=headers)
            answer = line.getresponse()
            assert "HttpOnly" in (answer.getheader("Set-Cookie") or "") or answer.status != 200 or "Cookie" in headers
            return answer.status
        finally:
            line.close()

    own = {"Origin": f"http://{served.host}:{served.port}"}
    cookie = {"Cookie": f"rhizotwin_{served.port}={served.token}"}
    try:
        with pytest.raises(TimeoutError):
            asked("/", 0.3, **SOCKET, **cookie, **own)
        served.open.set()
        time.sleep(0.1)  # the browser that went away is noticed
        assert caplog.messages == []
        assert asked(f"/?token={served.token}") == 200
        assert asked("/", **cookie) == 200
        wrong = [asked("/"), asked("/?token=wrong"), asked("/", Cookie=f"rhizotwin_{served.port}=wrong"), asked("/", **SOCKET, **own)]
        no_page, other_page = asked("/", **SOCKET, **cookie), asked("/", **SOCKET, **cookie, Origin="http://127.0.0.1:1")
        assert [*wrong, no_page, other_page] == [403] * 6
        assert [asked(path, **cookie) for path in ("/../../../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd")] == [404, 404]
        assert asked("/", **SOCKET, **cookie, **own) == 101
    finally:
        served.stop()
