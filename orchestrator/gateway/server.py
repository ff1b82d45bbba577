"""The HTTP server of the gateway: its port, TLS, and its limits of connections."""

import asyncio
import errno
import resource
import socket
import ssl
from asyncio.sslproto import SSLProtocol
from collections.abc import Sequence
from typing import Any

from starlette.types import ASGIApp
from uvicorn import Config, Server
from uvicorn.protocols.http.h11_impl import H11Protocol

from orchestrator.gateway.stream.socket import MAX_FRAME_CHARS
from orchestrator.model.errors import TuttiError

FIRST_PORT, PORTS = 8080, 10
ADDRESS = "127.0.0.1"
MAX_CONNECTIONS = 300  # of requests; then the one that has been idle for the longest time is closed
HANDSHAKE_S = 5.0  # for the TLS handshake of a connection
MAX_FILES = 2048  # each connection is one, also one whose handshake is not over
TLS_BUFFER_BYTES = 32_768  # of each connection: two records (RFC 8446, 5.1); asyncio's own 256 kB are filled at once
SHUTDOWN_S = 2
MAX_HEADER_BYTES = 32_000


class NotServed(TuttiError):
    """The page is not served. The text says why, and what to do."""


def open_port(address: str, port: int | None) -> socket.socket:
    """Listen on a port of this machine. port: None: the first free one from 8080 on. Raises `NotServed`."""
    ports = [port] if port is not None else list(range(FIRST_PORT, FIRST_PORT + PORTS))
    for candidate in ports:
        try:
            family = socket.AF_INET6 if ":" in address else socket.AF_INET
            return socket.create_server((address, candidate), family=family, backlog=512)
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise NotServed(f"the page is not served on {address}: {error.strerror}") from None
    port_text = (
        f"port {port} of {address} is" if port is not None else f"ports {ports[0]} to {ports[-1]} of {address} are"
    )
    raise NotServed(f"the page is not served: {port_text} in use; choose another with --web-port")


class LimitedProtocol(H11Protocol):
    """A connection. Of too many the one that has been idle for the longest time is closed, so that a stop gets through
    whatever else is connected. Sockets are counted by the application."""

    def __init__(self, *values: Any, **named: Any) -> None:
        super().__init__(*values, **named)
        self.begun_s = self.loop.time()

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        if len(self.connections) > MAX_CONNECTIONS:
            oldest = min(self._list_idle(), key=lambda protocol: protocol.begun_s, default=self)
            oldest.transport.close()

    def _list_idle(self) -> "Sequence[LimitedProtocol]":
        """Connections without a request at work."""
        others_connections = [
            connection
            for connection in self.connections
            if isinstance(connection, LimitedProtocol) and connection is not self
        ]
        # Before its first request a connection has no cycle, whatever the annotation says.
        return [protocol for protocol in others_connections if not protocol.cycle or protocol.cycle.response_complete]


class LimitedServer(Server):
    """uvicorn's server with a limit of its own for TLS handshakes, which there may take a minute."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to serve on sockets that listen."""
        await super().startup(sockets=[])
        config, loop = self.config, asyncio.get_running_loop()

        def make_protocol() -> asyncio.Protocol:
            return LimitedProtocol(config=config, server_state=self.server_state, app_state=self.lifespan.state)

        limit_s = None if config.ssl is None else HANDSHAKE_S
        for sock in sockets or ():
            server = await loop.create_server(
                make_protocol, sock=sock, ssl=config.ssl, backlog=config.backlog, ssl_handshake_timeout=limit_s
            )
            self.servers.append(server)


def make_server(app: ASGIApp, context: ssl.SSLContext | None = None) -> Server:
    """The server of an application. context: for TLS."""
    SSLProtocol.max_size = TLS_BUFFER_BYTES
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(most, MAX_FILES) if most >= 0 else MAX_FILES, most))
    config = Config(
        app,
        http=LimitedProtocol,
        ws="websockets-sansio",
        ws_max_size=4 * MAX_FRAME_CHARS,
        ws_per_message_deflate=False,
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_graceful_shutdown=SHUTDOWN_S,
        h11_max_incomplete_event_size=MAX_HEADER_BYTES,
    )
    config.load()
    config.ssl = context
    return LimitedServer(config)
