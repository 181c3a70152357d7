"""Client and server over a real connection on this computer, with a proxy between them that loses, cuts, damages and doubles answers."""

import http.client
import json
import re
import socket
import socketserver
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from dataclasses import dataclass
from typing import Any
from unittest.mock import Mock
from urllib.parse import urlsplit

import numpy as np
import pytest

from rhizotwin.rig.cameras import http as http_module
from rhizotwin.rig.cameras import open_camera
from rhizotwin.rig.cameras import server as server_module
from rhizotwin.rig.cameras.http import PAUSE_S, RETRIES, HttpCamera
from rhizotwin.rig.cameras.requests import MOST_CONNECTIONS
from rhizotwin.rig.cameras.server import CameraServer, serve_camera
from rhizotwin.rig.cameras.service import KEPT, CameraService
from rhizotwin.rig.cameras.settings import CameraSettings
from rhizotwin.rig.devices import Shot
from rhizotwin.rig.errors import LostError, NoAnswerError, RigError
from rhizotwin.rig.rig_file import CameraPart
from tests.rig.fake_time import Time

SETTINGS = CameraSettings(image_wh=(32, 24), bits=12, exposure_s=0.01, gain=2.0)
A, B = "a" * 32, "b" * 32


@dataclass
class _NumberedCamera:
    """A camera whose pictures are numbered: each pixel is the number of the picture, four bits up."""

    taken: int = 0
    prepared: int = 0
    closed: int = 0
    dtype: type = np.uint16
    shape: tuple[int, int] = (24, 32)
    exposure_s: float | None = 0.01
    gain: float | None = 2.0

    def describe(self) -> str:
        return "camera of the test"

    def prepare(self) -> None:
        self.prepared += 1

    def capture(self) -> Shot:
        self.taken += 1
        noise = np.random.default_rng(self.taken).integers(0, 16, self.shape)
        image = (noise * 256 + self.taken).astype(self.dtype) << (4 if self.dtype is np.uint16 else 0)
        return Shot(image=image, exposure_s=self.exposure_s, gain=self.gain)

    def close(self) -> None:
        self.closed += 1


def number_of(shot: Shot) -> int:
    return int(shot.image[0, 0] >> (4 if shot.image.dtype == np.uint16 else 0)) & 0xFF


@pytest.fixture
def camera() -> _NumberedCamera:
    return _NumberedCamera()


@pytest.fixture
def server(camera: _NumberedCamera) -> Iterator[CameraServer]:
    found = CameraServer(camera)
    found.start()
    yield found
    found.stop()


def remote_of(url: str, settings: CameraSettings = SETTINGS) -> HttpCamera:
    return HttpCamera(url, settings, clock=Time())


def client(server: CameraServer, settings: CameraSettings = SETTINGS) -> HttpCamera:
    found = remote_of(server.url, settings)
    found.prepare()
    return found


@contextmanager
def listening(handler: type[socketserver.BaseRequestHandler]) -> Iterator[str]:
    """Serve with a handler; give the address."""
    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), handler) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, args=(0.02,))
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}"
        finally:
            server.shutdown()
            thread.join()


def proxy(server: CameraServer, mangle: Callable[[bytes, int], bytes | None], *, repeats: int = 1) -> AbstractContextManager[str]:
    """Pass requests on; ``mangle`` gets each answer of /capture with its number and returns what arrives, or None to break off."""
    target = urlsplit(server.url)
    counted = 0

    class _Handler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            nonlocal counted
            head = b""
            while not head.endswith(b"\r\n\r\n"):
                head += self.rfile.readline()
            length = re.search(rb"content-length: (\d+)", head.lower())
            body = self.rfile.read(int(length[1])) if length else b""
            answer: bytes | None = b""
            for _ in range(repeats):
                with socket.create_connection((target.hostname, target.port), timeout=5.0) as upstream:
                    upstream.sendall(head + body)
                    with upstream.makefile("rb") as stream:
                        answer = stream.read()
            if b"/capture" in head:
                counted += 1
                answer = mangle(answer, counted)
            if answer is not None:
                self.wfile.write(answer)

    return listening(_Handler)


@pytest.mark.parametrize(("dtype", "bits"), [(np.uint16, 12), (np.uint8, 8)])
def test_pictures_arrive_as_they_were_taken(server: CameraServer, camera: _NumberedCamera, dtype: type, bits: int) -> None:
    camera.dtype = dtype
    remote = client(server, CameraSettings(image_wh=(32, 24), bits=bits, gain=2.0))
    shot = remote.capture()
    camera.taken = 1
    same = camera.capture()
    assert shot.image.dtype == dtype
    assert np.array_equal(shot.image, same.image)
    assert (shot.exposure_s, shot.gain) == (0.01, 2.0)


