"""Endpoints of routers in text, checked before Zenoh gets them."""

import re

from orchestrator.bus.hosts_live import Host
from orchestrator.model.errors import TuttiError
from orchestrator.model.text.addresses import check_host

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"  # of the router that `tutti up` starts
MAX_ENDPOINTS = 8
MAX_SOCKET_PATH = 107  # bytes, of `sun_path` on Linux (unix(7))

_NETWORK = re.compile(r"(?:tcp|tls|udp|quic|ws)/(\[[0-9a-fA-F:%.]+\]|[^\s/:,]+):(\d{1,5})")
_CONNECTED = ("tcp/", "tls/", "ws/")
_SOCKET = "unixsock-stream/"
_LOCAL = re.compile(rf"{_SOCKET}[^\s,]+")
_LOOPBACK = re.compile(r"127\.\d+\.\d+\.\d+|localhost|\[::1\]")
_FORM = "write PROTOCOL/HOST:PORT, e.g. tcp/127.0.0.1:7447"


class BadEndpoint(TuttiError, ValueError):
    """A text that is not an endpoint. The message names it and the form of one."""


def check_endpoint(text: str) -> str:
    """Return `text`, e.g. `tcp/127.0.0.1:7447`; several, of which one is used at a time, are separated by commas.
    Raises `BadEndpoint`."""
    split_endpoints(text)
    return text


def split_endpoints(text: str) -> list[str]:
    """The endpoints in `text`, in its order. Raises `BadEndpoint`."""
    endpoints = text.split(",")
    for endpoint in endpoints:
        match = _parse(endpoint)
        if not _LOCAL.fullmatch(endpoint) and (match is None or not 0 < int(match[2]) < 65_536):
            raise BadEndpoint(f"{endpoint!r} is not an endpoint; {_FORM}")
        if match is not None:
            _check_host(endpoint, match[1])
    if len(endpoints) > MAX_ENDPOINTS:
        raise BadEndpoint(f"{len(endpoints)} endpoints; at most {MAX_ENDPOINTS} routers are tried")
    return endpoints


def _check_host(endpoint: str, host: str) -> None:
    try:
        check_host(host)
    except ValueError as error:
        raise BadEndpoint(f"{endpoint}: {error}") from None


def is_private(endpoint: str) -> bool:
    """Whether no other computer reaches a router that listens there: a loopback address, or a socket in a folder."""
    match = _parse(endpoint)
    return is_socket(endpoint) if match is None else _LOOPBACK.fullmatch(match[1]) is not None


def find_host(endpoint: str) -> Host | None:
    """Where the router takes connections; None: it takes datagrams, and cannot be asked."""
    match = _parse(endpoint)
    if match is None:
        return Host(socket_path(endpoint))
    return Host(match[1].strip("[]"), match[2]) if endpoint.startswith(_CONNECTED) else None


def uses_tls(endpoint: str) -> bool:
    """Whether a session there needs certificates."""
    return endpoint.startswith("tls/")


def is_socket(endpoint: str) -> bool:
    """Whether it is a Unix socket."""
    return endpoint.startswith(_SOCKET)


def describe_openness(text: str) -> str:
    """What is to be said of a bus that other computers reach without certificates; "" where they do not."""
    open_ones = [endpoint for endpoint in split_endpoints(text) if not (is_private(endpoint) or uses_tls(endpoint))]
    if not open_ones:
        return ""
    return f"INSECURE: the bus at {', '.join(open_ones)} has no TLS; everything that reaches it can move this fleet"


def make_socket_endpoint(path: str) -> str:
    """The endpoint of a Unix socket at an absolute path. Raises `BadEndpoint` for a path that cannot stand in one."""
    if len(path.encode()) > MAX_SOCKET_PATH:
        raise BadEndpoint(f"{path} is too long for a socket: at most {MAX_SOCKET_PATH} bytes")
    return check_endpoint(f"{_SOCKET}{path}")


def socket_path(endpoint: str) -> str:
    """The path of a Unix socket."""
    return endpoint.removeprefix(_SOCKET)


def _parse(endpoint: str) -> re.Match[str] | None:
    return _NETWORK.fullmatch(endpoint.partition("?")[0].partition("#")[0])
