"""Controllers with only a serial port, reached over TCP by a serial bridge."""

from dataclasses import replace

from orchestrator.clock.base import NS_PER_S
from orchestrator.link.memory import LAN, WireModel
from orchestrator.model.fleet import Controller
from sim.core.controller import LineEndpoint

DEFAULT_BAUD = 38400


def bridge_baud(config: Controller) -> int:
    """Return the baud rate of the bridge's serial side (an option of the makes that are reached this way), or 0
    without one."""
    return int(config.options.get("bridge_baud", DEFAULT_BAUD))


def network_wire(config: Controller, far: LineEndpoint) -> WireModel:
    """Return the connection to `far` in virtual time. A bridge forwards bytes at the speed of its serial side."""
    if config.link.kind in far.port_names:
        return LAN
    return replace(LAN, char_ns=10 * NS_PER_S // bridge_baud(config))
