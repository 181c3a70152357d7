"""Client and server over a real connection on this computer, with a proxy between them that loses, cuts, damages and doubles answers."""

import http.client
import json
import re
import socket
import socketserver
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from rig.cameras import open_camera
from rig.cameras import server as server_module
from rig.cameras.http import PAUSE_S, RETRIES, HttpCamera
from rig.cameras.protocol import PICTURE, SHA256
from rig.cameras.server import CameraServer, serve_camera
from rig.cameras.service import KEPT, CameraService
from rig.cameras.settings import CameraSettings
from rig.devices import Shot
from rig.errors import LostError, NoAnswerError, RigError
from rig.rig_file import CameraPart

SETTINGS = CameraSettings(image_wh=(32, 24), bits=12, exposure_s=0.01, gain=2.0)
A, B = "a" * 32, "b" * 32


@dataclass
class _Clock:
    slept: list[float] = field(default_factory=list)

    def now_s(self) -> float:
        return sum(self.slept)

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)


@dataclass
class _FakeCamera:
    """A camera whose pictures are numbered: each pixel is the number of the picture, four bits up."""

    taken: int = 0
    prepared: int = 0
    closed: int = 0
    dtype: type = np.uint16
    shape: tuple[int, int] = (24, 32)
    exposure_s: float | None = 0.01
    gain: float | None = 2.0
    fail: str = ""
    began: threading.Event = field(default_factory=threading.Event)
    may_end: threading.Event = field(default_factory=threading.Event)

    def __post_init__(self) -> None:
        self.may_end.set()

    def describe(self) -> str:
        return "camera of the test"

    def prepare(self) -> None:
        self._fail()
        self.prepared += 1

    def capture(self) -> Shot:
        self.began.set()
        assert self.may_end.wait(5.0)
        self._fail()
        self.taken += 1
        noise = np.random.default_rng(self.taken).integers(0, 16, self.shape)
        image = (noise * 256 + self.taken).astype(self.dtype) << (4 if self.dtype is np.uint16 else 0)
        return Shot(image=image, exposure_s=self.exposure_s, gain=self.gain)

    def close(self) -> None:
        self.closed += 1

    def _fail(self) -> None:
        if self.fail:
            raise RigError(self.fail)


def number_of(shot: Shot) -> int:
    return int(shot.image[0, 0] >> (4 if shot.image.dtype == np.uint16 else 0)) & 0xFF


@pytest.fixture
def camera() -> _FakeCamera:
    return _FakeCamera()


@pytest.fixture
def server(camera: _FakeCamera) -> Iterator[CameraServer]:
    found = CameraServer(camera)
    found.start()
    yield found
    found.stop()


def client(server: CameraServer, settings: CameraSettings = SETTINGS) -> HttpCamera:
    found = HttpCamera(server.url, settings, clock=_Clock())
    found.prepare()
    return found


Mangle = Callable[[bytes, int], bytes | None]


@contextmanager
def proxy(server: CameraServer, mangle: Mangle, *, repeats: int = 1) -> Iterator[str]:
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
            answer = b""
            for _ in range(repeats):
                with socket.create_connection((target.hostname, target.port), timeout=5.0) as upstream:
                    upstream.sendall(head + body)
                    with upstream.makefile("rb") as stream:
                        answer = stream.read()
            if b"/capture" in head:
                counted += 1
                mangled = mangle(answer, counted)
                if mangled is None:
                    return
                answer = mangled
            self.wfile.write(answer)

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), _Handler) as listening:
        listening.daemon_threads = True
        thread = threading.Thread(target=listening.serve_forever, args=(0.02,))
        thread.start()
        try:
            yield f"http://127.0.0.1:{listening.server_address[1]}"
        finally:
            listening.shutdown()
            thread.join()


