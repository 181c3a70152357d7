"""Web server of the console. It runs in a separate thread with uvicorn."""

from __future__ import annotations

import errno
import os
import socket
import time
from collections.abc import Callable
from functools import partial

import uvicorn

from rhizotwin.console.access import Access, Guard
from rhizotwin.console.api import create_app
from rhizotwin.console.connections import BACKLOG, Connection, Server
from rhizotwin.console.console import Console
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.threads import LastingThread

MOST_PORTS = 20
"""Maximum number of consecutive ports that are tried."""
START_S = 30.0
"""Timeout for the start of the server, s."""


class Served:
    """Web server of the console in a separate thread, which is started again at the same address after an exception.

    Parameters
    ----------
    config : uvicorn.Config
        Configuration of the server.
    bound : socket.socket
        Socket that is bound to the address. Connections wait in it while the server is started again.
    host, access : str, Access
        Host name in the address of the page, and secrets that grant access to it.
    on_error : callable
        Function that is called with each exception.
    """

    def __init__(
        self, config: uvicorn.Config, bound: socket.socket, *, host: str, access: Access, on_error: Callable[[BaseException], object]
    ) -> None:
        self.host, self.access = host, access
        self.port: int = bound.getsockname()[1]
        self._config, self._bound = config, bound
        self._server = Server(config)
        self._ended = False
        self._thread = LastingThread(self._run, name="console", on_error=on_error)

    @property
    def address(self) -> str:
        """Address of the console's page, including the token."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{host}:{self.port}/?token={self.access.token}"

    @property
    def started(self) -> bool:
        """Whether the server accepts connections."""
        return self._server.started

    def stop(self) -> None:
        """Stop the server, and abort open requests."""
        self._ended = True
        self._server.should_exit = self._server.force_exit = True
        self._thread.join()
        self._bound.close()

    def _run(self) -> None:
        self._server = Server(self._config)
        if not self._ended:
            with self._bound.dup() as listening:
                self._server.run(sockets=[listening])


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
    served = Served(config, bound, host=host, access=access, on_error=partial(console.problems.announce, "web server"))
    end_s = time.monotonic() + START_S
    while not served.started:
        if time.monotonic() > end_s:
            served.stop()
            raise UserError(f"the web server of the console could not be started at {host}:{port}; choose another --port")
        time.sleep(0.01)
    return served


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
