"""Serve the console with uvicorn, in a thread of its own."""

from __future__ import annotations

import errno
import os
import socket
import threading
import time
from dataclasses import dataclass

import uvicorn

from rhizotwin.console.access import Access, Guard
from rhizotwin.console.api import create_app
from rhizotwin.console.console import Console
from rhizotwin.scenes.errors import UserError

MOST_PORTS = 20
"""Ports that are tried, from the given one."""
START_S = 30.0


@dataclass(frozen=True)
class Served:
    """A running server."""

    host: str
    port: int
    access: Access
    _server: uvicorn.Server
    _thread: threading.Thread

    @property
    def address(self) -> str:
        """Address to open in a browser."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{host}:{self.port}/?token={self.access.token}"

    def stop(self) -> None:
        """End the server; open requests are cut."""
        self._server.should_exit = self._server.force_exit = True
        self._thread.join()


def serve(console: Console, access: Access, *, host: str, port: int) -> Served:
    """Start the server; where the port is in use, at the next free one.

    Parameters
    ----------
    console, access : Console, Access
        Served to those who know a secret of ``access``.
    host, port : str, int
        Address of this computer, and first port.

    Raises
    ------
    UserError
        Where nothing can be served at the address.
    """
    bound = _bind(host, port)
    config = uvicorn.Config(
        Guard(create_app(console, access), access), log_level="critical", access_log=False, server_header=False, ws="none", lifespan="off"
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=lambda: server.run(sockets=[bound]), name="console", daemon=True)
    thread.start()
    end_s = time.monotonic() + START_S
    while not server.started:
        if not thread.is_alive() or time.monotonic() > end_s:
            raise UserError(f"the console could not be served at {host}:{port}")
        time.sleep(0.01)
    return Served(host, bound.getsockname()[1], access, server, thread)


def _bind(host: str, port: int) -> socket.socket:
    reason = ""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        for number in range(port, min(port + MOST_PORTS, 65536)):
            bound = socket.socket(family, kind, protocol)
            if os.name == "posix":  # elsewhere the option lets two servers share a port
                bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                bound.bind((address[0], number, *address[2:]))
            except OSError as error:
                bound.close()
                reason = error.strerror or str(error)
                if error.errno != errno.EADDRINUSE:
                    break
            else:
                return bound
    except OSError as error:
        reason = error.strerror or str(error)
    raise UserError(f"nothing can be served at {host}:{port} ({reason}); choose another --host or --port")