@pytest.mark.parametrize(("dtype", "bits"), [(np.uint16, 12), (np.uint16, 16), (np.uint8, 8)])
def test_pictures_arrive_as_they_were_taken(server: CameraServer, camera: _FakeCamera, dtype: type, bits: int) -> None:
    camera.dtype = dtype
    remote = client(server, CameraSettings(image_wh=(32, 24), bits=bits, gain=2.0))
    shot = remote.capture()
    camera.taken = 1
    same = camera.capture()
    assert shot.image.dtype == dtype
    assert np.array_equal(shot.image, same.image)
    assert (shot.exposure_s, shot.gain) == (0.01, 2.0)


def test_each_capture_is_a_new_picture(server: CameraServer, camera: _FakeCamera) -> None:
    remote = client(server)
    assert [number_of(remote.capture()) for _ in range(3)] == [2, 3, 4]  # the first proved the settings
    assert (camera.prepared, camera.taken) == (1, 4)


def test_what_a_camera_does_not_report(server: CameraServer, camera: _FakeCamera) -> None:
    camera.exposure_s = camera.gain = None
    shot = client(server).capture()
    assert (shot.exposure_s, shot.gain) == (None, None)


def test_describe(server: CameraServer) -> None:
    remote = HttpCamera(server.url, SETTINGS, clock=_Clock())
    assert remote.describe() == f"camera at {server.url}, not open"
    remote.prepare()
    assert remote.describe() == f"camera of the test, at {server.url}"
    remote.close()
    assert remote.describe() == f"camera at {server.url}, not open"
    with pytest.raises(RigError, match="not open; prepare it first"):
        remote.capture()


@dataclass(frozen=True)
class Fault:
    """What happens to the answer of a capture."""

    name: str
    mangle: Callable[[bytes], bytes | None]
    said: str


def flipped(answer: bytes) -> bytes:
    at = answer.index(b"\r\n\r\n") + 104
    return answer[:at] + bytes([answer[at] ^ 1]) + answer[at + 1 :]


FAULTS = [
    Fault("lost", lambda _: None, "closed connection without response"),
    Fault("cut in its header", lambda answer: answer[:20], "RemoteDisconnected|no whole answer"),
    Fault("cut in the picture", lambda answer: answer[:-7], "of [0-9]+ bytes arrived"),
    Fault("damaged", flipped, "the picture was damaged on its way"),
    Fault("of another", lambda answer: re.sub(rb"(?<=Picture: ).{32}", A.encode(), answer), "the answer to another request"),
    Fault("no HTTP", lambda _: b"\x00\xff hello\r\n\r\n", "no whole answer"),
    Fault("without length", lambda answer: answer.replace(b"Content-Length", b"X"), "without its length"),
]


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_an_answer_that_does_not_arrive_costs_no_picture(server: CameraServer, camera: _FakeCamera, fault: Fault) -> None:
    clock = _Clock()
    bad = set(range(2, 2 + RETRIES))  # the first capture proves the settings; of the second, only the last attempt arrives
    with proxy(server, lambda answer, k: fault.mangle(answer) if k in bad else answer) as url:
        remote = HttpCamera(url, SETTINGS, clock=clock)
        remote.prepare()
        assert number_of(remote.capture()) == 2
        assert number_of(remote.capture()) == 3
    assert camera.taken == 3
    assert clock.slept == [PAUSE_S] * RETRIES


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_answers_that_never_arrive_end_in_a_sentence(server: CameraServer, camera: _FakeCamera, fault: Fault) -> None:
    clock = _Clock()
    with proxy(server, lambda answer, _: fault.mangle(answer)) as url:
        remote = HttpCamera(url, SETTINGS, clock=clock)
        with pytest.raises(NoAnswerError, match=fault.said) as caught:
            remote.prepare()
    assert f"camera at {url}: no whole answer after 4 attempts" in str(caught.value)
    assert camera.taken == 1
    assert clock.slept == [PAUSE_S] * RETRIES


def test_requests_that_arrive_twice(server: CameraServer, camera: _FakeCamera) -> None:
    with proxy(server, lambda answer, _: answer, repeats=2) as url:
        remote = HttpCamera(url, SETTINGS, clock=_Clock())
        remote.prepare()
        assert [number_of(remote.capture()) for _ in range(2)] == [2, 3]
    assert (camera.prepared, camera.taken) == (1, 3)


