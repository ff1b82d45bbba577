"""A standby that was stopped itself has received nothing: that is no silence of others."""

import asyncio
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from orchestrator.bus.base import BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.leadership.leadership import LEADER_TIMEOUT_NS
from orchestrator.coordinator.leadership.standby import wait_for_vacancy
from orchestrator.model.messages import HEARTBEAT_NS, LeaderHeartbeat

REIGN = LeaderHeartbeat(
    fleet="demo",
    epoch=1,
    coordinator="c1",
    seq=1,
    scale_id="s",
    kernel_id="k",
    origin_host_ns=0,
    utc="2026-01-01T00:00:00Z",
)
BEAT = BusSample("tutti/v1/demo/leader", REIGN.to_json())
STOPPED_NS = 2 * NS_PER_S


class Drowsy:
    """A clock whose process is stopped once: timers that are due meanwhile fire when it continues."""

    def __init__(self, clock: VirtualClock, from_ns: int) -> None:
        self._clock = clock
        self._from_ns, self.until_ns = from_ns, from_ns + STOPPED_NS

    def now_ns(self) -> int:
        return self._clock.now_ns()

    def call_at_ns(self, at_ns: int, callback: Callable[[], None], leeway_ns: int = 0) -> object:
        at_ns = self.until_ns if self._from_ns < at_ns < self.until_ns else at_ns
        return self._clock.call_at_ns(at_ns, callback, leeway_ns)


def test_a_standby_that_was_stopped_listens_before_it_takes_over() -> None:
    async def main(clock: VirtualClock) -> None:
        subscribed: list[Callable[[BusSample], None]] = []

        async def subscribe(_: str, callback: Callable[[BusSample], None]) -> Any:
            subscribed.append(callback)
            return SimpleNamespace(undeclare=lambda: asyncio.sleep(0))

        drowsy: Any = Drowsy(clock, NS_PER_S)

        async def request(*_: object) -> bytes:
            return REIGN.to_json()

        bus: Any = SimpleNamespace(subscribe=subscribe, request=request)
        standing = asyncio.ensure_future(wait_for_vacancy(bus, FleetKeys("demo"), drowsy))
        # Its bus wakes some time after it: the heartbeats of the time between are gone.
        for _ in range(50):
            await sleep_ns(clock, HEARTBEAT_NS)
            if not NS_PER_S < clock.now_ns() <= drowsy.until_ns + 50 * NS_PER_MS:
                subscribed[0](BEAT)
        assert not standing.done()
        last_ns = clock.now_ns()
        await standing
        assert LEADER_TIMEOUT_NS <= clock.now_ns() - last_ns <= LEADER_TIMEOUT_NS + HEARTBEAT_NS

    run_virtual(main)


def test_silence_alone_is_not_enough_while_the_lease_is_held() -> None:
    async def main(clock: VirtualClock) -> None:
        subscribed: list[Callable[[BusSample], None]] = []

        async def subscribe(_: str, callback: Callable[[BusSample], None]) -> Any:
            subscribed.append(callback)
            return SimpleNamespace(undeclare=lambda: asyncio.sleep(0))

        async def request(*_: object) -> bytes:
            return REIGN.to_json()

        is_over = True
        bus: Any = SimpleNamespace(subscribe=subscribe, request=request)
        standing = asyncio.ensure_future(wait_for_vacancy(bus, FleetKeys("demo"), clock, lambda: is_over))
        # Over at the beginning, as where there was no leader; then one begins.
        for _ in range(20):
            await sleep_ns(clock, HEARTBEAT_NS)
            subscribed[0](BEAT)
        is_over = False
        await sleep_ns(clock, 3 * NS_PER_S)
        assert not standing.done()
        # A leader that is received holds it, whatever the lease is.
        subscribed[0](BEAT)
        is_over = True
        await sleep_ns(clock, LEADER_TIMEOUT_NS - HEARTBEAT_NS)
        assert not standing.done()
        await sleep_ns(clock, 2 * HEARTBEAT_NS)
        assert standing.done()

    run_virtual(main)
