"""The server of a camera: what it refuses, keeps and repeats."""

import http.client
import json
import re
import socket
import threading
from contextlib import closing
from dataclasses import dataclass, field
from urllib.parse import urlsplit

import pytest

from rhizotwin.rig.cameras import server as server_module
from rhizotwin.rig.cameras.server import CameraServer, serve_camera
from rhizotwin.rig.cameras.service import KEPT, CameraService
from rhizotwin.rig.errors import LostError, RigError
from rhizotwin.rig.rig_file import CameraPart
from tests.rig.cameras.http_camera.numbered import SETTINGS, A, B, NumberedCamera, client


def test_one_computer_has_the_camera_and_one_program_the_port(server: CameraServer, camera: NumberedCamera) -> None:
    first, second = client(server), client(server)
    with pytest.raises(LostError, match="another computer has taken over the camera"):
        first.capture()
    second.capture()
    port = urlsplit(server.url).port or 0
    with pytest.raises(RigError, match=rf"cannot listen on 127.0.0.1 port {port} \(.*in use\); choose another"):
        CameraServer(camera, port=port)
    with pytest.raises(RigError, match=r"cannot listen on raspberry\.\.pi port 0"):
        CameraServer(camera, host="raspberry..pi")


def test_two_requests_for_one_picture_at_once(camera: NumberedCamera) -> None:
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
    assert (camera.taken, len(found), len(set(found))) == (1, 2, 1)


def test_pictures_kept_are_bounded(camera: NumberedCamera) -> None:
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
CAPTURE = json.dumps({"session": A, "picture": B}).encode()


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
    Refused("name of another site", 403, "'evil.example' is not a name of this computer", headers={"Host": "evil.example:8471"}),
    Refused("name that ends like ours", 403, "not a name of this computer", headers={"Host": f"{socket.gethostname()}.evil.example"}),
    Refused("broken host", 403, "not a name of this computer", headers={"Host": "[::1"}),
    Refused("form of another site", 415, "application/json", headers={"Content-Type": "text/plain"}),
    Refused("no length", 411, "Content-Length", headers={"Content-Length": ""}, body=b""),
    Refused("too long", 413, "4096 bytes", body=b" " * 5000 + PREPARE),
    Refused("no JSON", 400, "not JSON", body=b"{"),
    Refused("nested too deeply", 400, "not JSON|must be a table", body=b"[" * 4000),
    Refused("unknown key", 400, "unknown key", body=PREPARE.replace(b"image_wh", b"image_hw")),
    Refused("strange session", 400, "32 hexadecimal digits", body=PREPARE.replace(b"aa", b"../")),
    Refused("exposure for ever", 400, "must be between", body=PREPARE.replace(b'"image_wh": [32, 24]', b'"exposure_s": 1e9')),
    Refused("no such page", 404, "available paths are /describe", path="/../etc/passwd"),
    Refused("not prepared", 409, "restarted", path="/capture", body=CAPTURE),
]


@pytest.mark.parametrize("case", REFUSED, ids=lambda case: case.name)
def test_refused(server: CameraServer, camera: NumberedCamera, case: Refused) -> None:
    status, data = raw_request(server, "POST", case.path, headers=case.headers, body=case.body)
    assert status == case.status
    assert re.search(case.said, json.loads(data)["error"])
    assert (camera.prepared, camera.taken) == (0, 0)


def test_own_names_and_no_other_pages(server: CameraServer) -> None:
    for host in ("192.168.0.7:8471", "[::1]:8471", f"{socket.gethostname()}.local."):
        status, data = raw_request(server, "GET", "/describe", headers={"Host": host})
        assert (host, status) == (host, 200)
        assert json.loads(data) == {"program": "rhizotwin camera", "protocol": 1, "camera": "camera of the test"}
    assert raw_request(server, "GET", "/")[0] == 404
    assert raw_request(server, "GET", "/describe", headers={"Host": "evil.example"})[0] == 403


def test_serve_camera_says_where_and_gives_the_camera_back(monkeypatch: pytest.MonkeyPatch, camera: NumberedCamera) -> None:
    def interrupted(_: CameraServer) -> None:
        raise KeyboardInterrupt

    remote = CameraPart(kind="http", address="http://pi:8471")
    with pytest.raises(RigError, match="set kind to picamera2 or v4l2"):
        serve_camera(remote, image_wh=(32, 24), bits=12, say=lambda _: None)
    monkeypatch.setattr(server_module, "local_camera", lambda *_: camera)
    monkeypatch.setattr(CameraServer, "serve_forever", interrupted)
    said: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        serve_camera(CameraPart(), image_wh=(32, 24), bits=12, host="0.0.0.0", port=0, say=said.append)
    assert re.fullmatch(rf"camera of the test; available at http://{re.escape(socket.gethostname())}:\d+; press Ctrl-C to stop", said[0])
    assert said[1:] == ["every computer on this network can take pictures with this camera"]
    assert camera.closed == 1