def test_a_server_that_stops(server: CameraServer, camera: _FakeCamera) -> None:
    remote = client(server)
    server.stop()
    server.stop()
    assert camera.closed >= 1
    with pytest.raises(
        NoAnswerError, match=r"no whole answer after 4 attempts .*refused.*; check the network, and that rhizotwin camera runs"
    ):
        remote.capture()


def test_a_server_that_was_started_again(camera: _FakeCamera) -> None:
    first = CameraServer(camera)
    first.start()
    remote = client(first)
    port = urlsplit(first.url).port or 0
    first.stop()
    second = CameraServer(camera, port=port)
    second.start()
    try:
        with pytest.raises(LostError, match="the camera server was started again"):
            remote.capture()
        remote.prepare()
        assert number_of(remote.capture()) == 3
    finally:
        second.stop()


def test_another_computer_takes_the_camera(server: CameraServer) -> None:
    first = client(server)
    second = client(server)
    with pytest.raises(LostError, match="another computer took its camera"):
        first.capture()
    second.capture()


def test_a_camera_that_fails_is_told_at_once(server: CameraServer, camera: _FakeCamera) -> None:
    remote = client(server)
    camera.fail = "camera 0: gives no frames any more; check its cable"
    with pytest.raises(RigError, match=f"camera at {server.url}: camera 0: gives no frames any more; check its cable"):
        remote.capture()
    camera.fail = ""
    assert number_of(remote.capture()) == 2


def test_a_camera_that_cannot_be_prepared(server: CameraServer, camera: _FakeCamera) -> None:
    camera.fail = "camera 0: cannot be opened"
    remote = HttpCamera(server.url, SETTINGS, clock=_Clock())
    with pytest.raises(RigError, match="camera 0: cannot be opened"):
        remote.prepare()
    with pytest.raises(RigError, match="not open"):
        remote.capture()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"shape": (12, 32)}, "gives pictures of 32x12 pixels, not 32x24"),
        ({"dtype": np.uint8}, "gives pictures of 8 bits, though 12 were asked for"),
        ({"exposure_s": 0.02}, "exposed 20 ms instead of 10 ms"),
        ({"gain": 4.0}, "gain 4 instead of 2"),
        ({"exposure_s": float("nan")}, "Rhizotwin-Exposure-S 'nan', which is no number"),
    ],
)
def test_pictures_with_other_settings_are_refused(server: CameraServer, camera: _FakeCamera, change: dict[str, Any], said: str) -> None:
    for name, value in change.items():
        setattr(camera, name, value)
    with pytest.raises(RigError, match=said):
        client(server)


def test_an_answer_too_long_to_be_a_picture(server: CameraServer, camera: _FakeCamera) -> None:
    camera.shape = (600, 800)
    camera.dtype = np.uint16
    with pytest.raises(RigError, match=r"announces an answer of [0-9]+ bytes, at most [0-9]+ can be right"):
        client(server)


def test_the_clients_settings_open_the_camera(camera: _FakeCamera) -> None:
    made: list[CameraSettings] = []
    said: list[str] = []

    def reopen(settings: CameraSettings) -> _FakeCamera:
        made.append(settings)
        return camera

    old = _FakeCamera()
    server = CameraServer(old, reopen=reopen, say=said.append)
    server.start()
    try:
        part = CameraPart(kind="http", address=server.url, exposure_s=0.01, gain=2.0, colour_gains=(3.0, 1.5), white_balance_kelvin=4000)
        open_camera(part, image_wh=(32, 24), bits=12, clock=_Clock()).prepare()
    finally:
        server.stop()
    assert made == [
        CameraSettings(image_wh=(32, 24), bits=12, exposure_s=0.01, gain=2.0, colour_gains=(3.0, 1.5), white_balance_kelvin=4000)
    ]
    assert (old.prepared, old.closed, camera.prepared, camera.closed) == (0, 1, 1, 1)
    assert said == ["for 127.0.0.1: camera of the test"]


