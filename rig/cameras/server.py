"""HTTP server for a camera of this computer (protocol: `rig.cameras.protocol`).

The server is intended for a laboratory's own network and has no passwords. By default it accepts connections from this
computer only. Web pages in a browser on the same network cannot use it, because requests must address this computer by
name (which prevents DNS rebinding) and contain JSON (which excludes forms of other sites).
"""

import ipaddress
import socket
import threading
from collections.abc import Callable
from contextlib import suppress

from rhizotwin.rig.cameras import local_camera, protocol
from rhizotwin.rig.cameras.requests import RequestServer
from rhizotwin.rig.cameras.service import CameraService
from rhizotwin.rig.cameras.settings import CameraSettings, combine_settings
from rhizotwin.rig.clock import SystemClock
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
    """Serve the camera of a rig file until an exception such as KeyboardInterrupt occurs.

    The camera is released at the end.

    Parameters
    ----------
    part : CameraPart
        Section of the rig file for a camera on this computer. Size, bit depth, exposure, gain and white balance are set
        by the client.
    image_wh, bits : tuple of int, int
        Size and bit depth of the pictures until a client sets them.
    host, port : str, int
        Address to listen on; 0.0.0.0 listens on all networks.
    say : callable
        Function that receives messages for the user of this computer.

    Raises
    ------
    RigError
        If the camera is of kind http, picamera2 is missing, or the address is not available.
    """
    if part.kind == "http":
        raise RigError(
            "camera: kind is http in this rig file, but the served camera must be connected to this computer; set kind to picamera2, v4l2 "
            "or gphoto2"
        )
    if part.trigger == "board":
        raise RigError(
            "camera: trigger is board in this rig file, but a served camera must be released by its computer; set trigger to usb"
        )
    clock = SystemClock()
    camera = local_camera(part, combine_settings(part, image_wh=image_wh, bits=bits), clock=clock)
    server = CameraServer(camera, host=host, port=port, reopen=lambda settings: local_camera(part, settings, clock=clock), say=say)
    try:
        say(f"{camera.describe()}; available at {server.url}; press Ctrl-C to stop")
        if not _is_loopback(host):
            say("every computer on this network can take pictures with this camera")
        server.serve_forever()
    finally:
        server.stop()


class CameraServer:
    """HTTP server for one camera, which it controls exclusively."""

    def __init__(
        self,
        camera: Camera,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        reopen: Callable[[CameraSettings], Camera] | None = None,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Listen for connections. Requests are handled only after `start` or `serve_forever`.

        Parameters
        ----------
        camera : Camera
            Camera to serve, not yet open.
        host, port : str, int
            Address to listen on; port 0 selects a free port.
        reopen : callable or None
            Function that creates the camera for a client's settings. Without it the camera keeps its own settings, and
            clients with other settings reject the pictures.
        say : callable
            Function that receives a message when a client connects, and for errors.

        Raises
        ------
        RigError
            If the address is not available.
        """
        self._service = CameraService(camera, reopen=reopen)
        try:
            self._server = RequestServer(host, port, self._service, say)
        except (OSError, OverflowError, UnicodeError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise RigError(f"camera server: cannot listen on {host} port {port} ({reason}); choose another --host or --port") from error
        self._host = host
        self._thread: threading.Thread | None = None

    @property
    def url(self) -> str:
        """Address to be entered in the rig file of the other computer."""
        host = socket.gethostname() if self._host in _EVERYWHERE else self._host
        return f"http://{f'[{host}]' if ':' in host else host}:{self._server.server_address[1]}"

    def start(self) -> None:
        """Handle requests in a background thread."""
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), name="camera server", daemon=True)
        self._thread.start()

    def serve_forever(self) -> None:
        """Handle requests until an exception such as KeyboardInterrupt occurs. Call `stop` afterwards."""
        self._server.serve_forever()

    def stop(self) -> None:
        """Stop listening and release the camera. The method can be called repeatedly."""
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
