"""Opening of a link of the fleet file."""

from adapters.link.can import open_can
from adapters.link.serial import open_serial
from adapters.link.tcp import open_tcp
from adapters.link.udp import open_udp
from orchestrator.clock.base import Clock
from orchestrator.link.base import Link, OpenLink
from orchestrator.model.fleet import CanBusLink, TcpLink, UdpLink
from orchestrator.model.fleet import Link as LinkModel


def make_link_opener(model: LinkModel, clock: Clock) -> OpenLink:
    """Return a function that opens a further link to the controller at `model` with each call."""

    async def open_new_link() -> Link:
        if isinstance(model, TcpLink):
            return await open_tcp(model, clock)
        if isinstance(model, UdpLink):
            return await open_udp(model, clock)
        if isinstance(model, CanBusLink):
            return await open_can(model, clock)
        return open_serial(model, clock)

    return open_new_link
