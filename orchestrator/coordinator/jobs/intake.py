"""Where jobs come in: new ones, and ended ones that are to be done again; and where old ones are forgotten."""

from collections.abc import Callable
from datetime import timedelta

from orchestrator.coordinator.jobs.job_run import Works
from orchestrator.coordinator.jobs.queue import axes_of
from orchestrator.coordinator.jobs.scheduler import LATE, Runner
from orchestrator.coordinator.jobs.steps import check_job
from orchestrator.coordinator.journal import journal
from orchestrator.coordinator.motion.targets import Refuse
from orchestrator.model.base import UnknownName
from orchestrator.model.job import Job, Move, Step
from orchestrator.model.messages import Refusal
from orchestrator.model.queue import MOST_STEPS, Terms, format_utc, parse_utc
from orchestrator.model.report import ENDED
from orchestrator.model.service import Again, AgainReply, AxisNow, Prune, Submit, Submitted
from orchestrator.model.step_words import step_words

WORDS = 20  # remaining steps that are said in words


class Office:
    """Takes jobs for `runner`."""

    def __init__(self, works: Works, runner: Runner, new_id: Callable[[], str]) -> None:
        self._works = works
        self._runner = runner
        self._new_id = new_id

    async def submit(self, request: Submit) -> Submitted:
        """Take a job: it is in the journal when this returns, or refused."""
        try:
            check_job(self._works.view.fleet, list(request.job.steps))
            _check_length(request.job, request.terms)
            await self._check_terms(request.terms, request.client_key)
        except Refuse as error:
            return Submitted(refused=error.refusal)
        return await self._accept(request.client_key, request.job, request.terms, None)

    async def again(self, request: Again) -> AgainReply:
        """Take an ended job again, from a step on; or say what that would mean."""
        works = self._works
        row = await works.runs(works.journal.row, request.job_id)
        job = await works.runs(works.journal.job, request.job_id)
        if row is None or job is None:
            text = f"no job {request.job_id}"
            return AgainReply(refused=Refusal(code="unknown-job", text=text, remedy="see `tutti job ls`"))
        if row.state not in ENDED:
            text = f"job {row.id} is {row.state}; only one that has ended can be done again"
            return AgainReply(refused=Refusal(code="not-ended", text=text, remedy="wait for its end, or cancel it"))
        terms = request.terms or Terms(repeat=row.repeat)
        all_steps = job.steps * terms.repeat
        steps = all_steps[request.from_step :]
        try:
            if not steps:
                text = f"job {row.id} has the steps 0 to {len(all_steps) - 1}"
                raise Refuse("no-step", text, "name one of them as --from-step")
            check_job(works.view.fleet, list(job.steps))
            _check_length(job, terms)
            await self._check_terms(terms, request.client_key)
            axes = axes_of(works.view.fleet, steps)
        except Refuse as error:
            return AgainReply(refused=error.refusal)
        except UnknownName as error:
            return AgainReply(refused=Refusal(code="unknown-name", text=str(error), remedy="see `tutti axis ls`"))
        reply = AgainReply(
            steps=[f"{n} {step_words(step)}" for n, step in enumerate(steps[:WORDS], request.from_step)],
            axes=[self._now(axis) for axis in axes],
            warnings=_warnings(request.from_step, steps),
        )
        if request.dry_run:
            return reply
        fresh = job.model_copy(update={"actor": request.actor})
        taken = await self._accept(request.client_key, fresh, terms, journal.Again(row.id, request.from_step))
        return reply.model_copy(update={"job_id": taken.job_id, "entry": taken.entry})

    async def prune(self, request: Prune) -> int:
        """Forget old jobs; how many."""
        works = self._works
        before = parse_utc(works.clock.utc()) - timedelta(seconds=request.older_s)
        gone = await works.runs(works.journal.prune, format_utc(before), request.keep)
        works.log.info(f"{gone} jobs submitted before {format_utc(before)} are forgotten, told so by {request.actor}")
        return gone

    # Inside

    async def _accept(self, client_key: str, job: Job, terms: Terms, again: journal.Again | None) -> Submitted:
        works = self._works
        job_id, fresh = await works.runs(
            works.journal.accept, self._new_id()[:8], client_key, job, works.clock.utc(), terms, again
        )
        row = await works.runs(works.journal.row, job_id)
        assert row is not None
        if fresh:
            works.log.info(f"accepted {job.name!r} from {job.actor}", job=job_id)
            await self._runner.enter(row, job)
        return Submitted(job_id=job_id, entry=self._runner.entry(row))

    async def _check_terms(self, terms: Terms, client_key: str) -> None:
        """Raises `Refuse` for a time that is past, and for a job to come after that can not be done any more; but a
        request that is repeated gets the answer that it had."""
        works = self._works
        if await works.runs(works.journal.knows, client_key):
            return
        now = parse_utc(works.clock.utc())
        if terms.at is not None and terms.missed == "skip" and parse_utc(terms.at) < now - LATE:
            raise Refuse(
                "past", f"{terms.at} is past; it is {format_utc(now)}", "give a later time, or say `missed: run`"
            )
        if terms.after is not None:
            row = await works.runs(works.journal.row, terms.after)
            if row is None:
                raise Refuse("unknown-job", f"no job {terms.after} to come after", "see `tutti job ls`")
            if row.state in ENDED and row.state != "done":
                raise Refuse(
                    "not-done", f"job {row.id} is {row.state} and will not be done any more", "come after another"
                )

    def _now(self, axis: str) -> AxisNow:
        controller, _, name = axis.partition(".")
        state, unit = self._works.view.state(controller), self._works.view.fleet.axis(axis).unit
        if state is None or self._works.view.silent(controller) or state.mode == "offline" or name not in state.axes:
            return AxisNow(axis=axis, unit=unit, position=None)
        now = state.axes[name]
        return AxisNow(axis=axis, unit=now.unit, position=now.position, enabled=now.enabled, referenced=now.referenced)


def _check_length(job: Job, terms: Terms) -> None:
    steps = len(job.steps) * terms.repeat
    if steps > MOST_STEPS:
        raise Refuse(
            "too-long",
            f"{len(job.steps)} steps {terms.repeat} times are {steps}; {MOST_STEPS} are possible",
            "repeat it less often, or submit several jobs",
        )


def _warnings(first: int, steps: list[Step]) -> list[str]:
    """What an axis that stands somewhere on its way means for the steps."""
    absolute: set[str] = set()
    for number, step in enumerate(steps, first):
        if isinstance(step, Move):
            relative = [axis for axis in step.by if axis not in absolute]
            absolute |= set(step.to) | set(step.by)
            if relative:
                return [f"step {number} moves {', '.join(relative)} by a distance, from where it stands now"]
    return []