def test_two_requests_for_one_picture_at_once(camera: _FakeCamera) -> None:
    service = CameraService(camera)
    service.prepare(A, SETTINGS)
    camera.may_end.clear()
    found: list[str] = []
    threads = [threading.Thread(target=lambda: found.append(service.capture(A, B).sha256)) for _ in range(2)]
    for thread in threads:
        thread.start()
    assert camera.began.wait(5.0)
    camera.may_end.set()
    for thread in threads:
        thread.join(5.0)
    assert camera.taken == 1
    assert len(found) == 2
    assert found[0] == found[1]


def test_pictures_kept_are_bounded(camera: _FakeCamera) -> None:
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
) -> tuple[int, http.client.HTTPMessage, bytes]:
    target = urlsplit(server.url)
    connection = http.client.HTTPConnection(target.hostname or "", target.port, timeout=5.0)
    try:
        connection.putrequest(method, path, skip_host="Host" in (headers or {}))
        for key, value in ({"Content-Type": "application/json", "Content-Length": str(len(body))} | (headers or {})).items():
            if value:
                connection.putheader(key, value)
        connection.endheaders(body)
        response = connection.getresponse()
        return response.status, response.headers, response.read()
    finally:
        connection.close()


PREPARE = json.dumps({"session": A, "settings": {"image_wh": [32, 24]}}).encode()


@dataclass(frozen=True)
class Refused:
    """A request that must not reach the camera."""

    name: str
    status: int
    said: str
    path: str = "/prepare"
    body: bytes = PREPARE
    headers: dict[str, str] = field(default_factory=dict)


REFUSED = [
    Refused("name of another site", 403, "not called 'evil.example'", headers={"Host": "evil.example:8471"}),
    Refused("name that ends like ours", 403, "not called", headers={"Host": f"{socket.gethostname()}.evil.example"}),
    Refused("address as part of a name", 403, "not called", headers={"Host": "127.0.0.1.evil.example"}),
    Refused("broken host", 403, "not called", headers={"Host": "[::1"}),
    Refused("form of another site", 415, "application/json", headers={"Content-Type": "text/plain"}),
    Refused("no length", 411, "length", headers={"Content-Length": ""}, body=b""),
    Refused("too long", 413, "4096 bytes", body=b" " * 5000 + PREPARE),
    Refused("no JSON", 400, "no JSON", body=b"{"),
    Refused("nested too deeply", 400, "no JSON|must be a table", body=b"[" * 4000),
    Refused("list", 400, "must be a table", body=b"[]"),
    Refused("unknown key", 400, "unknown key", body=PREPARE.replace(b"image_wh", b"image_hw")),
    Refused("no session", 400, "session: is missing", body=b'{"settings": {}}'),
    Refused("strange session", 400, "32 hexadecimal digits", body=PREPARE.replace(b"aa", b"../")),
    Refused("exposure for ever", 400, "must be between", body=PREPARE.replace(b'"image_wh": [32, 24]', b'"exposure_s": 1e9')),
    Refused("no such page", 404, "only /describe", path="/../etc/passwd"),
    Refused("not prepared", 409, "started again", path="/capture", body=json.dumps({"session": A, "picture": B}).encode()),
    Refused("strange picture", 400, "hexadecimal", path="/capture", body=json.dumps({"session": A, "picture": "1"}).encode()),
]


@pytest.mark.parametrize("case", REFUSED, ids=lambda case: case.name)
def test_refused(server: CameraServer, camera: _FakeCamera, case: Refused) -> None:
    status, _, data = raw_request(server, "POST", case.path, headers=case.headers, body=case.body)
    assert status == case.status
    assert re.search(case.said, json.loads(data)["error"])
    assert (camera.prepared, camera.taken) == (0, 0)


@pytest.mark.parametrize(
    "host", ["localhost:8471", "192.168.0.7:8471", "[::1]:8471", socket.gethostname(), f"{socket.gethostname()}.local."]
)
def test_own_names(server: CameraServer, host: str) -> None:
    status, _, data = raw_request(server, "GET", "/describe", headers={"Host": host})
    assert status == 200
    assert json.loads(data) == {"program": "rhizotwin camera", "protocol": 1, "camera": "camera of the test"}


