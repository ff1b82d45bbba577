"""A TCP serial bridge: the serial port of a simulated controller behind a listening socket.

As device servers in their raw mode with several connections do it: what any client sends goes to the line, in the
order in which it comes, and what the controller sends goes to all clients. Both directions are paced as on the line.
"""

import asyncio
import contextlib
import socket

from orchestrator.clock.base import NS_PER_S, Clock
from sim.core.controller import Connection, Port, PortRefused
from sim.link.pacing import PacedLine

PORT = "serial"

# As many bytes as the bridge keeps for the line; more wait in the clients' own buffers.
UNSENT_BYTES = 4096

# What a client has not taken: a bridge drops the connection then, and not the line.
UNREAD_BYTES = 65536


class _Client(asyncio.Protocol):
    """One connection to the bridge."""

    def __init__(self, bridge: "BridgeServer") -> None:
        self._bridge = bridge
        self.transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        connection: socket.socket = transport.get_extra_info("socket")
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.transport = transport
        self._bridge.clients.append(self)

    def data_received(self, data: bytes) -> None:
        self._bridge.heard(data)

    def connection_lost(self, exc: Exception | None) -> None:
        del exc
        self._bridge.clients.remove(self)

    def send(self, data: bytes) -> None:
        assert self.transport is not None
        if self.transport.is_closing():
            return
        if self.transport.get_write_buffer_size() > UNREAD_BYTES:
            self.transport.abort()
        else:
            self.transport.write(data)


class BridgeServer:
    """Serves the serial port of `controller` at a TCP port. Made by `listen_bridge`. `bits`: of one character."""

    def __init__(self, controller: Port, clock: Clock, baud: int, bits: int) -> None:
        self._controller = controller
        self._clock = clock
        self._char_ns = bits * NS_PER_S // baud
        self._in = PacedLine(clock, self._char_ns, self._arrive)
        self._out = PacedLine(clock, self._char_ns, self._leave)
        self._far: Connection | None = None
        self._held_up = False
        self._server: asyncio.Server | None = None
        self.clients: list[_Client] = []
        self.reconnect()

    async def listen(self, host: str, port: int) -> None:
        """Open the port; 0 takes a free one. Raises `OSError`."""
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: _Client(self), host, port)

    @property
    def ready(self) -> dict[str, object]:
        """Where it is, for the ready line."""
        assert self._server is not None
        host, port = self._server.sockets[0].getsockname()[:2]
        return {"place": f"tcp {host}:{port}", "kind": "tcp", "host": host, "port": port}

    def reconnect(self) -> None:
        """A wire is still plugged in when the controller comes back from a power cycle, without what it was saying."""
        if self._far is not None:
            self._out.fell_silent(self._far.supply.lost_ns)
        else:
            with contextlib.suppress(PortRefused):
                self._far = self._controller.connect(PORT, self._out.put, self._hung_up)

    def close(self) -> None:
        """Close the port and all connections."""
        if self._server is not None:
            self._server.close()
        for client in self.clients:
            if client.transport is not None:
                client.transport.close()

    def heard(self, data: bytes) -> None:
        """A client has sent `data`."""
        self._in.put_lines(data)
        if not self._held_up and self._in.waiting >= UNSENT_BYTES:
            self._hold_up(True)

    def _hold_up(self, on: bool) -> None:
        """Clients that send faster than the line takes it wait."""
        self._held_up = on
        for client in self.clients:
            if client.transport is not None:
                (client.transport.pause_reading if on else client.transport.resume_reading)()

    def _arrive(self, data: bytes) -> None:
        if self._held_up and self._in.waiting < UNSENT_BYTES:
            self._hold_up(False)
        self.reconnect()
        if self._far is not None:
            heard = self._far.supply.heard(data, self._clock.now_ns(), self._char_ns)
            if heard:
                self._far.receive(heard)

    def _leave(self, data: bytes) -> None:
        for client in list(self.clients):
            client.send(data)

    def _hung_up(self) -> None:
        self._far = None
        self._out.fell_silent(self._clock.now_ns())


async def listen_bridge(controller: Port, clock: Clock, host: str, port: int, baud: int, bits: int) -> BridgeServer:
    """Serve the serial port of `controller` at `host` and `port`. Raises `PortRefused` when it has none, `OSError`."""
    if PORT not in controller.ports:
        raise PortRefused(f"no port {PORT!r}; this model has {', '.join(controller.ports)}")
    server = BridgeServer(controller, clock, baud, bits)
    await server.listen(host, port)
    return server
