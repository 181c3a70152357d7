"""Serve a camera of this computer to another one, over HTTP (see `rig.cameras.protocol`).

Meant for a laboratory's own network: there are no passwords. Listens on this computer alone unless told otherwise. Web
pages that a browser shows on the same network cannot use it: requests must name this computer (no DNS rebinding) and
carry JSON (no forms of other sites).
"""

import ipaddress
import socket
import threading
from collections.abc import Callable
from contextlib import suppress

from rhizotwin.rig.cameras import local_camera, protocol
from rhizotwin.rig.cameras.requests import RequestServer
from rhizotwin.rig.cameras.service import CameraService
from rhizotwin.rig.cameras.settings import CameraSettings, settings_of
from rhizotwin.rig.devices import Camera
from rhizotwin.rig.errors import RigError
from rhizotwin.rig.rig_file import CameraPart

_EVERYWHERE = ("", "0.0.0.0", "::")


def serve_camera(
    part: CameraPart,
    *,
    image_wh: tuple[int, int],
    bits: int,
    host: str = "127.0.0.1",
    port: int = protocol.DEFAULT_PORT,
    say: Callable[[str], None],
) -> None:
    """Serve the camera of a rig file until stopped by an exception such as Ctrl-C's.

    The camera is given back on the way out.

    Parameters
    ----------
    part : CameraPart
        A camera on this computer. Whoever takes pictures brings size, depth, exposure, gain and white balance along.
    image_wh, bits : tuple of int, int
        What is used until then.
    host, port : str, int
        Where to listen; 0.0.0.0 is every network.
    say : callable
        Gets lines for the person at this computer.

    Raises
    ------
    RigError
        For a camera of kind http, no picamera2, or an address that cannot be listened on.
    """
    if part.kind == "http":
        raise RigError("camera: kind is http in this rig file, but a served camera must be at this computer; set kind to picamera2 or v4l2")
    camera = local_camera(part, settings_of(part, image_wh=image_wh, bits=bits))
    server = CameraServer(camera, host=host, port=port, reopen=lambda settings: local_camera(part, settings), say=say)
    try:
        say(f"{camera.describe()}; serving it at {server.url}, Ctrl-C stops")
        if not _is_loopback(host):
            say("everyone on this network can take pictures")
        server.serve_forever()
    finally:
        server.stop()


class CameraServer:
    """An HTTP server for one camera, which it takes over."""

    def __init__(
        self,
        camera: Camera,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        reopen: Callable[[CameraSettings], Camera] | None = None,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Listen; requests are answered from `start` or `serve_forever` on.

        Parameters
        ----------
        camera : Camera
            The camera, not open yet.
        host, port : str, int
            Where to listen; port 0 takes a free one.
        reopen : callable or None
            Makes the camera for the settings of a client; without it the camera keeps its own settings, and a client
            that wants others refuses the pictures.
        say : callable
            Gets a line when a client comes, and when something fails.

        Raises
        ------
        RigError
            When the address cannot be listened on.
        """
        self._service = CameraService(camera, reopen=reopen)
        try:
            self._server = RequestServer(host, port, self._service, say)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise RigError(f"camera server: cannot listen on {host} port {port} ({reason}); choose another --host or --port") from error
        self._host = host
        self._thread: threading.Thread | None = None

    @property
    def url(self) -> str:
        """The address for the rig file of the other computer."""
        host = socket.gethostname() if self._host in _EVERYWHERE else self._host
        return f"http://{f'[{host}]' if ':' in host else host}:{self._server.server_address[1]}"

    def start(self) -> None:
        """Answer requests in the background."""
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), name="camera server", daemon=True)
        self._thread.start()

    def serve_forever(self) -> None:
        """Answer requests until an exception such as Ctrl-C's; call `stop` then."""
        self._server.serve_forever()

    def stop(self) -> None:
        """Stop listening and give the camera back; again does no harm."""
        if self._thread is not None:
            self._server.shutdown()
            self._thread.join()
            self._thread = None
        self._server.server_close()
        self._service.close()


def _is_loopback(host: str) -> bool:
    with suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return host == "localhost"
