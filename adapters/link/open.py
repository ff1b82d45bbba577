"""Opening of a link of the fleet file."""

from adapters.link.can import open_can
from adapters.link.serial import open_serial
from adapters.link.tcp import open_tcp
from adapters.link.udp import open_udp
from orchestrator.clock.base import Clock
from orchestrator.link.base import Link, LinkRefused, OpenLink
from orchestrator.link.direct import DirectLink
from orchestrator.model.fleet import Controller
from orchestrator.model.links import AnyLink, CanBusLink, InProcessLink, TcpLink, UdpLink
from orchestrator.model.plugins import load_plugin


def make_controller_opener(config: Controller, clock: Clock) -> OpenLink:
    """Return a function that opens a further link to a controller with each call. One with a link of the kind `process`
    is built here, and lasts as long as the function."""
    link = config.link_to_open
    if not isinstance(link, InProcessLink):
        return make_link_opener(link, clock)
    far_end = load_plugin("tutti.simulators", config.adapter, ("build_inside",)).build_inside(clock, config)

    async def open_direct_link() -> Link:
        return DirectLink(link.endpoint, clock, far_end)

    return open_direct_link


def make_link_opener(model: AnyLink, clock: Clock) -> OpenLink:
    """Return a function that opens a further link to the controller at `model` with each call. Raises `LinkRefused` for
    a controller that is in another process."""

    async def open_new_link() -> Link:
        if isinstance(model, TcpLink):
            return await open_tcp(model, clock)
        if isinstance(model, UdpLink):
            return await open_udp(model, clock)
        if isinstance(model, CanBusLink):
            return await open_can(model, clock)
        if isinstance(model, InProcessLink):
            raise LinkRefused(f"{model.endpoint} is in the process of its adapter, and nowhere else")
        return open_serial(model, clock)

    return open_new_link
