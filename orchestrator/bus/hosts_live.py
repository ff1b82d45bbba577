"""Which of several computers answer: a dead one answers nothing, and an attempt to connect to it takes seconds."""

import selectors
import socket
from collections.abc import Iterable
from contextlib import ExitStack
from time import monotonic
from typing import NamedTuple


class Host(NamedTuple):
    """A place that takes connections: a name or an address with a port, or the path of a local socket."""

    name: str
    port: str = ""


def find_living(hosts: Iterable[Host], limit_s: float) -> set[Host]:
    """Those that take a connection in time, and all local sockets. All are asked at once; takes `limit_s` at most,
    besides the resolution of names."""
    living_hosts = {host for host in hosts if host.name.startswith(("/", "@"))}
    with ExitStack() as stack, selectors.DefaultSelector() as selector:
        for host in set(hosts) - living_hosts:
            if (probe := _ask(host)) is not None:
                selector.register(stack.enter_context(probe), selectors.EVENT_WRITE, host)
        until_s = monotonic() + limit_s
        while selector.get_map() and (left_s := until_s - monotonic()) > 0:
            for key, _ in selector.select(left_s):
                probe = key.fileobj
                selector.unregister(probe)
                assert isinstance(probe, socket.socket)
                if not probe.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                    living_hosts.add(key.data)
    return living_hosts


def _ask(host: Host) -> socket.socket | None:
    """Begin to connect; None: it has no address."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host.name, host.port, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError):
        return None
    probe = socket.socket(family, kind, protocol)
    probe.settimeout(0)
    probe.connect_ex(address)
    return probe
