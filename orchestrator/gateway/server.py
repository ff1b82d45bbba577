"""The HTTP server of the gateway: its port, TLS, and its limits of connections."""

import asyncio
import errno
import socket
import ssl
from asyncio.sslproto import SSLProtocol
from collections.abc import Callable
from typing import Any

import h11
from starlette.types import ASGIApp
from uvicorn import Config, Server
from uvicorn.protocols.http.h11_impl import H11Protocol

from orchestrator.clock.process_limits import allow_open_files
from orchestrator.gateway.connections import GRACE_S, Connection, ConnectionTable
from orchestrator.gateway.guard import CONNECTION, MAX_BODY_BYTES, MAX_HEADER_BYTES
from orchestrator.gateway.stream.socket import MAX_FRAME_CHARS
from orchestrator.model.errors import TuttiError

FIRST_PORT, PORTS = 8080, 10
ADDRESS = "127.0.0.1"
HANDSHAKE_S = 5.0  # for the TLS handshake of a connection
MAX_FILES = 2048  # each connection is one, also one whose handshake is not over
TLS_BUFFER_BYTES = 32_768  # of each connection: two records (RFC 8446, 5.1); asyncio's own 256 kB are filled at once
SHUTDOWN_S = 2
HEAD_S = 5.0  # for the head of a request: from the connection, or from its first byte on
DROP_S = 1.0  # what still comes of a body that was not needed
BACKLOG, ACCEPTED = 512, 128  # connections that wait in the kernel, and that are accepted at once
HANDSHAKE = "tutti connection"  # of a transport: its `Connection`
LATE_HEAD = b"HTTP/1.1 408 Request Timeout\r\ncontent-length: 0\r\nconnection: close\r\n\r\n"


class NotServed(TuttiError):
    """The page is not served. The text says why, and what to do."""


def open_port(address: str, port: int | None) -> socket.socket:
    """Listen on a port of this machine. port: None: the first free one from 8080 on. Raises `NotServed`."""
    ports = [port] if port is not None else list(range(FIRST_PORT, FIRST_PORT + PORTS))
    for candidate in ports:
        try:
            family = socket.AF_INET6 if ":" in address else socket.AF_INET
            return socket.create_server((address, candidate), family=family, backlog=BACKLOG)
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise NotServed(f"the page is not served on {address}: {error.strerror}") from None
    port_text = (
        f"port {port} of {address} is" if port is not None else f"ports {ports[0]} to {ports[-1]} of {address} are"
    )
    raise NotServed(f"the page is not served: {port_text} in use; choose another with --web-port")


class LimitedProtocol(H11Protocol):
    """A connection of requests, with a limit of time for the head of each. The time of a body is the application's.

    uvicorn itself limits neither, and ends what is idle after an answer only.
    """

    def __init__(self, table: ConnectionTable, *values: Any, **named: Any) -> None:
        super().__init__(*values, **named)
        self._table, self._limit = table, None
        self._is_ending, self._dropped = False, 0
        self._connection: Connection | None = None

    def connection_made(self, transport: Any) -> None:
        """Begin. The connection is in the table already where its handshake was."""
        super().connection_made(transport)
        handshake = transport.get_extra_info(HANDSHAKE)
        if isinstance(handshake, Connection):
            self._connection = handshake
        else:
            self._connection = _admit(self._table, transport, self.loop)
        self.app_state = {**self.app_state, CONNECTION: self._connection}
        self._limit_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        self._stop_limit()
        if self._connection is not None:
            self._table.remove_connection(self._connection)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take what has come. After an answer that needed no body, the rest of that body is dropped."""
        self._dropped += len(data) if self._is_ending else 0
        if self._dropped > MAX_BODY_BYTES:
            self.transport.abort()
            return
        super().data_received(data)
        if self._is_ending and self.conn.their_state is not h11.SEND_BODY:
            self._is_ending = False
            super().on_response_complete()
        self._follow_request()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Become a socket; the application counts those."""
        self._stop_limit()
        if self._connection is not None:
            self._table.remove_connection(self._connection)
        super().handle_websocket_upgrade(event)

    def on_response_complete(self) -> None:
        """Go on to the next request; or end, if the last one was answered before its body had come."""
        if self.conn.their_state is h11.SEND_BODY and not self.transport.is_closing():
            self._is_ending = True
            # At once, its answer could be lost with what is still on its way (RFC 9112, 9.6).
            self._limit = self._limit or self.loop.call_later(DROP_S, self.transport.abort)
            self.flow.resume_reading()
            return
        super().on_response_complete()
        self._follow_request()

    def _follow_request(self) -> None:
        """Set or stop the limit, and state for the table where the request is."""
        is_head_pending = self.conn.their_state is h11.IDLE
        is_begun = is_head_pending and bool(self.conn.trailing_data[0])
        if self._connection is not None:
            # Before its first request a connection has no cycle, whatever the annotation says.
            is_answering = self.cycle is not None and not self.cycle.response_complete  # pyright: ignore[reportUnnecessaryComparison]
            self._connection.working = is_answering and not self.cycle.more_body
            self._connection.reading = is_begun or (is_answering and self.cycle.more_body)
        if not is_head_pending:
            self._stop_limit()
        elif is_begun:
            self._limit_head()

    def _limit_head(self) -> None:
        if self._limit is None:
            self._limit = self.loop.call_later(HEAD_S, self._refuse_head)

    def _stop_limit(self) -> None:
        if self._limit is not None and not self._is_ending:
            self._limit.cancel()
            self._limit = None

    def _refuse_head(self) -> None:
        """End a connection whose head did not come in time."""
        if not self.transport.is_closing():
            if self.conn.trailing_data[0]:
                self.transport.write(LATE_HEAD)
            self.transport.close()


