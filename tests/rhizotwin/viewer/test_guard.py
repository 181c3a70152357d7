"""Connections of browsers, without a browser."""

import socket

import pytest
from websockets.datastructures import Headers
from websockets.http11 import Request

from rhizotwin.viewer import guard


@pytest.mark.parametrize("twice", ["Host: a", "Origin: http://a", "Cookie: a=b", "Upgrade: x"])
def test_a_header_that_is_there_twice_is_no_error(twice: str):
    headers = Headers([("Host", "here:1"), ("Upgrade", "websocket"), ("Origin", "http://here:1"), ("Cookie", "rhizotwin_1=t")])
    headers[twice.partition(":")[0]] = twice.partition(": ")[2]
    refused = guard.answer("t", lambda *_: None, None, Request("/", headers))
    assert twice[0] == "U" or (refused is not None and refused.status_code == 403)


def test_pages_wait_for_what_is_shown():
    served = guard.serve(port=8390)
    try:
        with socket.create_connection((served.host, served.port), timeout=20.0) as line:
            line.sendall(
                f"GET / HTTP/1.1\r\nHost: {served.host}:{served.port}\r\nOrigin: http://{served.host}:{served.port}\r\n"
                f"Cookie: rhizotwin_{served.port}={served.token}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
                "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
            )
            line.settimeout(0.3)
            with pytest.raises(TimeoutError):
                line.recv(100)
            served.open.set()
            line.settimeout(20.0)
            assert line.recv(100).startswith(b"HTTP/1.1 101")
    finally:
        served.stop()
