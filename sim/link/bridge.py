"""TCP serial bridge: the serial port of a simulated controller at a listening socket.

It works as device servers do in raw mode with several connections: bytes of any client go to the line in order of
arrival, and bytes of the controller go to all clients. Both directions are paced like the line.
"""

import asyncio
import contextlib
import socket

from orchestrator.clock.base import NS_PER_S, Clock
from sim.core.controller import LineEndpoint, PortConnection, PortRefused
from sim.link.arguments import TcpAddress
from sim.link.pacing import PacedLine

PORT = "serial"

# Bytes that the bridge buffers for the line; more wait in the clients' own buffers.
UNSENT_BYTES = 4096

# Bytes that a client has not read: beyond this the bridge drops the connection, and not the line.
UNREAD_BYTES = 65536


class _BridgeClient(asyncio.Protocol):
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
        self._bridge.forward_to_line(data)

    def connection_lost(self, exc: Exception | None) -> None:
        del exc
        self._bridge.clients.remove(self)

    def send_bytes(self, data: bytes) -> None:
        assert self.transport is not None
        if self.transport.is_closing():
            return
        if self.transport.get_write_buffer_size() > UNREAD_BYTES:
            self.transport.abort()
        else:
            self.transport.write(data)


class BridgeServer:
    """Serve the serial port of `controller` at a TCP port. Made by `listen_bridge`.

    bits: of one character."""

    def __init__(self, controller: LineEndpoint, clock: Clock, baud: int, bits: int) -> None:
        self._controller = controller
        self._clock = clock
        self._char_ns = bits * NS_PER_S // baud
        self._in = PacedLine(clock, self._char_ns, self._deliver_to_controller)
        self._out = PacedLine(clock, self._char_ns, self._send_to_clients)
        self._far: PortConnection | None = None
        self._held_up = False
        self._server: asyncio.Server | None = None
        self.clients: list[_BridgeClient] = []
        self.restore_link()

    async def open_port(self, host: str, port: int) -> None:
        """Open the port; 0 takes a free one. Raises `OSError`."""
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: _BridgeClient(self), host, port)

    @property
    def ready_fields(self) -> dict[str, object]:
        """Address fields for the ready line."""
        assert self._server is not None
        host, port = self._server.sockets[0].getsockname()[:2]
        return {"place": f"tcp {host}:{port}", "kind": "tcp", "host": host, "port": port}

    def restore_link(self) -> None:
        """Reconnect after a power cycle of the controller: the cable is still plugged in, but bytes in transmission are
        lost."""
        if self._far is not None:
            self._out.cut_transmission(self._far.supply.lost_ns)
        else:
            with contextlib.suppress(PortRefused):
                self._far = self._controller.connect(PORT, self._out.queue_bytes, self._handle_disconnect)

    def close(self) -> None:
        """Close the port and all connections."""
        if self._server is not None:
            self._server.close()
        for client in self.clients:
            if client.transport is not None:
                client.transport.close()

    def forward_to_line(self, data: bytes) -> None:
        """Forward `data` from a client to the line."""
        self._in.queue_lines(data)
        if not self._held_up and self._in.waiting >= UNSENT_BYTES:
            self._throttle_clients(on=True)

    def _throttle_clients(self, *, on: bool) -> None:
        """Pause or resume clients that send faster than the line transmits."""
        self._held_up = on
        for client in self.clients:
            if client.transport is not None:
                (client.transport.pause_reading if on else client.transport.resume_reading)()

    def _deliver_to_controller(self, data: bytes) -> None:
        if self._held_up and self._in.waiting < UNSENT_BYTES:
            self._throttle_clients(on=False)
        self.restore_link()
        if self._far is not None:
            data_left = self._far.supply.cut_received(data, self._clock.now_ns(), self._char_ns)
            if data_left:
                self._far.receive_bytes(data_left)

    def _send_to_clients(self, data: bytes) -> None:
        for client in list(self.clients):
            client.send_bytes(data)

    def _handle_disconnect(self) -> None:
        self._far = None
        self._out.cut_transmission(self._clock.now_ns())


async def listen_bridge(
    controller: LineEndpoint, clock: Clock, place: TcpAddress, baud: int, bits: int
) -> BridgeServer:
    """Serve the serial port of `controller` at `place`. Raises `PortRefused` when it has none, `OSError`."""
    if PORT not in controller.port_names:
        raise PortRefused(f"no port {PORT!r}; this model has {', '.join(controller.port_names)}")
    server = BridgeServer(controller, clock, baud, bits)
    await server.open_port(place.host, place.port)
    return server