def test_each_capture_is_new_even_if_requests_arrive_twice(server: CameraServer, camera: _NumberedCamera) -> None:
    with proxy(server, lambda answer, _: answer, repeats=2) as url:
        remote = remote_of(url)
        remote.prepare()
        assert remote.describe() == f"camera of the test, at {url}"
        assert [number_of(remote.capture()) for _ in range(3)] == [2, 3, 4]  # the first proved the settings
        assert (camera.prepared, camera.taken) == (1, 4)


def flipped(answer: bytes) -> bytes:
    at = answer.index(b"\r\n\r\n") + 104
    return answer[:at] + bytes([answer[at] ^ 1]) + answer[at + 1 :]


FAULTS: dict[str, tuple[Callable[[bytes], bytes | None], str]] = {
    "lost": (lambda _: None, "closed connection without response"),
    "cut in the picture": (lambda answer: answer[:-7], "of [0-9]+ bytes were received"),
    "damaged": (flipped, "the picture was damaged during transmission"),
    "of another": (lambda answer: re.sub(rb"(?<=Picture: ).{32}", A.encode(), answer), "the reply is for a different request"),
}
"""What happens to the answer of a capture, and what is said of it."""


@pytest.mark.parametrize(("mangle", "said"), FAULTS.values(), ids=FAULTS)
def test_a_lost_answer_costs_no_picture_and_none_ever_is_named(
    server: CameraServer, camera: _NumberedCamera, mangle: Callable[[bytes], bytes | None], said: str
) -> None:
    clock = Time()
    bad = set(range(2, 2 + RETRIES))  # the first capture proves the settings; of the second, only the last attempt arrives
    with proxy(server, lambda answer, k: mangle(answer) if k in bad else answer) as url:
        remote = HttpCamera(url, SETTINGS, clock=clock)
        remote.prepare()
        assert [number_of(remote.capture()) for _ in range(2)] == [2, 3]
    assert camera.taken == 3
    assert clock.slept == [PAUSE_S] * RETRIES
    with proxy(server, lambda answer, _: mangle(answer)) as url:
        with pytest.raises(NoAnswerError, match=said) as caught:
            remote_of(url).prepare()
        assert f"camera at {url}: no complete reply after 4 attempts" in str(caught.value)
    assert camera.taken == 4


def test_a_server_that_stops_and_is_started_again(server: CameraServer, camera: _NumberedCamera) -> None:
    remote = client(server)
    port = urlsplit(server.url).port or 0
    server.stop()
    assert camera.closed >= 1
    with pytest.raises(NoAnswerError, match=r"4 attempts .*refused.*; check the network, and that rhizotwin camera runs"):
        remote.capture()
    second = CameraServer(camera, port=port)
    second.start()
    try:
        with pytest.raises(LostError, match="the camera server was restarted"):
            remote.capture()
        remote.prepare()
        assert number_of(remote.capture()) == 3
    finally:
        second.stop()


def test_a_camera_that_fails_is_named_at_once(server: CameraServer, camera: _NumberedCamera) -> None:
    remote, camera.capture = client(server), Mock(side_effect=RigError("camera 0: no longer delivers frames"))
    with pytest.raises(RigError, match=f"camera at {server.url}: camera 0: no longer delivers frames"):
        remote.capture()


OTHER_SETTINGS = [
    ({"shape": (12, 32)}, "the pictures have 32x12 pixels instead of 32x24"),
    ({"dtype": np.uint8}, "the pictures have 8 bits instead of 12"),
    ({"exposure_s": 0.02}, "the exposure was 20 ms instead of 10 ms"),
    ({"exposure_s": float("nan")}, "the header Rhizotwin-Exposure-S is 'nan', not a number"),
]


@pytest.mark.parametrize(("change", "said"), OTHER_SETTINGS)
def test_pictures_with_other_settings_are_refused(server: CameraServer, camera: _NumberedCamera, change: dict[str, Any], said: str) -> None:
    for name, value in change.items():
        setattr(camera, name, value)
    with pytest.raises(RigError, match=said):
        client(server)


