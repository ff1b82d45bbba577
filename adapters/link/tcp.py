"""Links over TCP."""

import asyncio
import contextlib
import errno
import socket

from adapters.link.descriptor import DescriptorLink, OpenDescriptor
from orchestrator.clock.base import Clock
from orchestrator.link.base import Link, LinkRefused
from orchestrator.model.links import TcpLink, UdpLink

CONNECT_TIMEOUT_S = 2.0

# Unacknowledged data for this long means a dead connection; the kernel's own default is some 15 minutes.
UNACKNOWLEDGED_MS = 3000

# Room for the download of a whole program; a controller that accepts less than this has stopped reading.
SEND_BUFFER_BYTES = 65536

_REMEDY = {
    errno.ECONNREFUSED: "connection refused; is the controller switched on, and is the port number right?",
    errno.ECONNRESET: "the controller closed the connection at once; all its handles may be in use",
    errno.EHOSTUNREACH: "no such host on that network; check address, cable and power",
    errno.ENETUNREACH: "this computer has no route to that network; check address and network settings",
    errno.EACCES: "this computer's firewall blocks it; allow the connection",
    errno.EPERM: "this computer's firewall blocks it; allow the connection",
    errno.ETIMEDOUT: "no answer; check address, cable and power",
}


async def open_tcp(link: TcpLink, clock: Clock) -> Link:
    """Connect to `link`. Raises `LinkRefused` after at most `CONNECT_TIMEOUT_S`."""
    family = socket.AF_INET6 if ":" in link.host else socket.AF_INET
    connection = socket.socket(family, socket.SOCK_STREAM)
    try:
        connection.settimeout(0.0)  # non-blocking
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNACKNOWLEDGED_MS)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        async with asyncio.timeout(CONNECT_TIMEOUT_S):
            await asyncio.get_running_loop().sock_connect(connection, (link.host, link.port))
    except BaseException as error:
        connection.close()
        reason = connection_error_text(link, error)
        if reason is None:
            raise
        raise LinkRefused(f"{link.endpoint}: {reason}") from None

    def close_socket() -> None:
        # A firing process may have a copy of the descriptor; after a shutdown that copy writes no more either.
        with contextlib.suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)
        connection.close()

    return DescriptorLink(link.endpoint, 0, OpenDescriptor(connection.fileno(), close_socket), clock)


def connection_error_text(link: TcpLink | UdpLink, error: BaseException) -> str | None:
    """Return why it could not be opened and what to do; None for an error that does not concern the connection."""
    if isinstance(error, TimeoutError) and error.errno is None:
        return f"no answer within {CONNECT_TIMEOUT_S:g} s; check address, cable and power"
    if isinstance(error, socket.gaierror | UnicodeError):
        return f"the name {link.host} cannot be resolved; correct it, or give the numeric address"
    if isinstance(error, OSError):
        return _REMEDY.get(error.errno or 0, f"{error.strerror}; check address and network settings")
    return None
