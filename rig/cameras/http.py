"""HTTP client of a camera on another computer that runs `rhizotwin camera`."""

import hashlib
import http.client
import json
import math
import socket
import threading
import time
import uuid
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from email.message import Message
from typing import Any
from urllib.parse import urlsplit

from rhizotwin.rig.cameras import protocol
from rhizotwin.rig.cameras.settings import CameraSettings, check_picture
from rhizotwin.rig.clock import Clock
from rhizotwin.rig.devices import Shot
from rhizotwin.rig.errors import LostError, NoAnswerError, RigError
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.picture_codec import decode_grey
from rhizotwin.scenes.schema import to_plain

RETRIES = 3
PAUSE_S = 0.5
"""Pause before a request is repeated, s."""
ANSWER_S = 10.0
"""Maximum waiting time for a reply, in addition to the exposure time, s."""
OPENING_S = 30.0
"""Maximum waiting time until a camera is open, in addition to the duration of a few exposures, s."""
MAX_TEXT_BYTES = 65536
MOST_SAID = 500
"""Maximum length of a message from another computer that is shown to the user, in characters."""
TOLERANCE, TOLERANCE_S = 0.05, 1e-4
"""Tolerances for verifying the settings reported with a picture: relative tolerance of exposure time and gain, and
absolute tolerance of the exposure time, s. The driver on the server applies narrower tolerances."""


@dataclass(frozen=True, kw_only=True)
class _Answer:
    headers: Message
    data: bytes


class _DamagedError(Exception):
    """Raised if a reply is incomplete or damaged. The request can be repeated."""


