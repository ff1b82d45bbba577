"""An EPICS server for the demo fleet in this process, and clients that find it."""

import asyncio
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from socket import AF_INET, SOCK_STREAM, socket

from integrations.epics.server import ServerSettings, serve_epics
from tutti import Tutti


def free_ports(count: int) -> list[int]:
    """Free TCP ports, most probably free for UDP too."""
    sockets = [socket(AF_INET, SOCK_STREAM) for _ in range(count)]
    try:
        for open_socket in sockets:
            open_socket.bind(("127.0.0.1", 0))
        return [open_socket.getsockname()[1] for open_socket in sockets]
    finally:
        for open_socket in sockets:
            open_socket.close()


def set_client_environment(pva_port: int, ca_port: int) -> None:
    """Let the clients of this process and its children look for PVs at these ports of loopback alone."""
    os.environ.update(
        EPICS_PVA_AUTO_ADDR_LIST="NO",
        EPICS_PVA_ADDR_LIST="",
        EPICS_PVA_NAME_SERVERS=f"127.0.0.1:{pva_port}",
        EPICS_CA_AUTO_ADDR_LIST="NO",
        EPICS_CA_ADDR_LIST=f"127.0.0.1:{ca_port}",
        EPICS_CA_SERVER_PORT=str(ca_port),
        EPICS_CAS_AUTO_BEACON_ADDR_LIST="NO",
        EPICS_CAS_BEACON_ADDR_LIST="127.0.0.1",
    )


PVA_PORT, CA_PORT = free_ports(2)
set_client_environment(PVA_PORT, CA_PORT)


@contextmanager
def serving(endpoint: str, settings: ServerSettings) -> Iterator[None]:
    """The server, in a thread with a loop of its own."""
    ready, failures = threading.Event(), list[BaseException]()
    ends: list[Callable[[], object]] = []

    async def main() -> None:
        end_event, loop = asyncio.Event(), asyncio.get_running_loop()
        ends.append(lambda: loop.call_soon_threadsafe(end_event.set))
        async with Tutti(endpoint, actor="epics") as tutti, serve_epics(tutti, settings):
            ready.set()
            await end_event.wait()

    def run() -> None:
        try:
            asyncio.run(main())
        except BaseException as error:
            failures.append(error)
        finally:
            ready.set()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    assert ready.wait(30)
    if not failures:
        try:
            yield
        finally:
            ends[0]()
            thread.join(20)
    assert not failures, failures
