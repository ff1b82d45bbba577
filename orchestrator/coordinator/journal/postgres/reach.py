"""Which hosts of an address answer: a computer that is dead answers nothing, and each attempt to connect to it would
take two seconds, for as long as it is dead."""

import selectors
import socket
from contextlib import ExitStack
from time import monotonic
from typing import NamedTuple

from psycopg.conninfo import conninfo_to_dict, make_conninfo

DEFAULT_PORT = "5432"


class HostPlace(NamedTuple):
    """A host of an address, as libpq takes it: a name, an address, or the folder of a local socket."""

    host: str
    port: str


def put_living_first(conninfo: str, limit_s: float) -> str:
    """The same address, its hosts that take connections before those that are silent or refuse. Takes `limit_s` at
    most, besides the resolution of names; nothing with one host."""
    places = _list_places(conninfo)
    if len(places) < 2:
        return conninfo
    living = _find_living(places, limit_s)
    places.sort(key=lambda place: place not in living)
    ordered = {"host": ",".join(place.host for place in places), "port": ",".join(place.port for place in places)}
    return make_conninfo(conninfo, **ordered)


def takes_connections(conninfo: str, limit_s: float) -> bool:
    """Whether one of the hosts takes a connection in time; True where that cannot be asked."""
    places = _list_places(conninfo)
    return not places or bool(_find_living(places, limit_s))


def _list_places(conninfo: str) -> list[HostPlace]:
    """The hosts; none where libpq has their addresses from elsewhere."""
    parts = conninfo_to_dict(conninfo)
    if "hostaddr" in parts or not parts.get("host"):
        return []
    hosts, ports = str(parts["host"]).split(","), str(parts.get("port") or DEFAULT_PORT).split(",")
    ports = ports if len(ports) > 1 else ports * len(hosts)
    return [HostPlace(host, port) for host, port in zip(hosts, ports, strict=True)]


def _find_living(places: list[HostPlace], limit_s: float) -> set[HostPlace]:
    """Those that take a connection in time. All are asked at once."""
    living = {place for place in places if place.host.startswith("/")}
    with ExitStack() as stack, selectors.DefaultSelector() as selector:
        for place in places:
            if place not in living and (asked := _ask(place)) is not None:
                selector.register(stack.enter_context(asked), selectors.EVENT_WRITE, place)
        until_s = monotonic() + limit_s
        while selector.get_map() and (left_s := until_s - monotonic()) > 0:
            for key, _ in selector.select(left_s):
                asked = key.fileobj
                selector.unregister(asked)
                assert isinstance(asked, socket.socket)
                if not asked.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                    living.add(key.data)
    return living


def _ask(place: HostPlace) -> socket.socket | None:
    """Begin to connect; None: it has no address."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            place.host, place.port or DEFAULT_PORT, type=socket.SOCK_STREAM
        )[0]
    except (OSError, UnicodeError):
        return None
    asked = socket.socket(family, kind, protocol)
    asked.settimeout(0)
    asked.connect_ex(address)
    return asked
