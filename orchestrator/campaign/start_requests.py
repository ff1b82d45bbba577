"""A program that starts the steps that wait armed, some time after each wait has begun."""

from contextlib import suppress
from random import Random

from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.model.errors import Refusal

_LOOK_NS = 100 * NS_PER_MS


class StartRequests:
    """Sends `go`, in vain if something has ended the wait."""

    def __init__(self, client: Tutti, clock: Clock, draw: Random) -> None:
        self._client = client
        self._clock = clock
        self._draw = draw

    async def run(self, after_ns: tuple[int, int]) -> None:
        """Look for waits, and end each. after_ns: when, after it was seen, earliest and latest."""
        while True:
            await sleep_ns(self._clock, _LOOK_NS)
            with suppress(Refusal):
                armed_jobs = (await self._client.list_jobs(state="armed")).jobs
                if armed_jobs:
                    await sleep_ns(self._clock, self._draw.randint(*after_ns))
                    await self._client.go_job(armed_jobs[0].id)