def test_get_of_something_else(server: CameraServer) -> None:
    assert raw_request(server, "GET", "/")[0] == 404
    assert raw_request(server, "GET", "/describe", headers={"Host": "evil.example"})[0] == 403


def test_the_same_request_gives_the_same_bytes(server: CameraServer, camera: _FakeCamera) -> None:
    raw_request(server, "POST", "/prepare", body=PREPARE)
    body = json.dumps({"session": A, "picture": B}).encode()
    first, second = (raw_request(server, "POST", "/capture", body=body) for _ in range(2))
    assert first[0] == 200
    assert first[2] == second[2]
    assert first[1][SHA256] == second[1][SHA256]
    assert first[1][PICTURE] == B
    assert camera.taken == 1


def test_something_else_answers() -> None:
    class _Other(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            while self.rfile.readline().strip():
                pass
            self.wfile.write(b"HTTP/1.0 200 OK\r\nContent-Length: 17\r\n\r\n" + b'{"program": "no"}')

    with socketserver.TCPServer(("127.0.0.1", 0), _Other) as other:
        thread = threading.Thread(target=other.handle_request)
        thread.start()
        remote = HttpCamera(f"http://127.0.0.1:{other.server_address[1]}", SETTINGS, clock=_Clock())
        with pytest.raises(RigError, match="what answers is no rhizotwin camera of this version"):
            remote.prepare()
        thread.join()


def test_waiting_has_an_end_that_grows_with_the_exposure(
    server: CameraServer, camera: _FakeCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera.exposure_s = 7.0
    remote = client(server, CameraSettings(image_wh=(32, 24), exposure_s=7.0, gain=2.0))
    waited: list[float] = []

    class _Deaf(http.client.HTTPConnection):
        def getresponse(self) -> http.client.HTTPResponse:
            waited.append(float(self.timeout or 0.0))
            raise TimeoutError("timed out")

    monkeypatch.setattr(http.client, "HTTPConnection", _Deaf)
    with pytest.raises(NoAnswerError, match="timed out"):
        remote.capture()
    assert waited == [17.0] * (1 + RETRIES)


@pytest.mark.parametrize(
    "address", ["0", "", "raspberrypi:8471", "https://pi:8471", "http://", "http://pi:99999", "http://a@pi", "http://pi/x", "http://[::1"]
)
def test_no_address(address: str) -> None:
    with pytest.raises(RigError, match="is no http://HOST:PORT"):
        HttpCamera(address, SETTINGS, clock=_Clock())


def test_a_port_that_is_taken(server: CameraServer, camera: _FakeCamera) -> None:
    port = urlsplit(server.url).port or 0
    with pytest.raises(RigError, match=rf"cannot listen on 127.0.0.1 port {port} \(.*in use\); choose another"):
        CameraServer(camera, port=port)


def test_serve_camera_says_where_and_gives_the_camera_back(monkeypatch: pytest.MonkeyPatch, camera: _FakeCamera) -> None:
    def interrupted(_: CameraServer) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(server_module, "local_camera", lambda *_: camera)
    monkeypatch.setattr(CameraServer, "serve_forever", interrupted)
    said: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        serve_camera(CameraPart(), image_wh=(32, 24), bits=12, host="0.0.0.0", port=0, say=said.append)
    assert re.fullmatch(rf"camera of the test; serving it at http://{re.escape(socket.gethostname())}:\d+, Ctrl-C stops", said[0])
    assert said[1:] == ["everyone on this network can take pictures"]
    assert camera.closed == 1


def test_serve_camera_is_for_a_camera_of_this_computer() -> None:
    with pytest.raises(RigError, match="set kind to picamera2 or v4l2"):
        serve_camera(CameraPart(kind="http", address="http://pi:8471"), image_wh=(32, 24), bits=12, say=lambda _: None)
