"""Simulated controllers without a fleet file, on a link of choice, for drivers other than those of Tutti."""

from collections.abc import Mapping
from typing import Any, Literal

from orchestrator.model.fleet import CanBusLink, Controller, Fleet, SerialLink, group_by_link
from orchestrator.model.jobs.files import parse_document
from orchestrator.model.links import Link, TcpLink, UdpLink
from orchestrator.runtime.checked import check_fleet
from orchestrator.runtime.example_fleet import MakeCount, make_example_fleet

LinkKind = Literal["tcp", "udp", "serial"]


def make_served_fleet(model: str, number: int, options: Mapping[str, Any]) -> Fleet:
    """A fleet of `number` controllers of one model, by the example of its make. options: of the simulator.

    Raises `ValueError` for an unknown model, `FileError` for a wrong option.
    """
    text = make_example_fleet([MakeCount(model, number)], f"sim-{model}", model)
    fleet = parse_document(text, Fleet, f"the example of {model}")
    controllers = {name: _with_options(config, options) for name, config in fleet.controllers.items()}
    return check_fleet(fleet.model_copy(update={"controllers": controllers}))


def _with_options(config: Controller, options: Mapping[str, Any]) -> Controller:
    simulate = config.simulate.model_copy(update={"options": {**config.simulate.options, **options}})
    return config.model_copy(update={"simulate": simulate})


def replace_links(fleet: Fleet, kind: LinkKind) -> Fleet:
    """The same controllers, each on a link of its own of `kind`. Raises `ValueError` for nodes of a CAN bus."""
    controllers: dict[str, Controller] = {}
    for number, (name, config) in enumerate(fleet.controllers.items(), 1):
        if isinstance(config.link, CanBusLink):
            raise ValueError(f"{name} is on a CAN bus, which is served at a serial CAN adapter (slcan) only")
        controllers[name] = config.model_copy(update={"link": _make_link(kind, number, config.link)})
    return fleet.model_copy(update={"controllers": controllers})


def _make_link(kind: LinkKind, number: int, present: Link) -> Link:
    """Where it really is, the simulator says when it listens."""
    if kind == "tcp":
        return TcpLink(host="127.0.0.1", port=number)
    if kind == "udp":
        return UdpLink(kind="udp", host="127.0.0.1", port=number)
    settings = present.to_plain() if isinstance(present, SerialLink) else {}
    return SerialLink.model_validate({**settings, "kind": "serial", "device": str(number), "address": None})


def describe_links(fleet: Fleet) -> list[dict[str, Any]]:
    """Where the simulated controllers of a fleet listen: one entry per link."""
    links: list[dict[str, Any]] = []
    for names in group_by_link(fleet.controllers):
        link = fleet.controllers[names[0]].link_to_open.to_plain()
        link.pop("address", None)
        controllers = [
            {
                "name": name,
                "model": fleet.controllers[name].adapter,
                "address": getattr(fleet.controllers[name].link, "address", None),
                "motors": [motor for axis in fleet.controllers[name].axes.values() for motor in axis.motors],
            }
            for name in names
        ]
        links.append({**link, "controllers": controllers})
    return links
