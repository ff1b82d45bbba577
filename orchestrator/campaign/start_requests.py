"""A program that starts the steps that wait armed, some time after each wait has begun."""

from collections.abc import Collection
from contextlib import suppress
from random import Random

from orchestrator.campaign.recorder import Stage
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.owner import TaskOwner
from orchestrator.model.errors import Refusal
from orchestrator.runtime.virtual.fleet import VirtualFleet

_LOOK_NS = 100 * NS_PER_MS
_GO_NS = (500 * NS_PER_MS, 4 * NS_PER_S)  # from when a wait was seen to `go`, earliest and latest


class StartRequests:
    """Sends `go` from now on, if one of `stages` has such steps; in vain if something has ended the wait."""

    def __init__(self, fleet: VirtualFleet, seed: int, stages: Collection[Stage]) -> None:
        self._fleet = fleet
        self._draw = Random(seed)
        self._tasks = TaskOwner()
        if "armed-waiting" in stages:
            self._tasks.spawn(self._run())

    def end(self) -> None:
        """Look for waits no more."""
        self._tasks.cancel_all()

    async def _run(self) -> None:
        client = self._fleet.make_client("starter")
        while True:
            await sleep_ns(self._fleet.clock, _LOOK_NS)
            with suppress(Refusal):
                armed_jobs = (await client.list_jobs(state="armed")).jobs
                if armed_jobs:
                    await sleep_ns(self._fleet.clock, self._draw.randint(*_GO_NS))
                    await client.go_job(armed_jobs[0].id)
