"""Controllers with a serial port only, reached over TCP by a serial bridge."""

from dataclasses import replace

from orchestrator.clock.base import NS_PER_S
from orchestrator.link.memory import LAN, WireModel
from orchestrator.model.fleet import Controller
from sim.core.controller import Port

USUAL_BAUD = 38400


def bridge_baud(config: Controller) -> int:
    """Of the serial side, if there is one: the option of the makes that are reached so."""
    return int(config.options.get("bridge_baud", USUAL_BAUD))


def network(config: Controller, far: Port) -> WireModel:
    """The wire to `far` in virtual time. A bridge hands bytes on as quickly as its serial side takes them."""
    if config.link.kind in far.ports:
        return LAN
    return replace(LAN, char_ns=10 * NS_PER_S // bridge_baud(config))
