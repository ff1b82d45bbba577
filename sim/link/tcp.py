"""A simulated controller's Ethernet port as a listening socket."""

import asyncio
import contextlib
import socket
import struct

from sim.core.controller import LineEndpoint, PortConnection, PortRefused

PORT = "tcp"

# Beyond this many unread bytes the controller drops the connection: its own buffers are smaller.
UNREAD_BYTES = 65536

_RESET_ON_CLOSE = struct.pack("ii", 1, 0)


class _TcpHandle(asyncio.Protocol):
    """One connection of a client."""

    def __init__(self, server: "TcpServer") -> None:
        self._server = server
        self._transport: asyncio.Transport | None = None
        self._far: PortConnection | None = None
        self._unsent: list[bytes] = []

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._server.handles.add(self)
        connection: socket.socket = transport.get_extra_info("socket")
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            self._far = self._server.controller.connect(PORT, self._queue_bytes, self.close_after_send)
        except PortRefused:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET_ON_CLOSE)
            transport.abort()

    def data_received(self, data: bytes) -> None:
        if self._far is not None:
            self._far.receive_bytes(data)

    def connection_lost(self, exc: Exception | None) -> None:
        del exc
        self._server.handles.discard(self)
        far_end, self._far = self._far, None
        if far_end is not None:
            far_end.close()

    def close_after_send(self) -> None:
        """Close the connection after the bytes sent so far."""
        self._flush_packet()
        if self._transport is not None:
            self._transport.close()

    def _queue_bytes(self, data: bytes) -> None:
        """Queue `data`. Bytes of one instant leave in one packet, because each packet wakes the reader."""
        if not self._unsent:
            asyncio.get_running_loop().call_soon(self._flush_packet)
        self._unsent.append(data)

    def _flush_packet(self) -> None:
        data, self._unsent = b"".join(self._unsent), []
        if not data or self._transport is None or self._transport.is_closing():
            return
        if self._transport.get_write_buffer_size() > UNREAD_BYTES:
            self._transport.abort()
        else:
            self._transport.write(data)


class TcpServer:
    """Serve `controller` on a TCP port. Made by `listen_tcp`."""

    def __init__(self, controller: LineEndpoint) -> None:
        self.controller = controller
        self.handles: set[_TcpHandle] = set()
        self._server: asyncio.Server | None = None

    async def open_port(self, host: str, port: int) -> None:
        """Open the port; 0 takes a free one. Raises `OSError`."""
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: _TcpHandle(self), host, port)

    @property
    def ready_fields(self) -> dict[str, object]:
        """Address fields for the ready line."""
        assert self._server is not None
        host, port = self._server.sockets[0].getsockname()[:2]
        return {"place": f"tcp {host}:{port}", "kind": "tcp", "host": host, "port": port}

    def restore_link(self) -> None:
        """Do nothing: clients of a controller that comes back from a power cycle connect by themselves."""

    def close(self) -> None:
        """Close the port and all connections."""
        if self._server is not None:
            self._server.close()
        for handle in list(self.handles):
            handle.close_after_send()


async def listen_tcp(controller: LineEndpoint, host: str, port: int) -> TcpServer:
    """Serve `controller` at `host` and `port`. Raises `PortRefused` when it has no such port, `OSError`."""
    if PORT not in controller.port_names:
        raise PortRefused(f"no port {PORT!r}; this model has {', '.join(controller.port_names)}")
    server = TcpServer(controller)
    with contextlib.ExitStack() as undo:
        undo.callback(server.close)
        await server.open_port(host, port)
        undo.pop_all()
    return server