class HttpCamera:
    """Client of a `rig.cameras.server.CameraServer`.

    A request is repeated with the same identifier until its reply is complete.
    """

    def __init__(self, address: str, settings: CameraSettings, *, clock: Clock) -> None:
        """Check the address. Nothing is sent before `prepare`.

        Raises
        ------
        RigError
            If the address is not of the form http://host:port.
        """
        self._host, self._port = _host_port(address)
        self._name = f"camera at {address.rstrip('/')}"
        self._settings = settings
        self._clock = clock
        self._session = ""
        self._said = "not open"

    def describe(self) -> str:
        """Return a description of the camera, as reported by the server."""
        return f"{self._said}, {self._name.removeprefix('camera ')}" if self._session else f"{self._name}, not open"

    def prepare(self) -> None:
        """Ask the server to open its camera with these settings, and verify them with a picture."""
        greeting = self._parse(self._ask("GET", "/describe", None, timeout_s=ANSWER_S).data)
        if greeting.get("program") != protocol.PROGRAM:
            raise self._foreign("JSON of another program")
        if greeting.get("protocol") != protocol.PROTOCOL:
            raise RigError(
                f"{self._name}: the reply is not from a rhizotwin camera of this version; start the same version of rhizotwin camera on "
                "that computer"
            )
        session = uuid.uuid4().hex
        body = {"session": session, "settings": to_plain(self._settings)}
        timeout_s = 5.0 * self._settings.exposure_s + OPENING_S
        self._said = plain_text(str(self._parse(self._ask("POST", "/prepare", body, timeout_s=timeout_s).data).get("camera")))
        self._session = session
        self.capture()

    def capture(self) -> Shot:
        """Take a picture whose exposure begins after this call."""
        if not self._session:
            raise RigError(f"{self._name}: the camera is not open; open it first")
        picture = uuid.uuid4().hex
        body = {"session": self._session, "picture": picture}
        timeout_s = self._settings.exposure_s + ANSWER_S
        return self._shot(self._ask("POST", "/capture", body, timeout_s=timeout_s, picture=picture))

    def close(self) -> None:
        """End the session of this client. The server keeps its camera open for the next client."""
        self._session = ""

    def _ask(self, method: str, path: str, body: Any, *, timeout_s: float, picture: str = "") -> _Answer:
        """Send a request, and repeat it until its reply is complete.

        If the reply reports an error, an exception is raised immediately.
        """
        reason = ""
        until_s = time.monotonic() + timeout_s  # one deadline for all attempts, because the lamps remain on
        attempts = 0
        while attempts <= RETRIES and time.monotonic() < until_s:
            if attempts:
                self._clock.sleep(PAUSE_S)
            attempts += 1
            try:
                return self._exchange(method, path, body, timeout_s=max(0.1, until_s - time.monotonic()), picture=picture)
            except (OSError, ValueError, http.client.HTTPException, _DamagedError) as error:
                reason = plain_text(str(error) or type(error).__name__)
        raise NoAnswerError(
            f"{self._name}: no complete reply after {attempts} attempt{'s' if attempts > 1 else ''} in {timeout_s:.3g} s ({reason}); "
            "check the network, and that rhizotwin camera runs on that computer with --host 0.0.0.0 or behind an ssh tunnel"
        )

    def _exchange(self, method: str, path: str, body: Any, *, timeout_s: float, picture: str) -> _Answer:
        connection = http.client.HTTPConnection(self._host, self._port, timeout=timeout_s)
        late = threading.Timer(timeout_s, _cut_off, [connection])
        late.daemon = True
        late.start()
        with ExitStack() as stack:
            stack.callback(connection.close)
            stack.callback(late.cancel)
            connection.connect()
            late.args = [connection.sock]  # the connection drops its reference when the reply begins
            headers = {"Content-Type": "application/json", "Connection": "close"}
            connection.request(method, path, body=None if body is None else json.dumps(body), headers=headers)
            try:
                response = stack.enter_context(connection.getresponse())
            except http.client.RemoteDisconnected:
                raise
            except http.client.BadStatusLine as error:
                raise self._foreign(f"not HTTP: {str(error)[:40]}") from error
            self._check_ours(response, picture)
            answer = _Answer(headers=response.headers, data=self._read(response, self._most_bytes() if picture else MAX_TEXT_BYTES))
        if response.status != http.client.OK:
            kind = LostError if response.status == http.client.CONFLICT else RigError
            sentence = self._parse(answer.data).get("error")
            if not isinstance(sentence, str):
                raise self._foreign(f"HTTP status {response.status}")
            raise kind(f"{self._name}: {plain_text(sentence)}")
        if picture:
            self._check_whole(answer, picture)
        return answer

    def _check_ours(self, response: http.client.HTTPResponse, picture: str) -> None:
        """Reject a web page, a snapshot or a video stream of another server, which is not worth another request."""
        kind = response.headers.get_content_type() if "Content-Type" in response.headers else None
        wanted = "image/png" if picture and response.status == http.client.OK else "application/json"
        if kind is not None and (kind != wanted or response.chunked):  # without it, the header may have been cut off
            raise self._foreign(kind if response.status == http.client.OK else f"{kind} with HTTP status {response.status}")

    def _foreign(self, what: str) -> RigError:
        return RigError(
            f"{self._name}: the reply is not from a rhizotwin camera ({plain_text(what)}); enter the address of a computer that runs "
            "rhizotwin camera, because snapshots and streams of other cameras do not state their exposure"
        )

    def _read(self, response: http.client.HTTPResponse, most: int) -> bytes:
        """Read the body of a reply, whose length is stated in its header.

        A length above the maximum ``most`` is an error.
        """
        announced = response.getheader("Content-Length", "")
        if not (announced.isascii() and announced.isdigit()):
            raise _DamagedError("the reply does not state its length")
        if len(announced) > 12 or int(announced) > most:
            length = announced if len(announced) <= 12 else f"{announced[:12]}..."
            raise RigError(
                f"{self._name}: the reply has {length} bytes, more than the maximum of {most}; start the same version of rhizotwin camera "
                "there"
            )
        data = response.read(int(announced))
        if len(data) != int(announced):
            raise _DamagedError(f"only {len(data)} of {announced} bytes were received")
        return data

    def _most_bytes(self) -> int:
        """Return the maximum size of a picture's PNG file, in bytes.

        It is the size of a picture that consists only of noise, which cannot be compressed. Each row has one additional
        byte, and the file has headers.
        """
        width, height = self._settings.image_wh
        return (2 * width + 1) * height * 101 // 100 + MAX_TEXT_BYTES

    def _check_whole(self, answer: _Answer, picture: str) -> None:
        if answer.headers.get(protocol.PICTURE) != picture:
            raise _DamagedError("the reply is for a different request")
        if answer.headers.get(protocol.SHA256) != hashlib.sha256(answer.data).hexdigest():
            raise _DamagedError("the picture was damaged during transmission")

    def _parse(self, data: bytes) -> dict[str, Any]:
        try:
            value = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise self._foreign("not JSON") from error
        if not isinstance(value, dict):
            raise self._foreign("not a JSON object")
        return value

    def _shot(self, answer: _Answer) -> Shot:
        try:
            image = decode_grey(answer.data, where=self._name)
        except UserError as error:
            raise RigError(f"{error}; start the same version of rhizotwin camera on that computer") from error
        check_picture(image, self._settings, name=self._name)
        exposure_s = self._number(answer, protocol.EXPOSURE_S)
        gain = self._number(answer, protocol.GAIN)
        wanted = self._settings
        if exposure_s is not None and abs(exposure_s - wanted.exposure_s) > max(TOLERANCE * wanted.exposure_s, TOLERANCE_S):
            raise RigError(
                f"{self._name}: the exposure was {1000 * exposure_s:g} ms instead of {1000 * wanted.exposure_s:g} ms; correct exposure_s "
                "in the rig file"
            )
        if gain is not None and abs(gain - wanted.gain) > max(TOLERANCE * wanted.gain, 0.5):
            raise RigError(f"{self._name}: the gain was {gain:g} instead of {wanted.gain:g}; correct the value of 'gain' in the rig file")
        return Shot(image=image, exposure_s=exposure_s, gain=gain)

    def _number(self, answer: _Answer, header: str) -> float | None:
        text = answer.headers.get(header)
        if text is None:
            return None
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise RigError(
                f"{self._name}: the header {header} is {text[:40]!r}, not a number; start the same version of rhizotwin camera on that "
                "computer"
            )
        return number


def plain_text(text: str) -> str:
    """Remove terminal control codes from another computer's text, and shorten it."""
    return "".join(letter if letter.isprintable() else " " for letter in text[:MOST_SAID])


def _cut_off(connection: http.client.HTTPConnection | socket.socket) -> None:
    """Shut down a connection at its deadline, so that a slow sender cannot block the reader."""
    if isinstance(connection, socket.socket):
        with suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)


def _host_port(address: str) -> tuple[str, int]:
    """Split an address of the form http://host:port into host and port."""
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port, parts = None, None, urlsplit("")
    if parts.scheme != "http" or not host or parts.path not in ("", "/") or parts.query or parts.fragment or "@" in parts.netloc:
        raise RigError(
            f"camera: address {address!r} is not of the form http://HOST:PORT; enter the address of the computer that runs rhizotwin camera"
        )
    return host, protocol.DEFAULT_PORT if port is None else port
