"""A simulated controller's Ethernet port as a UDP socket: each sending address is a handle."""

import asyncio

from sim.core.controller import LineEndpoint, PortConnection, PortRefused

PORT = "udp"
Address = tuple[str, int]


class UdpServer(asyncio.DatagramProtocol):
    """Serve `controller` on a UDP port. Made by `listen_udp`."""

    def __init__(self, controller: LineEndpoint) -> None:
        self._controller = controller
        self._transport: asyncio.DatagramTransport | None = None
        self._handles: dict[Address, PortConnection] = {}

    @property
    def ready_fields(self) -> dict[str, object]:
        """Address fields for the ready line."""
        assert self._transport is not None
        host, port = self._transport.get_extra_info("sockname")[:2]
        return {"place": f"udp {host}:{port}", "kind": "udp", "host": host, "port": port}

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """Process a datagram. Without a free handle it gets no answer."""
        handle = self._handles.get(addr)
        if handle is None:
            try:
                handle = self._handles[addr] = self._controller.connect(
                    PORT, lambda data: self._send_datagram(data, addr), lambda: self._drop_handle(addr)
                )
            except PortRefused:
                return
        handle.receive_bytes(data)

    def restore_link(self) -> None:
        """Do nothing: after a power cycle the controller has no handles; the next datagram makes one."""

    def close(self) -> None:
        if self._transport is not None:
            self._transport.close()

    def _send_datagram(self, data: bytes, to: Address) -> None:
        if self._transport is not None:
            self._transport.sendto(data, to)

    def _drop_handle(self, address: Address) -> None:
        self._handles.pop(address, None)


async def listen_udp(controller: LineEndpoint, host: str, port: int) -> UdpServer:
    """Serve `controller` at `host` and `port`. Raises `PortRefused` when it has no such port, `OSError`."""
    if PORT not in controller.port_names:
        raise PortRefused(f"no port {PORT!r}; this model has {', '.join(controller.port_names)}")
    server = UdpServer(controller)
    await asyncio.get_running_loop().create_datagram_endpoint(lambda: server, (host, port))
    return server
