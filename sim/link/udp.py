"""A simulated controller's Ethernet port as a UDP socket: each address that sends something is a handle."""

import asyncio

from sim.core.controller import Connection, Port, PortRefused

PORT = "udp"
Address = tuple[str, int]


class UdpServer(asyncio.DatagramProtocol):
    """Serves `controller` on a UDP port. Made by `listen_udp`."""

    def __init__(self, controller: Port) -> None:
        self._controller = controller
        self._transport: asyncio.DatagramTransport | None = None
        self._handles: dict[Address, Connection] = {}

    @property
    def ready(self) -> dict[str, object]:
        """Where it is, for the ready line."""
        assert self._transport is not None
        host, port = self._transport.get_extra_info("sockname")[:2]
        return {"place": f"udp {host}:{port}", "kind": "udp", "host": host, "port": port}

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """A datagram for which no handle is left gets no answer."""
        handle = self._handles.get(addr)
        if handle is None:
            try:
                handle = self._handles[addr] = self._controller.connect(
                    PORT, lambda said: self._send(said, addr), lambda: self._forget(addr)
                )
            except PortRefused:
                return
        handle.receive(data)

    def reconnect(self) -> None:
        """A controller that comes back from a power cycle knows no handle; the next datagram makes one."""

    def close(self) -> None:
        if self._transport is not None:
            self._transport.close()

    def _send(self, data: bytes, to: Address) -> None:
        if self._transport is not None:
            self._transport.sendto(data, to)

    def _forget(self, address: Address) -> None:
        self._handles.pop(address, None)


async def listen_udp(controller: Port, host: str, port: int) -> UdpServer:
    """Serve `controller` at `host` and `port`. Raises `PortRefused` when it has no such port, `OSError`."""
    if PORT not in controller.ports:
        raise PortRefused(f"no port {PORT!r}; this model has {', '.join(controller.ports)}")
    server = UdpServer(controller)
    await asyncio.get_running_loop().create_datagram_endpoint(lambda: server, (host, port))
    return server
