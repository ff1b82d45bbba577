"""What the program of a live job requests: steps, what became of them, and the end of the job."""

from collections.abc import Awaitable, Callable, Mapping
from itertools import accumulate
from typing import Any

from orchestrator.coordinator.jobs.check import check_job
from orchestrator.coordinator.jobs.intake.path_intake import split_paths
from orchestrator.coordinator.jobs.queue.register import JobRegister
from orchestrator.coordinator.jobs.run.job_run import JobRun
from orchestrator.coordinator.jobs.run.live_sequence import LiveSequence
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.model.base import Model
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.live import AskLive, LiveAsked, LiveRead, ReadLive
from orchestrator.model.jobs.service import JobReference
from orchestrator.model.messages import Reply
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.live import Live
from orchestrator.model.steps.order import RemainingStep


class LiveIntake:
    """Passes steps on to the live jobs of the leader. handlers: by verb; they raise `Refusal` and `JournalError`."""

    def __init__(self, services: JobServices, register: JobRegister) -> None:
        self.handlers: Mapping[str, Callable[[Any], Awaitable[Model]]] = {
            "ask-live": self._ask_steps,
            "read-live": self._read_result,
            "stop-live": self._stop_steps,
            "end-live": self._end_job,
        }
        self._services = services
        self._register = register

    async def _ask_steps(self, request: AskLive) -> LiveAsked:
        """Check steps, wherever the axes will be then, and add them to those that wait. None is added if one is
        refused."""
        _, live_steps = await self._find_live(request.job_id)
        resolver = self._services.positions.make_resolver()
        groups: list[list[Step]] = []
        for number, step in enumerate(request.steps):
            self._require_own(live_steps.live, step)
            groups.append(await self._prepare_step(resolver.resolve_step(step), number))
        numbers = live_steps.ask_steps([step for group in groups for step in group])
        # A path that rests on its way is several: the last one stands for it.
        return LiveAsked(numbers=[numbers[end - 1] for end in accumulate(map(len, groups))])

    async def _read_result(self, request: ReadLive) -> LiveRead:
        """What became of a step."""
        _, live_steps = await self._find_live(request.job_id)
        return LiveRead(result=live_steps.find_result(request.number))

    async def _end_job(self, request: JobReference) -> Reply:
        """Let a live job end behind the steps that it was asked for."""
        _, live_steps = await self._find_live(request.job_id)
        live_steps.end()
        return Reply()

    async def _stop_steps(self, request: JobReference) -> Reply:
        """Stop what a live job moves, and forget what it was asked for; it goes on."""
        run, live_steps = await self._find_live(request.job_id)
        reason = f"stopped by {request.actor}"
        live_steps.stop(reason)
        await run.stop_motion(reason, request.actor)
        return Reply()

    async def _find_live(self, job_id: str) -> tuple[JobRun, LiveSequence]:
        run = self._register.running.get(job_id)
        if run is None:
            raise await self._register.make_refusal(job_id, "not-running", "a live job takes moves while it runs")
        if run.live_steps is None:
            text = f"job {job_id} is no live job: its steps are fixed"
            raise Refusal("not-live", text, "begin a live job from a program, as with `tutti.live(...)`")
        return run, run.live_steps

    def _require_own(self, live: Live, step: Step) -> None:
        foreign = live.find_foreign(step, self._services.view.fleet)
        if foreign:
            own = ", ".join(live.axes)
            text = f"{', '.join(foreign)} is not of this live job, which was begun with {own}"
            raise Refusal("not-of-job", text, "name it when the live job is begun")

    async def _prepare_step(self, step: Step, number: int) -> list[Step]:
        """Step `number` of a request as it runs: checked, and as several where it is a path that rests on its way."""
        services = self._services
        job = await split_paths(services, Job.model_construct(steps=[step]))
        steps = [part for entry in job.steps for part in entry.iterate_written()]
        remaining = [RemainingStep(number, number, part) for part in steps]
        await check_job(services.view.fleet, remaining, services.motion.plan, services.check)
        return steps
