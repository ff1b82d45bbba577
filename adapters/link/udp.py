"""Links over UDP: datagrams to one address, and only those that come from it."""

import asyncio
import socket

from adapters.link.descriptor import DescriptorLink
from adapters.link.tcp import reason
from orchestrator.clock.base import Clock
from orchestrator.link.base import Link, LinkRefused
from orchestrator.model.fleet import UdpLink

RESOLVE_TIMEOUT_S = 2.0


async def open_udp(link: UdpLink, clock: Clock) -> Link:
    """A socket of its own for `link`: nothing is sent, so nobody is known to be there. Raises `LinkRefused`."""
    family = socket.AF_INET6 if ":" in link.host else socket.AF_INET
    connection = socket.socket(family, socket.SOCK_DGRAM)
    try:
        connection.setblocking(False)
        async with asyncio.timeout(RESOLVE_TIMEOUT_S):
            await asyncio.get_running_loop().sock_connect(connection, (link.host, link.port))
    except BaseException as error:
        connection.close()
        why = reason(link, error)
        if why is None:
            raise
        raise LinkRefused(f"{link.place}: {why}") from None
    return DescriptorLink(link.place, 0, connection.fileno(), connection.close, clock, datagrams=True)
