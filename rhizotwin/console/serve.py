"""Web server of the console. It runs in a separate thread with uvicorn."""

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
from rhizotwin.console.connections import BACKLOG, Connection, Server
from rhizotwin.console.console import Console
from rhizotwin.scenes.errors import UserError

MOST_PORTS = 20
"""Maximum number of consecutive ports that are tried."""
START_S = 30.0
"""Timeout for the start of the server, s."""


@dataclass(frozen=True)
class Served:
    """Running web server of the console."""

    host: str
    port: int
    access: Access
    _server: uvicorn.Server
    _thread: threading.Thread

    @property
    def address(self) -> str:
        """Address of the console's page, including the token."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{host}:{self.port}/?token={self.access.token}"

    def stop(self) -> None:
        """Stop the server, and abort open requests."""
        self._server.should_exit = self._server.force_exit = True
        self._thread.join()


def serve(console: Console, access: Access, *, host: str, port: int) -> Served:
    """Start the web server of a console. If the port is in use, the next free port is used.

    Parameters
    ----------
    console, access : Console, Access
        Console, and secrets that grant access to it.
    host, port : str, int
        Network address of this computer, and first port to try.

    Returns
    -------
    Served
        Running server.

    Raises
    ------
    UserError
        If the server cannot be started at the address.
    """
    bound = _bind(host, port)
    config = uvicorn.Config(
        Guard(create_app(console, access), access),
        http=Connection,
        backlog=BACKLOG,
        log_level="critical",
        access_log=False,
        server_header=False,
        ws="none",
        lifespan="off",
    )
    server = Server(config)
    thread = threading.Thread(target=lambda: server.run(sockets=[bound]), name="console", daemon=True)
    thread.start()
    end_s = time.monotonic() + START_S
    while not server.started:
        if not thread.is_alive() or time.monotonic() > end_s:
            raise UserError(f"the web server of the console could not be started at {host}:{port}; choose another --port")
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
    raise UserError(f"the console cannot use the address {host}:{port} ({reason}); choose another --host or --port")
