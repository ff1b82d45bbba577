"""What becomes of a live job and its steps, as its program follows them."""

import asyncio
from contextlib import suppress

from orchestrator.bus.base import BusDeclaration, BusSample
from orchestrator.client.jobs import POLL_S
from orchestrator.client.results import JobResult
from orchestrator.client.steps import StepRequests
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.live import KEPT_RESULTS, LiveRead, LiveResult, ReadLive
from orchestrator.model.report import FINISHED_STATES, ArmedState, JobProgress, StepReport


class LiveFollower:
    """Follows live job `job_id`: by what is published, and by asking while that is silent. result: once it has
    ended."""

    def __init__(self, requests: StepRequests, job_id: str) -> None:
        self.result: JobResult | None = None
        self._requests = requests
        self._job_id = job_id
        self._declared: list[BusDeclaration] = []
        self._results: dict[int, StepReport] = {}
        self._progress: JobProgress | None = None
        self._changed = asyncio.Event()

    async def open(self) -> None:
        """Follow it from now on."""
        requests = self._requests
        for key, receive in (
            (requests.keys.job_live(self._job_id), self._receive_result),
            (requests.keys.job_state(self._job_id), self._receive_progress),
        ):
            self._declared.append(await requests.bus.subscribe(key, receive))

    async def close(self) -> None:
        """Follow it no longer. May be called twice."""
        declarations, self._declared = self._declared, []
        for declaration in declarations:
            await declaration.undeclare()

    async def wait_until_begun(self) -> bool:
        """Wait until it runs; return whether it does, and has not ended. Raises `Refusal`."""
        while self._progress is None or self._progress.state != "running":
            if self._is_over:
                await self.load_result()
                return False
            if not await self._wait_for_change():
                await self._read_state()
        return True

    async def wait_for_report(self, number: int) -> StepReport | None:
        """Wait for the report of a step, and keep it; None: the job has ended without it. Raises `Refusal`."""
        while number not in self._results and not self._is_over:
            if not await self._wait_for_change():
                await self._read_result(number)
        if number not in self._results:
            await self.load_result()
        return self._results.get(number)

    async def wait_until_armed(self, number: int) -> ArmedState | None:
        """Wait until step `number` waits armed, and return on which terms; None: it has ended, or moves. Raises
        `Refusal`."""
        while number not in self._results and not self._is_over:
            progress = self._progress
            is_present = progress is not None and progress.step == number
            if progress is not None and is_present and (progress.armed is not None or progress.state == "committed"):
                return progress.armed
            if not await self._wait_for_change():
                await self._read_state()
                await self._read_result(number)
        return None

    def has_ended(self, number: int) -> bool:
        """Whether step `number` has ended, or its job."""
        return number in self._results or self._is_over

    async def load_result(self) -> JobResult:
        """Wait for the end of the job, and load its record. Raises `Refusal`."""
        if self.result is None:
            report = await self._requests.wait_for_job(self._job_id)
            self.result = await self._requests.load_result(report)
            await self.close()
        return self.result

    @property
    def _is_over(self) -> bool:
        return self.result is not None or (self._progress is not None and self._progress.state in FINISHED_STATES)

    async def _wait_for_change(self) -> bool:
        """Wait until something is published; return false if that takes too long."""
        self._changed.clear()
        try:
            async with asyncio.timeout(POLL_S):
                await self._changed.wait()
        except TimeoutError:
            return False
        return True

    async def _read_state(self) -> None:
        """Ask for the state of the job: what was published is lost, or the coordinator is away."""
        shown_job = await self._requests.show_job_when_available(self._job_id)
        self._progress = shown_job.progress or self._progress
        if shown_job.report is not None:
            await self.load_result()

    async def _read_result(self, number: int) -> None:
        """Ask for the report of a step: what was published may be lost."""
        request = ReadLive(**self._requests.request_fields(), job_id=self._job_id, number=number)
        try:
            reply = await self._requests.request_service("read-live", request, LiveRead)
        except Refusal:
            await self._read_state()
            return
        if reply.result is not None:
            self._results[number] = reply.result.report

    def _receive_result(self, sample: BusSample) -> None:
        with suppress(ValueError):  # not of the coordinator
            result = LiveResult.read_message(sample.payload)
            self._results[result.number] = result.report
            while len(self._results) > KEPT_RESULTS:
                del self._results[min(self._results)]
            self._changed.set()

    def _receive_progress(self, sample: BusSample) -> None:
        with suppress(ValueError):
            progress = JobProgress.read_message(sample.payload)
            if progress.follows(self._progress):
                self._progress = progress
                self._changed.set()
