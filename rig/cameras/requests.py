"""Request handling and input checks of the camera server (protocol: `rig.cameras.protocol`)."""

import ipaddress
import json
import socket
import socketserver
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

from rhizotwin.rig.cameras import protocol
from rhizotwin.rig.cameras.service import CameraService
from rhizotwin.rig.cameras.settings import CameraSettings
from rhizotwin.rig.errors import LostError, RigError
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.schema import Place, from_plain

MAX_BODY_BYTES = 4096
IDLE_S = 30.0
"""Time, in seconds, after which a connection is closed if no data are transmitted, or if the request is not
complete."""
MOST_CONNECTIONS = 16
"""Maximum number of open connections. A scan uses one connection."""


@dataclass(frozen=True, kw_only=True)
class _Prepare:
    """Body of the request /prepare."""

    session: str
    settings: CameraSettings


@dataclass(frozen=True, kw_only=True)
class _Capture:
    """Body of a ``/capture`` request."""

    session: str
    picture: str


class _Refusal(Exception):  # noqa: N818 - an answer, not an error of the program
    def __init__(self, status: HTTPStatus, sentence: str) -> None:
        super().__init__(sentence)
        self.status = status


class RequestServer(ThreadingHTTPServer):
    """HTTP server that handles each request in a separate thread."""

    daemon_threads = True

    def __init__(self, host: str, port: int, service: CameraService, say: Callable[[str], None]) -> None:
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self.service = service
        self.say = say
        own = socket.gethostname().lower()
        self.names = {"localhost", own, f"{own}.local", host.lower()} - {""}
        """Host names of this computer, in lower case."""
        self._free = threading.BoundedSemaphore(MOST_CONNECTIONS)
        super().__init__((host, port), _Handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Handle a request in a separate thread. If too many connections are open, close the connection instead."""
        if not self._free.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Handle a request. Afterwards, another connection can be accepted in its place."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def server_bind(self) -> None:
        """Bind to the address without looking up the name of this computer, which can take a long time."""
        socketserver.TCPServer.server_bind(self)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Report errors other than a client's disconnection, because they are bugs."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    server: RequestServer
    server_version = "rhizotwin"
    sys_version = ""
    timeout = IDLE_S

    def setup(self) -> None:
        """Set a deadline for the request, so that a slow sender cannot block a connection forever."""
        super().setup()
        self._late = threading.Timer(IDLE_S, self._cut_off)
        self._late.daemon = True
        self._late.start()

    def finish(self) -> None:
        """Cancel the deadline of the request, and release the connection."""
        self._late.cancel()
        super().finish()

    def _cut_off(self) -> None:
        with suppress(OSError):
            self.connection.shutdown(socket.SHUT_RDWR)

    def do_GET(self) -> None:
        """Handle the request /describe."""
        self._answer(self._get)

    def do_POST(self) -> None:
        """Handle the requests /prepare and /capture."""
        self._answer(self._post)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the base class's name
        """Suppress the default log output. Relevant lines are passed to ``say`` instead."""

    def _answer(self, act: Callable[[], None]) -> None:
        try:
            act()
        except _Refusal as refusal:
            self._send_json(refusal.status, {"error": str(refusal)})
        except LostError as error:
            self._send_json(HTTPStatus.CONFLICT, {"error": str(error)})
        except RigError as error:
            self.server.say(str(error))
            self._send_json(HTTPStatus.SERVICE_UNAVAILABLE, {"error": str(error)})

    def _get(self) -> None:
        self._late.cancel()
        self._check_host()
        if self.path != "/describe":
            raise _Refusal(
                HTTPStatus.NOT_FOUND,
                "this is a rhizotwin camera server; enter its address in the rig file of the computer that controls the scan",
            )
        said = self.server.service.describe()
        self._send_json(HTTPStatus.OK, {"program": protocol.PROGRAM, "protocol": protocol.PROTOCOL, "camera": said})

    def _post(self) -> None:
        body = self._body()
        self._late.cancel()
        self._check_host()
        if self.path == "/prepare":
            wanted = self._parse(body, _Prepare)
            _check_name(wanted.session)
            said = self.server.service.prepare(wanted.session, wanted.settings)
            self.server.say(f"for {self.client_address[0]}: {said}")
            self._send_json(HTTPStatus.OK, {"camera": said})
        elif self.path == "/capture":
            asked = self._parse(body, _Capture)
            _check_name(asked.session)
            _check_name(asked.picture)
            self._send_picture(asked)
        else:
            raise _Refusal(HTTPStatus.NOT_FOUND, "available paths are /describe, /prepare and /capture")

    def _send_picture(self, asked: _Capture) -> None:
        picture = self.server.service.capture(asked.session, asked.picture)
        headers = {"Content-Type": "image/png", protocol.PICTURE: asked.picture, protocol.SHA256: picture.sha256}
        if picture.exposure_s is not None:
            headers[protocol.EXPOSURE_S] = repr(float(picture.exposure_s))
        if picture.gain is not None:
            headers[protocol.GAIN] = repr(float(picture.gain))
        self._send(HTTPStatus.OK, headers, picture.png)

    def _body(self) -> bytes:
        """Read the body of a request, even if the request will be rejected.

        If the connection were closed before the body is read, the client might not receive the reply.
        """
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit()):
            raise _Refusal(HTTPStatus.LENGTH_REQUIRED, "a request must have a Content-Length header")
        body = self.rfile.read(min(int(length[:9]), 16 * MAX_BODY_BYTES))
        if len(length) > 9 or int(length) > MAX_BODY_BYTES:
            raise _Refusal(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a request must not exceed {MAX_BODY_BYTES} bytes")
        return body

    def _parse(self, body: bytes, kind: type[Any]) -> Any:
        """Parse the JSON body of a request as an instance of ``kind``, and validate it."""
        if self.headers.get_content_type() != "application/json":
            raise _Refusal(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "a request must have the content type application/json")
        try:
            return from_plain(kind, json.loads(body), Place("request"))
        except (ValueError, RecursionError) as error:
            raise _Refusal(HTTPStatus.BAD_REQUEST, "the request is not JSON") from error
        except UserError as error:
            raise _Refusal(HTTPStatus.BAD_REQUEST, str(error)) from error

    def _check_host(self) -> None:
        """Reject requests that are addressed to the name of another computer.

        A web page can cause a browser to send such requests by manipulated name resolution (DNS rebinding). IP
        addresses are accepted.
        """
        try:
            name = (urlsplit(f"//{self.headers.get('Host', '')}").hostname or "").rstrip(".").lower()
        except ValueError:
            name = ""
        if name in self.server.names:
            return
        with suppress(ValueError):
            ipaddress.ip_address(name)
            return
        raise _Refusal(
            HTTPStatus.FORBIDDEN,
            f"{name[:80]!r} is not a name of this computer; enter its IP address or its name {socket.gethostname()} in the rig file",
        )

    def _send_json(self, status: HTTPStatus, value: dict[str, Any]) -> None:
        self._send(status, {"Content-Type": "application/json"}, json.dumps(value).encode())

    def _send(self, status: HTTPStatus, headers: dict[str, str], data: bytes) -> None:
        self.send_response(status)
        for key, value in headers.items():
            self.send_header(key, value)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)


def _check_name(name: str) -> None:
    if protocol.NAME.fullmatch(name) is None:
        raise _Refusal(HTTPStatus.BAD_REQUEST, "identifiers of sessions and pictures must be 32 hexadecimal digits")
