"""Faults of the bus between an adapter host and others."""

from collections.abc import Sequence
from contextvars import Context
from random import Random

from orchestrator.bus.memory.router import MemoryRouter
from orchestrator.campaign.injection.repairs import Repair
from orchestrator.clock.base import NS_PER_MS
from orchestrator.clock.virtual import VirtualClock
from orchestrator.runtime.virtual.fleet import VirtualFleet

# How long one direction stays closed, from shortest to longest: longer than its detection takes, or shorter.
PARTITION_NS = (1200 * NS_PER_MS, 2000 * NS_PER_MS)
GAP_NS = (20 * NS_PER_MS, 450 * NS_PER_MS)


class BusFaults:
    """Injects faults of the bus of one fleet."""

    def __init__(self, fleet: VirtualFleet, clock: VirtualClock, draw: Random) -> None:
        self._net = fleet.net
        self._clock = clock
        self._draw = draw

    def inject_fault(self, fault: str, host: str, coordinator: str) -> Repair:
        """Inject a fault between two processes, by their names on the bus; return its repair."""
        match fault:
            case "bus-cut":
                self._net.partition_net({host}, {coordinator})
                return self._net.heal_partition
            case "one-way-partition" | "one-way-gap":
                way = (host, coordinator) if self._draw.random() < 0.5 else (coordinator, host)
                lasts_ns = self._draw.randint(*(PARTITION_NS if fault == "one-way-partition" else GAP_NS))
                return self._block_way(*way, lasts_ns)
            case "nothing-forwarded":
                return self._block_way(None, host)
            case _:  # bus-loss
                self._net.set_loss(host, self._draw.choice((0.3, 0.7, 1.0)))
                return lambda: self._net.set_loss(host, 0.0)

    def inject_fleet_fault(self, fault: str, coordinator: str, hosts: Sequence[str]) -> Repair:
        """Hang the router, or cut the coordinator off all adapter hosts, in both directions or in one of them; return
        the repair."""
        if fault == "router-hung":
            router = MemoryRouter(self._net)
            router.hang()
            return router.restart
        if (way := self._draw.choice(("both", "to", "from"))) == "both":
            self._net.partition_net({coordinator}, set(hosts))
            return self._net.heal_partition
        lasts_ns = self._draw.randint(*PARTITION_NS)
        ends = [(host, coordinator) if way == "to" else (coordinator, host) for host in hosts]
        opened_ways = [self._block_way(*end, lasts_ns) for end in ends]

        def open_all() -> None:
            for reopen_way in opened_ways:
                reopen_way()

        return open_all

    def _block_way(self, sender: str | None, receiver: str, lasts_ns: int | None = None) -> Repair:
        """Block one direction, for `lasts_ns` or until the repair."""

        def open_way() -> None:
            self._net.open_way(sender, receiver)

        self._net.block_way(sender, receiver)
        if lasts_ns is not None:
            self._clock.call_at_ns(self._clock.now_ns() + lasts_ns, open_way, context=Context())
        return open_way
