"""Endpoints of routers in text, checked before Zenoh gets them."""

import re

from orchestrator.model.errors import TuttiError

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"  # of the router that `tutti up` starts

_NETWORK = re.compile(r"(?:tcp|tls|udp|quic|ws)/(?:\[[0-9a-fA-F:%.]+\]|[^\s/:]+):(\d{1,5})")
_LOCAL = re.compile(r"unixsock-stream/\S+")


class BadEndpoint(TuttiError, ValueError):
    """A text that is not an endpoint. The message names it and the form of one."""


def check_endpoint(text: str) -> str:
    """Return `text`, e.g. `tcp/127.0.0.1:7447`. Raises `BadEndpoint`."""
    found = _NETWORK.fullmatch(text.partition("?")[0].partition("#")[0])
    if _LOCAL.fullmatch(text) or (found is not None and 0 < int(found[1]) < 65_536):
        return text
    raise BadEndpoint(f"{text!r} is not an endpoint; write PROTOCOL/HOST:PORT, e.g. tcp/127.0.0.1:7447")
