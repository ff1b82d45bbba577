"""Which hosts of an address answer: a computer that is dead answers nothing, and each attempt to connect to it would
take two seconds, for as long as it is dead."""

import selectors
import socket
from contextlib import ExitStack
from time import monotonic
from typing import NamedTuple

from psycopg.conninfo import conninfo_to_dict, make_conninfo

DEFAULT_PORT = "5432"


class Host(NamedTuple):
    """A host of an address, as libpq takes it: a name, an address, or the folder of a local socket."""

    name: str
    port: str


def put_living_first(conninfo: str, limit_s: float) -> str:
    """The same address, its hosts that take connections before those that are silent or refuse. Takes `limit_s` at
    most, besides the resolution of names; nothing with one host."""
    hosts = _list_hosts(conninfo)
    if len(hosts) < 2:
        return conninfo
    living_hosts = _find_living(hosts, limit_s)
    hosts.sort(key=lambda host: host not in living_hosts)
    host_parts = {"host": ",".join(host.name for host in hosts), "port": ",".join(host.port for host in hosts)}
    return make_conninfo(conninfo, **host_parts)


def takes_connections(conninfo: str, limit_s: float) -> bool:
    """Whether one of the hosts takes a connection in time; True where that cannot be asked."""
    hosts = _list_hosts(conninfo)
    return not hosts or bool(_find_living(hosts, limit_s))


def _list_hosts(conninfo: str) -> list[Host]:
    """The hosts; none where libpq has their addresses from elsewhere."""
    parts = conninfo_to_dict(conninfo)
    if "hostaddr" in parts or not parts.get("host"):
        return []
    names, ports = str(parts["host"]).split(","), str(parts.get("port") or DEFAULT_PORT).split(",")
    ports = ports if len(ports) > 1 else ports * len(names)
    return [Host(name, port) for name, port in zip(names, ports, strict=True)]


def _find_living(hosts: list[Host], limit_s: float) -> set[Host]:
    """Those that take a connection in time. All are asked at once."""
    living_hosts = {host for host in hosts if host.name.startswith(("/", "@"))}
    with ExitStack() as stack, selectors.DefaultSelector() as selector:
        for host in hosts:
            if host not in living_hosts and (probe := _ask(host)) is not None:
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
        family, kind, protocol, _, address = socket.getaddrinfo(
            host.name, host.port or DEFAULT_PORT, type=socket.SOCK_STREAM
        )[0]
    except (OSError, UnicodeError):
        return None
    probe = socket.socket(family, kind, protocol)
    probe.settimeout(0)
    probe.connect_ex(address)
    return probe
