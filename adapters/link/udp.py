"""Links over UDP: datagrams to one address, and only those that come from it."""

import asyncio
import socket

from adapters.link.descriptor import DescriptorLink, OpenDescriptor
from adapters.link.tcp import connection_error_text
from orchestrator.clock.base import Clock
from orchestrator.link.base import Link, LinkRefused
from orchestrator.model.links import UdpLink

RESOLVE_TIMEOUT_S = 2.0


async def open_udp(link: UdpLink, clock: Clock) -> Link:
    """Open a separate socket for `link`: nothing is sent, so the controller's presence is not checked. Raises
    `LinkRefused`."""
    family = socket.AF_INET6 if ":" in link.host else socket.AF_INET
    connection = socket.socket(family, socket.SOCK_DGRAM)
    try:
        connection.settimeout(0.0)  # non-blocking
        async with asyncio.timeout(RESOLVE_TIMEOUT_S):
            await asyncio.get_running_loop().sock_connect(connection, (link.host, link.port))
    except BaseException as error:
        connection.close()
        reason = connection_error_text(link, error)
        if reason is None:
            raise
        raise LinkRefused(f"{link.endpoint}: {reason}") from None
    return DescriptorLink(
        link.endpoint, 0, OpenDescriptor(connection.fileno(), connection.close), clock, datagrams=True
    )
