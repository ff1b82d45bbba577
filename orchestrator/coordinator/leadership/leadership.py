"""The reign: epoch, fleet time and heartbeat of the coordinator, and how it finds out that it is over."""

import asyncio
from collections.abc import Callable

from pydantic import ValidationError

from orchestrator.bus.base import Bus, Declared, Priority, Sample
from orchestrator.bus.keys import Keys
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.clock.executor import Runs
from orchestrator.clock.fleet import FleetScale
from orchestrator.coordinator.journal.journal import Journal
from orchestrator.model.messages import Reign, TimeReply
from orchestrator.model.state import ControllerState

HEARTBEAT_NS = 100 * NS_PER_MS
LISTEN_NS = 600 * NS_PER_MS  # a living coordinator is heard within that


class AnotherReigns(Exception):
    """A coordinator lives in this fleet already. Says which, and what to do."""


class Throne:
    """Takes a reign and keeps it. `on_lost` is called, once, when a newer reign is heard."""

    def __init__(
        self, fleet: str, bus: Bus, keys: Keys, clock: Clock, journal: Journal, runs: Runs, new_id: Callable[[], str]
    ) -> None:
        self._fleet = fleet
        self._bus = bus
        self._keys = keys
        self._clock = clock
        self._journal = journal
        self._runs = runs
        self.coordinator = new_id()
        self.epoch = 0
        self.scale = FleetScale("", 0)
        self.over = False
        self.on_lost: Callable[[str], None] = lambda _: None
        self._heard: Reign | None = None
        self._seq = 0
        self._declared: list[Declared] = []
        self._beat: asyncio.Task[None] | None = None

    async def take(self, take_over: bool, vacant: bool = False) -> None:
        """Begin to reign. Raises `AnotherReigns` when somebody else does, unless `take_over`. vacant: nobody does, as
        it is known already."""
        self._declared.append(await self._bus.subscribe(self._keys.reign, self._hear))
        if not vacant:
            await sleep_ns(self._clock, LISTEN_NS)
        other = self._heard
        if other is not None and not take_over:
            await self.close()
            raise AnotherReigns(
                f"coordinator {other.coordinator[:8]} reigns in fleet {self._fleet} (epoch {other.epoch}); "
                "stop it first, or start with --take-over"
            )
        seen = 0 if other is None else other.epoch
        for payload in (await self._bus.request_all(self._keys.state(), b"", timeout_s=1.0)).values():
            try:
                seen = max(seen, ControllerState.model_validate_json(payload).epoch)
            except ValidationError:
                continue
        self.epoch = await self._runs(self._journal.take_epoch, seen)
        now_ns = self._clock.now_ns()
        scale_id = f"{self.epoch}-{self.coordinator[:8]}"
        scale_id, origin_ns = await self._runs(self._journal.scale, self._clock.kernel_id, now_ns, scale_id)
        self.scale = FleetScale(scale_id, origin_ns)
        self._declared.append(await self._bus.serve(self._keys.time, self._answer_time))
        self._beat = asyncio.get_running_loop().create_task(self._keep_beating())

    async def close(self) -> None:
        """Abdicate: no heartbeat any more."""
        if self._beat is not None:
            self._beat.cancel()
        for declared in self._declared:
            await declared.undeclare()
        self._declared.clear()

    def fleet_now_ns(self) -> int:
        return self.scale.fleet_ns(self._clock.now_ns())

    def reign(self) -> Reign:
        """The heartbeat as it would be put now."""
        return Reign(
            fleet=self._fleet,
            epoch=self.epoch,
            coordinator=self.coordinator,
            seq=self._seq,
            scale_id=self.scale.scale_id,
            kernel_id=self._clock.kernel_id,
            origin_host_ns=self.scale.origin_host_ns,
            utc=self._clock.utc(),
        )

    async def _keep_beating(self) -> None:
        while not self.over:
            self._seq += 1
            self._bus.put(self._keys.reign, self.reign().to_json(), Priority.EVENT)
            await sleep_ns(self._clock, HEARTBEAT_NS)

    def _hear(self, sample: Sample) -> None:
        try:
            heard = Reign.model_validate_json(sample.payload)
        except ValidationError:
            return
        if heard.coordinator == self.coordinator:
            return
        self._heard = heard
        if self.epoch and not self.over and heard.epoch >= self.epoch:
            self.over = True
            self.on_lost(f"coordinator {heard.coordinator[:8]} reigns with epoch {heard.epoch}; mine was {self.epoch}")

    async def _answer_time(self, _: Sample) -> bytes:
        return TimeReply(scale_id=self.scale.scale_id, fleet_ns=self.fleet_now_ns()).to_json()
