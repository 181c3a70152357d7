"""Limits on the network connections of the console, so that a running scan never lacks file descriptors.

Uvicorn accepts any number of connections, and keeps one that sends nothing for ever.
"""

from __future__ import annotations

import asyncio
import time

import uvicorn
from uvicorn.protocols.http.auto import AutoHTTPProtocol

MOST_CONNECTIONS = 256
"""Maximum number of connections. Forty browsers use two to six each: one waits for the next state, others load
pictures."""
SHARE = 4
"""Divisor of the process's limit of file descriptors: at most one in four is a connection. A scan uses about thirty,
and the remaining ones are for files, devices and workers."""
BACKLOG = 64
"""Number of connections that wait to be accepted. All of them are accepted at once, before any is closed."""
QUIET_S = 10.0
"""Time after which a connection without a complete request is closed, s. Browsers send one at once, and open a closed
connection again."""


class Connection(AutoHTTPProtocol):  # type: ignore[misc, valid-type] # uvicorn selects the class when it is imported
    """Connection that makes room for itself when there are too many."""

    quiet_since_s = 0.0
    """Time since which the connection has had no complete request, on the clock of `time.monotonic`."""

    def connection_made(self, transport: asyncio.Transport) -> None:
        """Accept the connection. If there are too many, close the one that has been quiet longest, or else this one."""
        self.quiet_since_s = time.monotonic()
        super().connection_made(transport)
        if len(self.connections) > most_connections():
            others = [one for one in self.connections if one is not self and not one.is_busy]
            min(others, key=lambda one: one.quiet_since_s, default=self).drop()

    @property
    def is_busy(self) -> bool:
        """Whether a request has been received completely, and its response is not complete."""
        return self.cycle is not None and not self.cycle.response_complete and not self.cycle.more_body

    def drop(self) -> None:
        """Close the connection immediately."""
        self.connections.discard(self)
        self.transport.abort()


class Server(uvicorn.Server):
    """Web server that closes quiet connections."""

    async def on_tick(self, counter: int) -> bool:
        """Close each connection that has been quiet for `QUIET_S`. Uvicorn calls this method ten times a second."""
        now_s = time.monotonic()
        for connection in list(self.server_state.connections):
            if not isinstance(connection, Connection):
                continue
            if connection.is_busy:
                connection.quiet_since_s = now_s
            elif now_s - connection.quiet_since_s > QUIET_S:
                connection.drop()
        return await super().on_tick(counter)


def most_connections() -> int:
    """Return the maximum number of connections, which leaves most file descriptors of this process to the scan."""
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return MOST_CONNECTIONS
    allowed, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return MOST_CONNECTIONS if allowed == resource.RLIM_INFINITY else min(MOST_CONNECTIONS, max(1, allowed // SHARE))
