"""Links to CAN buses, over any interface that python-can supports.

python-can uses threads and blocking calls. It runs in a process of its own (`adapters.link.can_process`), so that it
and the event loop do not delay each other, and time stamps stay exact; a firing process writes its frames to that
process.
"""

import asyncio
import contextlib
import os
import socket
import sys

from adapters.link.descriptor import DescriptorLink, OpenDescriptor
from orchestrator.clock.base import Clock
from orchestrator.link.base import Link, LinkRefused, ReceivedBytes
from orchestrator.model.links import CanBusLink

OPEN_TIMEOUT_S = 10.0
END_TIMEOUT_S = 2.0
DATAGRAM = 65536

# Messages of the process: the first byte of each of its datagrams.
READY, FRAMES, ERROR = b"R", b"F", b"E"
STAMP_BYTES = 8


class _CanProcessLink(DescriptorLink):
    """The parent's end of the process's socket: whole frames out, and stamped frames in."""

    def __init__(self, endpoint: str, descriptor: OpenDescriptor, clock: Clock) -> None:
        super().__init__(endpoint, 0, descriptor, clock, datagrams=True)
        self.process: asyncio.subprocess.Process | None = None

    def _handle_readable(self) -> None:
        try:
            data = os.read(self._fd, DATAGRAM)
        except BlockingIOError:
            return
        except OSError as error:
            self._shut_down(f"{self._place}: {error.strerror}")
            return
        if data[:1] == FRAMES:
            at_ns = int.from_bytes(data[1 : 1 + STAMP_BYTES], "little")
            self._received.append(ReceivedBytes(data[1 + STAMP_BYTES :], at_ns))
            self._wake_reader()
        else:
            self._shut_down(f"{self._place}: {data[1:].decode() or 'the process of the CAN interface has died'}")

    async def close(self) -> None:
        await super().close()
        process, self.process = self.process, None
        if process is not None:
            try:
                async with asyncio.timeout(END_TIMEOUT_S):
                    await process.wait()
            except TimeoutError:
                process.kill()
                await process.wait()


async def open_can(link: CanBusLink, clock: Clock) -> Link:
    """Open an interface as a node of its own on the bus. Raises `LinkRefused`."""
    own_socket, other_socket = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    own_socket.settimeout(0.0)
    command = (sys.executable, "-m", "adapters.link.can_process", str(other_socket.fileno()))
    with other_socket:
        process = await asyncio.create_subprocess_exec(
            *command,
            link.interface,
            link.channel,
            str(link.bitrate),
            pass_fds=[other_socket.fileno()],
            stdin=asyncio.subprocess.DEVNULL,
        )
    try:
        async with asyncio.timeout(OPEN_TIMEOUT_S):
            message = await asyncio.get_running_loop().sock_recv(own_socket, DATAGRAM)
    except BaseException as error:
        own_socket.close()
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()
        if isinstance(error, TimeoutError):
            raise LinkRefused(
                f"{link.endpoint}: the interface {link.interface} did not open within {OPEN_TIMEOUT_S:g} s; "
                "check the CAN adapter and its driver"
            ) from None
        raise
    if message != READY:
        own_socket.close()
        await process.wait()
        raise LinkRefused(f"{link.endpoint}: {message[1:].decode() or 'the process of the CAN interface has died'}")
    port = _CanProcessLink(link.endpoint, OpenDescriptor(own_socket.fileno(), own_socket.close), clock)
    port.process = process
    return port
