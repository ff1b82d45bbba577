"""A job that was submitted: follow it, have its result, act on it."""

import asyncio
from collections.abc import AsyncGenerator
from typing import TYPE_CHECKING, Self

from orchestrator.bus.base import Sample
from orchestrator.model.report import ENDED, JobReport, Progress, Transition
from orchestrator.model.service import JobShown

if TYPE_CHECKING:
    from orchestrator.client.api import Tutti

LOOK_S = 1.0  # how often the journal is read while the bus is silent


class SubmittedJob(str):
    """The id of a job, by which it can be followed; as text it can be written down and given to other processes,
    which get the same from `tutti.job(id)`."""

    _tutti: "Tutti"

    def __new__(cls, job_id: str, tutti: "Tutti") -> Self:
        job = super().__new__(cls, job_id)
        job._tutti = tutti
        return job

    @property
    def id(self) -> str:
        """The id as plain text."""
        return str(self)

    async def events(self) -> AsyncGenerator[Transition | Progress]:
        """Every change of its state from the beginning on, each once, by the journal; and its progress in between, as
        the bus has it. Ends with the job. Raises `Refused` for a job that does not exist.

        A coordinator that is away meanwhile is waited for.
        """
        told = 0
        heard: asyncio.Queue[Sample] = asyncio.Queue()
        subscription = await self._tutti.bus.subscribe(self._tutti.keys.job_state(self), heard.put_nowait)
        try:
            progress: Progress | None = None
            while True:
                changes = (await self._tutti.show_when_there(self)).transitions
                for change in changes[told:]:
                    yield change
                    if change.state in ENDED:
                        return
                told = len(changes)
                if progress is not None and progress.state not in ENDED:
                    yield progress
                progress = await self._next(heard)
        finally:
            await subscription.undeclare()

    async def result(self) -> JobReport:
        """Its report, once it has ended. Raises `Refused` for a job that does not exist."""
        return await self._tutti.wait(self)

    async def show(self) -> JobShown:
        """Everything the journal has of it. Raises `Refused`."""
        return await self._tutti.show(self)

    async def cancel(self) -> None:
        """Cancel it, queued or running. Raises `Refused`."""
        await self._tutti.cancel(self)

    async def hold(self) -> None:
        """Keep it from beginning. Raises `Refused`: code `not-queued`."""
        await self._tutti.hold(self)

    async def release(self) -> None:
        """Let it begin when it is its turn. Raises `Refused`."""
        await self._tutti.release(self)

    async def pause(self, now: bool = False) -> None:
        """Hold it when its present step has ended, or `now` inside a motion step; it keeps its axes. Raises `Refused`:
        `not-running`."""
        await self._tutti.pause(self, now)

    async def resume(self) -> None:
        """Go on with it. Raises `Refused`: codes `not-running`, `not-paused`."""
        await self._tutti.resume(self)

    async def _next(self, heard: "asyncio.Queue[Sample]") -> Progress | None:
        """The newest progress that the bus has; None after a while without."""
        try:
            async with asyncio.timeout(LOOK_S):
                sample = await heard.get()
        except TimeoutError:
            return None
        while not heard.empty():
            sample = heard.get_nowait()
        return Progress.model_validate_json(sample.payload)
