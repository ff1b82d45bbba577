"""Adapter hosts of the campaign on computers of their own: with other clocks, and a network in between."""

from random import Random

from orchestrator.bus.memory.network import NetworkPath
from orchestrator.clock.base import NS_PER_S, NS_PER_US
from orchestrator.clock.crystal import ComputerClock
from orchestrator.clock.virtual import VirtualClock
from orchestrator.model.fleet import Fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

OFFSET_S = 2000
DRIFT_PPM = 50.0
DELAYS_NS = (100 * NS_PER_US, 1000 * NS_PER_US)
"""Of one direction; each of a computer's two directions has its own."""
LOSS = 0.002


def make_computers(fleet: Fleet, clock: VirtualClock, seed: int) -> dict[str, ComputerClock]:
    """Draw a computer for each adapter host, with a clock of its own."""
    draw = Random(f"computers {seed}")
    return {
        host: ComputerClock(
            clock, host, round(draw.uniform(1, OFFSET_S) * NS_PER_S), draw.uniform(-DRIFT_PPM, DRIFT_PPM)
        )
        for host in fleet.hosts
    }


def connect_computers(virtual: VirtualFleet, seed: int) -> None:
    """Draw the network between the computers of a fleet."""
    draw = Random(f"network {seed}")
    for computer in virtual.computers:
        to, way_back = (NetworkPath(draw.randint(*DELAYS_NS), draw.randint(*DELAYS_NS), LOSS) for _ in range(2))
        virtual.net.network.set_path(computer, to=to, back=way_back)
