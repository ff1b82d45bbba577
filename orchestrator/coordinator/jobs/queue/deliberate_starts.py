"""Deliberate starts: jobs that had to wait for a cause begin only by a word for the first motion that was shown.

The mark is in the journal (`held_by`), so that another leader asks as well.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace

from orchestrator.clock.base import sleep_ns
from orchestrator.coordinator.jobs.queue.conditions import Obstacle, WorldConditions
from orchestrator.coordinator.jobs.queue.ends import RETRY_NS
from orchestrator.coordinator.jobs.queue.queue_order import Condition, QueueLimits, Schedule, WaitingJob, choose_jobs
from orchestrator.coordinator.jobs.queue.register import JobRegister
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.model.base import UnknownName
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.restart import RESTART, FirstMotion, StartPreview

MOVES_NOTHING = "moves nothing"


class DeliberateStarts:
    """Marks the jobs of the queue that had to wait for a cause, and takes the word for their start."""

    def __init__(self, services: JobServices, register: JobRegister, conditions: WorldConditions) -> None:
        self._services = services
        self._register = register
        self._conditions = conditions

    def choose(self, stopped: str) -> Schedule:
        """The jobs that may begin now. stopped: why the queue is stopped."""
        return self._choose_from(self._register.list_waiting(), stopped)

    def _choose_from(self, order: Iterable[WaitingJob], stopped: str) -> Schedule:
        register = self._register
        queue = ((job, register.find_needs(job).controllers) for job in order)
        limits = QueueLimits(stopped, register.count_free_places(), register.find_lent())
        return choose_jobs(queue, register.find_busy(), self._find_condition, limits)

    def _find_condition(self, waiting: WaitingJob) -> Condition | None:
        obstacle = self._conditions.find_obstacle(self._register.find_needs(waiting))
        return None if obstacle is None else Condition(obstacle.describe(), obstacle.asks)

    async def mark_jobs(self, causes: Mapping[str, str]) -> None:
        """These jobs, which wait for a cause, begin only by a word from now on. The journal is tried until it can be
        written; until then only this leader asks."""
        services = self._services
        marked_jobs = [job for job_id in causes if (job := self._register.waiting.get(job_id)) and not job.row.held_by]
        for job in marked_jobs:
            job.row = job.row._replace(held_by=RESTART, reason=f"waits for: {causes[job.row.id]}")
        for job in marked_jobs:
            while job.awaits_word and self._register.waiting.get(job.row.id) is job:
                change = services.make_transition("queued", job.row.reason, "coordinator")
                try:
                    await services.execute(services.journal.hold_jobs, [job.row.id], RESTART, change)
                    break
                except JournalError as error:
                    services.log.warning(f"not recorded yet that its start is asked for: {error}", job=job.row.id)
                    await sleep_ns(services.clock, RETRY_NS)

    def describe_cause(self, job_id: str) -> str:
        """What a job that was just accepted waits for before anything else: a cause that lasts; empty: none."""
        job = self._register.waiting.get(job_id)
        if job is None or job.blocking_reason:
            return ""
        obstacle = self._conditions.find_obstacle(self._register.find_needs(job))
        if obstacle is None or self._has_job_ahead(job):
            return ""
        return f"waits for: {obstacle.describe()}" + "; then its start has to be asked for" * obstacle.asks

    # The word

    def preview_start(self) -> StartPreview:
        """What would move first if the queue was started, with the word for all jobs whose cause is gone."""
        order = self._register.list_waiting()
        asked_jobs = [replace(job, row=job.row._replace(held_by="")) if job.awaits_word else job for job in order]
        choice = self._choose_from(asked_jobs, "")
        begin_ids = {job.row.id for job in choice.begin}
        # Also those that have not met their cause yet, because the queue is stopped.
        causes = {job.row.id: self._find_cause(job) for job in order if job.awaits_word or job.row.id in choice.causes}
        return StartPreview.of(
            [self._find_first_motion(job) for job in order if job.row.id in begin_ids],
            [self._describe_lasting(job, causes[job.row.id]) for job in order if causes.get(job.row.id)],
        )

    def preview_release(self, jobs: Collection[WaitingJob]) -> StartPreview:
        """What these jobs would move first, if they were released."""
        causes = {job.row.id: self._find_cause(job) if job.awaits_word else "" for job in jobs}
        return StartPreview.of(
            [self._find_first_motion(job) for job in jobs if not causes[job.row.id]],
            [self._describe_lasting(job, causes[job.row.id]) for job in jobs if causes[job.row.id]],
        )

    async def start_jobs(self, actor: str, shown: str) -> None:
        """Take the word for what a preview of the start has shown. Raises `Refusal` if something else would move now,
        `JournalError`."""
        if not shown:
            return
        self._require_shown(self.preview_start(), shown)
        for job in [job for job in self._register.list_waiting() if job.awaits_word and not self._find_cause(job)]:
            await self._register.clear_hold(job, f"its start was asked for by {actor}", actor)

    def require_release(self, jobs: Collection[WaitingJob], shown: str) -> None:
        """Raise `Refusal` unless the first motions of these jobs were shown, and their causes are gone."""
        asking_jobs = [job for job in jobs if job.awaits_word]
        for job in asking_jobs:
            cause = self._find_cause(job)
            if cause:
                text = f"job {job.row.id} waits for: {cause}"
                raise Refusal("cause-lasts", text, "remove the cause first; then look at what moves, and release it")
        if asking_jobs:
            self._require_shown(self.preview_release(jobs), shown)

    def _require_shown(self, preview: StartPreview, shown: str) -> None:
        if preview.shown != shown:
            motions = "; ".join(f"{motion.name!r}: {motion.text}" for motion in preview.motions) or "nothing"
            text = f"what moves first was not shown, or has changed since; now it is {motions}"
            raise Refusal("not-shown", text, "look at it again, then give the word: `tutti queue start`")

    def _find_cause(self, job: WaitingJob) -> str:
        """The cause that lasts for a job; empty: none. Behind another job, whose steps may enable and home, the state
        of its axes is no cause."""
        obstacle: Obstacle | None = self._conditions.find_obstacle(self._register.find_needs(job))
        if obstacle is None or (obstacle.code in ("not-enabled", "not-referenced") and self._has_job_ahead(job)):
            return ""
        return obstacle.describe()

    def _has_job_ahead(self, job: WaitingJob) -> bool:
        needs = self._register.find_needs(job).controllers
        if any(run.needs & needs for run in self._register.running.values()):
            return True
        order = self._register.list_waiting()
        return any(self._register.find_needs(job_ahead).controllers & needs for job_ahead in order[: order.index(job)])

    def _find_first_motion(self, job: WaitingJob) -> FirstMotion:
        row, services = job.row, self._services
        cause = row.reason.removeprefix("waits for: ") if job.awaits_word else ""
        text, axes = MOVES_NOTHING, list[str]()
        try:
            resolver = services.positions.make_resolver()
            order = resolver.resolve_remaining(job.job.steps, row.repeat, row.from_step)
            for remaining in order.list_remaining(row.from_step):
                if remaining.step.moves:
                    text = f"{order.locate(remaining.first).describe(kinds=False)}: {remaining.step.describe()}"
                    axes = list(remaining.step.find_axes(services.view.fleet))
                    break
        except (Refusal, UnknownName) as error:
            text = f"not known: {error}"
        return FirstMotion(job_id=row.id, name=row.name, text=text, axes=axes, cause=cause)

    def _describe_lasting(self, job: WaitingJob, cause: str) -> FirstMotion:
        return self._find_first_motion(job).model_copy(update={"cause": cause})
