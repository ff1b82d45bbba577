"""Adapter hosts that are slow to start, as their guardians say."""

from orchestrator.bus.base import Bus, BusDeclaration
from orchestrator.bus.keys import FleetKeys
from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.clock.start_limit import SLOW_NS


class SlowStarts:
    """Follows the hosts that are slow to start."""

    def __init__(self, bus: Bus, keys: FleetKeys, clock: Clock) -> None:
        self._bus, self._keys, self._clock = bus, keys, clock
        self._begun_ns: dict[str, int] = {}
        """By host: when its start began."""
        self._watch: BusDeclaration | None = None

    async def start(self) -> None:
        """Follow them from now on."""
        self._watch = await self._bus.watch(self._keys.slow_start(), self._receive)

    async def close(self) -> None:
        """End it."""
        if self._watch is not None:
            await self._watch.undeclare()

    def describe(self, host: str) -> str | None:
        """That a host is slow to start, and for how long, in steps of ten seconds; None: it is not."""
        begun_ns = self._begun_ns.get(host)
        if begun_ns is None:
            return None
        return f"its adapter is starting slowly ({(self._clock.now_ns() - begun_ns) // (10 * NS_PER_S) * 10} s)"

    def _receive(self, key: str, present: bool) -> None:  # noqa: FBT001 - a callback
        host = key.split("/")[-2]
        if present:
            self._begun_ns[host] = self._clock.now_ns() - SLOW_NS
        else:
            self._begun_ns.pop(host, None)
