"""Hand-over to a standby, at rest: nothing is interrupted, and the queue goes on."""

import asyncio

from orchestrator.bus.base import BusDeclaration
from orchestrator.bus.keys import STANDBY
from orchestrator.clock.base import NS_PER_MS
from orchestrator.coordinator.jobs.queue.scheduler import Scheduler
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.service import HandedOver
from orchestrator.model.messages import Request
from orchestrator.model.state import RESTING_MODES

ANSWERED_NS = 50 * NS_PER_MS  # for the answer to be on its way before this coordinator leaves


class HandOver:
    """Lets this coordinator leave for a standby."""

    def __init__(self, services: JobServices, scheduler: Scheduler) -> None:
        self._services = services
        self._scheduler = scheduler
        self._standbys: set[str] = set()
        self._declared: list[BusDeclaration] = []
        self.is_left = asyncio.Event()
        """Set when this coordinator is to end."""

    async def start(self) -> None:
        """Know the standbys from now on."""
        bus, keys = self._services.bus, self._services.keys
        self._declared = [await bus.watch(keys.live("coordinator", None, STANDBY), self._note_standby)]

    async def close(self) -> None:
        for declaration in self._declared:
            await declaration.undeclare()

    async def answer(self, request: Request) -> HandedOver:
        """Answer `svc/hand-over`. Raises `Refusal`; then nothing has changed."""
        self._require_standby()
        self._require_rest()
        self._scheduler.is_leaving = True  # from here on no job begins
        self._services.log.warning(f"handed over to a standby by {request.actor}")
        clock = self._services.clock
        clock.call_at_ns(clock.now_ns() + ANSWERED_NS, self.is_left.set)
        return HandedOver(standbys=sorted(self._standbys))

    def _note_standby(self, key: str, present: bool) -> None:  # noqa: FBT001 - a callback
        name = key.split("/")[-2]
        if present:
            self._standbys.add(name)
        else:
            self._standbys.discard(name)

    def _require_standby(self) -> None:
        if not self._standbys:
            raise Refusal(
                "no-standby",
                "no standby waits for the leadership",
                "start one: `tutti coordinator FILE --standby`, or `tutti up --standby`",
            )

    def _require_rest(self) -> None:
        services = self._services
        running_ids = sorted(self._scheduler.register.running)
        if running_ids:
            raise Refusal("busy", f"job {running_ids[0]} runs", "wait for its end, or stop it")
        for hold in services.leases.all_leases:
            text = f"{', '.join(hold.axes[:3])} is in use by {hold.actor} ({hold.what})"
            raise Refusal("leased", text, "wait for the end of that use")
        for controller in services.view.fleet.controllers:
            state = services.view.last_state(controller)
            if state is not None and not services.view.is_silent(controller) and state.mode not in RESTING_MODES:
                raise Refusal("moving", f"{controller} is {state.mode}", "wait until it is at rest", controller)