class CountedHandshake(SSLProtocol):
    """TLS of a connection that counts from its first byte on, before its handshake is over."""

    def __init__(self, table: ConnectionTable, loop: asyncio.AbstractEventLoop, *values: Any, **named: Any) -> None:
        super().__init__(loop, *values, **named)
        self._table, self._own_loop = table, loop
        self._connection: Connection | None = None

    def connection_made(self, transport: Any) -> None:
        """Count it, and begin the handshake."""
        self._connection = _admit(self._table, transport, self._own_loop)
        self._extra[HANDSHAKE] = self._connection  # pyright: ignore[reportUnknownMemberType, reportAttributeAccessIssue]
        super().connection_made(transport)

    def connection_lost(self, exc: BaseException | None) -> None:
        """Forget it."""
        if self._connection is not None:
            self._table.remove_connection(self._connection)
        super().connection_lost(exc)


def _admit(table: ConnectionTable, transport: Any, loop: asyncio.AbstractEventLoop) -> Connection:
    """Put a new connection into the table. What must not be ended yet is looked at again after its grace."""
    peer = transport.get_extra_info("peername")
    connection = Connection(str(peer[0]) if peer else "local", loop.time(), transport.abort)
    table.add_connection(connection, loop.time())
    loop.call_later(GRACE_S, lambda: table.make_room(loop.time()))
    return connection


class LimitedServer(Server):
    """uvicorn's server with limits of its own: of connections, also before their handshake, which there may take a
    minute."""

    def __init__(self, config: Config, table: ConnectionTable) -> None:
        super().__init__(config)
        self._table = table

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to serve on sockets that listen."""
        await super().startup(sockets=[])
        for sock in sockets or ():
            # So many are accepted at once, before one of them is counted; more may wait in the kernel.
            server = await asyncio.get_running_loop().create_server(self._make_protocol, sock=sock, backlog=ACCEPTED)
            sock.listen(BACKLOG)
            self.servers.append(server)

    def _make_protocol(self) -> asyncio.BaseProtocol:
        config, loop = self.config, asyncio.get_running_loop()
        protocol = LimitedProtocol(
            self._table, config=config, server_state=self.server_state, app_state=self.lifespan.state
        )
        if config.ssl is None:
            return protocol
        return CountedHandshake(
            self._table, loop, protocol, config.ssl, None, server_side=True, ssl_handshake_timeout=HANDSHAKE_S
        )


def make_server(
    app: ASGIApp, context: ssl.SSLContext | None = None, note: Callable[[str], None] = lambda _: None
) -> Server:
    """The server of an application. context: for TLS. note: called with a line for the log."""
    SSLProtocol.max_size = TLS_BUFFER_BYTES
    allow_open_files(MAX_FILES)
    config = Config(
        app,
        http="h11",
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
    return LimitedServer(config, ConnectionTable(note))