def test_the_clients_settings_open_the_camera(camera: _NumberedCamera) -> None:
    made = list[CameraSettings]()
    given: dict[str, Any] = {"exposure_s": 0.01, "gain": 2.0, "colour_gains": (3.0, 1.5), "white_balance_kelvin": 4000}
    old = _NumberedCamera()
    server = CameraServer(old, reopen=lambda settings: made.append(settings) or camera)
    server.start()
    try:
        open_camera(CameraPart(kind="http", address=server.url, **given), image_wh=(32, 24), bits=12, clock=Time()).prepare()
    finally:
        server.stop()
    assert made == [CameraSettings(image_wh=(32, 24), bits=12, **given)]
    assert (old.prepared, old.closed, camera.prepared, camera.closed) == (0, 1, 1, 1)


@contextmanager
def answering(pieces: Callable[[int], bytes]) -> Iterator[str]:
    """Answer every request piece by piece without end, a piece every 50 ms."""
    over = threading.Event()

    class _Handler(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            self.request.recv(4096)
            with suppress(OSError):
                for number in range(10_000):
                    self.request.sendall(pieces(number))
                    if over.wait(0.05):
                        return

    with listening(_Handler) as url:
        yield url
        over.set()


TRICKLES: dict[str, Callable[[int], bytes]] = {
    "endless headers": lambda k: b"HTTP/1.1 200 OK\r\n" if k == 0 else b"X" if k % 2 else b"Y",
    "a byte now and then": lambda k: b"HTTP/1.1 200 OK\r\nContent-Length: 60000\r\n\r\n" if k == 0 else b"x",
}


@pytest.mark.parametrize("pieces", TRICKLES.values(), ids=TRICKLES)
def test_a_picture_has_one_deadline_whatever_trickles_in(pieces: Callable[[int], bytes], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_module, "ANSWER_S", 0.2)
    begun_s = time.monotonic()
    with answering(pieces) as address, pytest.raises(NoAnswerError, match="no complete reply"):
        remote_of(address).prepare()
    assert time.monotonic() - begun_s < 4.0


def strange(body: bytes, *, status: str = "200 OK", kind: str = "application/json", length: int | str = -1) -> bytes:
    return f"HTTP/1.0 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(body) if length == -1 else length}\r\n\r\n".encode() + body


NOT_OURS = r"the reply is not from a rhizotwin camera \({}\); enter the address"
STRANGE = {
    "another program": (strange(b'{"program": "no"}'), NOT_OURS.format("JSON of another program")),
    "another version": (strange(b'{"program": "rhizotwin camera", "protocol": 0}'), "not from a rhizotwin camera of this version"),
    "snapshot": (strange(b"\xff\xd8" * 60_000, kind="image/jpeg"), NOT_OURS.format("image/jpeg")),
    "stream": (strange(b"--b\r\n", kind="multipart/x-mixed-replace; boundary=b", length=""), NOT_OURS.format("multipart/x-mixed-replace")),
    "login page": (strange(b"<html>", kind="text/html", status="401 No"), NOT_OURS.format("text/html with HTTP status 401")),
    "API": (strange(b'{"detail": 1}', status="404 No"), NOT_OURS.format("HTTP status 404")),
    "no HTTP": (b"SSH-2.0-OpenSSH_9.2\r\n", NOT_OURS.format("not HTTP: SSH-2.0-OpenSSH_9.2.*")),
    "escapes": (strange(b'{"error": "\\u001b[2J\\u001b]0;bad\\u0007"}', status="503 x"), r"127.0.0.1:\d+: +\[2J *\]0;bad"),
    "length of 5000 digits": (strange(b"", length="9" * 5000), r"the reply has 999999999999\.\.\. bytes"),
}


@pytest.mark.parametrize(("answer", "named"), STRANGE.values(), ids=STRANGE)
def test_what_a_strange_server_says_stays_harmless(answer: bytes, named: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_module, "RETRIES", 0)
    with answering(lambda k: answer if k == 0 else b"") as address, pytest.raises(RigError, match=named) as said:
        remote_of(address).prepare()
    assert str(said.value).isprintable()


def test_many_connections_leave_room_and_slow_ones_are_dropped(server: CameraServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rhizotwin.rig.cameras.requests.IDLE_S", 0.3)
    target = urlsplit(server.url)
    idle = [socket.create_connection(("127.0.0.1", target.port), timeout=2.0) for _ in range(MOST_CONNECTIONS + 4)]
    for one in idle:
        with suppress(OSError):
            one.sendall(b"POST /capture HTTP/1.1\r\nContent-Le")
    assert threading.active_count() < MOST_CONNECTIONS * 2 + 8
    ended = 0
    for one in idle:
        with suppress(OSError):
            ended += one.recv(1) in (b"", b"H")
        one.close()
    assert ended >= MOST_CONNECTIONS
    assert client(server).capture().image.shape == (24, 32)


def test_one_computer_has_the_camera_and_one_program_the_port(server: CameraServer, camera: _NumberedCamera) -> None:
    first, second = client(server), client(server)
    with pytest.raises(LostError, match="another computer has taken over the camera"):
        first.capture()
    second.capture()
    port = urlsplit(server.url).port or 0
    with pytest.raises(RigError, match=rf"cannot listen on 127.0.0.1 port {port} \(.*in use\); choose another"):
        CameraServer(camera, port=port)


def test_pictures_kept_are_bounded(camera: _NumberedCamera) -> None:
    service = CameraService(camera)
    service.prepare(A, SETTINGS)
    names = [f"{k:032x}" for k in range(KEPT + 1)]
    pictures = [service.capture(A, name) for name in names]
    assert [service.capture(A, name) for name in names[1:]] == pictures[1:]
    assert camera.taken == KEPT + 1
    service.capture(A, names[0])
    assert camera.taken == KEPT + 2
    service.close()
    with pytest.raises(RigError, match="is stopping"):
        service.capture(A, names[1])


def raw_request(
    server: CameraServer, method: str, path: str, *, headers: dict[str, str] | None = None, body: bytes = b""
) -> tuple[int, bytes]:
    target = urlsplit(server.url)
    sent = {"Content-Type": "application/json", "Content-Length": str(len(body))} | (headers or {})
    with closing(http.client.HTTPConnection(target.hostname or "", target.port, timeout=5.0)) as connection:
        connection.putrequest(method, path, skip_host="Host" in sent)
        for key, value in sent.items():
            if value:
                connection.putheader(key, value)
        connection.endheaders(body)
        response = connection.getresponse()
        return response.status, response.read()


PREPARE = json.dumps({"session": A, "settings": {"image_wh": [32, 24]}}).encode()
REFUSED: dict[str, tuple[int, str, dict[str, Any]]] = {
    "name of another site": (403, "'evil.example' is not a name of this computer", {"headers": {"Host": "evil.example:8471"}}),
    "name that ends like ours": (403, "not a name of this computer", {"headers": {"Host": f"{socket.gethostname()}.evil.example"}}),
    "form of another site": (415, "application/json", {"headers": {"Content-Type": "text/plain"}}),
    "no length": (411, "Content-Length", {"headers": {"Content-Length": ""}, "body": b""}),
    "too long": (413, "4096 bytes", {"body": b" " * 5000 + PREPARE}),
    "no JSON": (400, "not JSON", {"body": b"{"}),
    "nested too deeply": (400, "not JSON|must be a table", {"body": b"[" * 4000}),
    "strange session": (400, "32 hexadecimal digits", {"body": PREPARE.replace(b"aa", b"../")}),
    "not prepared": (409, "restarted", {"path": "/capture", "body": json.dumps({"session": A, "picture": B}).encode()}),
}
"""Requests that must not reach the camera."""


@pytest.mark.parametrize(("status", "said", "request_"), REFUSED.values(), ids=REFUSED)
def test_refused(server: CameraServer, camera: _NumberedCamera, status: int, said: str, request_: dict[str, Any]) -> None:
    found, data = raw_request(server, "POST", **{"path": "/prepare", "body": PREPARE, **request_})
    assert found == status
    assert re.search(said, json.loads(data)["error"])
    assert (camera.prepared, camera.taken) == (0, 0)


def test_own_names_and_no_other_pages(server: CameraServer) -> None:
    for host in ("192.168.0.7:8471", "[::1]:8471", f"{socket.gethostname()}.local."):
        status, data = raw_request(server, "GET", "/describe", headers={"Host": host})
        assert (host, status) == (host, 200)
        assert json.loads(data) == {"program": "rhizotwin camera", "protocol": 2, "camera": "camera of the test"}
    assert raw_request(server, "GET", "/")[0] == 404
    assert raw_request(server, "GET", "/describe", headers={"Host": "evil.example"})[0] == 403


def test_serve_camera_says_where_and_gives_the_camera_back(monkeypatch: pytest.MonkeyPatch, camera: _NumberedCamera) -> None:
    monkeypatch.setattr(server_module, "local_camera", lambda *_, **__: camera)
    monkeypatch.setattr(CameraServer, "serve_forever", Mock(side_effect=KeyboardInterrupt))
    said: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        serve_camera(CameraPart(), image_wh=(32, 24), bits=12, host="0.0.0.0", port=0, say=said.append)
    assert re.fullmatch(rf"camera of the test; available at http://{re.escape(socket.gethostname())}:\d+; press Ctrl-C to stop", said[0])
    assert said[1:] == ["every computer on this network can take pictures with this camera"]
    assert camera.closed == 1
