"""Jobs for the axes of one controller: one at a time, where its axes cannot be in two jobs."""

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field

from integrations.whole_fleet import describe
from tutti import Job, JobReport, Move, QueueTerms, Refusal, Step, TaskOwner, Tutti, TuttiError, controller_of, running

GATHER_S = 0.005  # moves that are put one after the other by one client are one job
RETRY_S = 0.02  # between two attempts to send elsewhere a move that begins or ends just now
RENEW_S = 0.06

JobDone = Callable[[JobReport], None]


@dataclass(slots=True)
class _Wish:
    """A move that is asked for. speed: a fraction of the limits. ended: by its result, the text of what went wrong."""

    target: float
    speed: float
    ended: "asyncio.Future[str | None]" = field(default_factory=asyncio.Future)


class Lane:
    """What moves axes of one controller, or one axis that it moves by itself. gather_s: how long a move waits for those
    of other axes. on_done: called with the report of each job of moves that is done."""

    def __init__(self, tutti: Tutti, session: str, gather_s: float, on_done: JobDone) -> None:
        self._tutti = tutti
        self._terms = QueueTerms(session=session, now=True)
        self._gather_s = gather_s
        self._on_done = on_done
        self._lock = asyncio.Lock()
        self._changed = asyncio.Event()
        self._waiting: dict[str, _Wish] = {}
        self._alone: dict[str, _Wish] = {}  # that were refused together, and are tried one by one
        self._moving: dict[str, _Wish] = {}
        self._turns: set[str] = set()  # axes whose other operations wait for their turn
        self._tasks = TaskOwner()
        self._job_id = ""
        self._job_axes: list[str] = []
        self._stopped = ""  # the axis whose stop ends the present job

    def move(self, axis: str, target: float, speed: float) -> "asyncio.Future[str | None]":
        """Ask for a move of an axis; return what goes wrong, at its end. A stop ends it without an error."""
        wish = self._waiting[axis] = _Wish(target, speed)
        if len(self._waiting) == 1:
            self._tasks.spawn(self._run_waiting())
        return wish.ended

    def redirect(self, axis: str, target: float) -> bool:
        """Send an axis that is on a move, or waits for it, to another target; return false if it is on none."""
        wish = self._waiting.get(axis) or self._alone.get(axis) or self._moving.get(axis)
        if wish is None:
            return False
        wish.target = target
        self._changed.set()
        return True

    async def run(self, axis: str, step: Step) -> str | None:
        """Run another step of an axis; return what went wrong. A stop ends it without an error."""
        async with self._take_turn(axis) as is_stopped:
            return None if is_stopped else await self._run_job([axis], step)

    async def jog(self, axis: str, velocity: float, released: asyncio.Event) -> str | None:
        """Jog an axis (its unit/s) until it is released; return what went wrong."""
        try:
            async with self._take_turn(axis), self._tutti.manual_control([axis], what="jog by EPICS") as manual:
                if not released.is_set():
                    await manual.jog({axis: velocity})
                while not released.is_set():
                    with suppress(TimeoutError):
                        await asyncio.wait_for(released.wait(), RENEW_S)
                        break
                    await manual.renew_jog()
        except TuttiError as error:
            return describe(error)
        return None

    async def stop(self, axis: str) -> None:
        """Stop what this lane does with an axis; without that, the job that moves it."""
        wish = self._waiting.pop(axis, None) or self._alone.pop(axis, None)
        if wish is not None:
            wish.ended.set_result(None)
        elif axis in self._turns:
            self._turns.discard(axis)
        elif axis in self._job_axes:
            self._stopped = axis
            await self._cancel(axis, self._job_id)
        else:
            controller, _, name = axis.partition(".")
            state = (await self._tutti.status()).get(controller)
            if state is not None and state.axes[name].moving:
                await self._cancel(axis, state.job or "")

    async def _cancel(self, axis: str, job_id: str) -> None:
        """Cancel a job that moves an axis; if the coordinator does not answer, stop all controllers directly."""
        if not job_id:
            return
        try:
            await self._tutti.cancel_job(job_id)
        except Refusal as error:
            if error.code in ("no-coordinator", "no-answer", "several-servers"):
                await self._tutti.stop(known=[controller_of(axis)])

    @asynccontextmanager
    async def _take_turn(self, axis: str) -> AsyncGenerator[bool]:
        """Wait until nothing else goes on; whether the axis was stopped meanwhile."""
        self._turns.add(axis)
        async with self._lock:
            is_stopped = axis not in self._turns
            self._turns.discard(axis)
            yield is_stopped

    async def _run_waiting(self) -> None:
        await asyncio.sleep(self._gather_s)
        async with self._lock:
            wishes, self._waiting = self._waiting, {}
            error = await self._move(wishes) if wishes else None
            if error is not None and not self._job_id and len(wishes) > 1:  # refused, perhaps for one of them
                self._alone = wishes
                while self._alone:
                    axis = next(iter(self._alone))
                    wish = self._alone.pop(axis)
                    wish.ended.set_result(await self._move({axis: wish}))
            for axis, wish in wishes.items():
                if not wish.ended.done():
                    by_other = self._stopped not in ("", axis)
                    text = f"stopped with {self._stopped}: their controller moves them as one"
                    wish.ended.set_result(text if by_other else error)

    async def _move(self, wishes: dict[str, _Wish]) -> str | None:
        """Move axes until each is at its newest target; return what went wrong."""
        self._moving = dict(wishes)
        while True:
            targets = {axis: wish.target for axis, wish in wishes.items()}
            speed = {axis: wish.speed for axis, wish in wishes.items()}
            error = await self._run_job(list(wishes), Move(to=targets, speed=speed, sync="none"), targets)
            if error is not None or self._stopped or targets == {axis: wish.target for axis, wish in wishes.items()}:
                self._moving = {}
                return error

    async def _run_job(self, axes: list[str], step: Step, targets: dict[str, float] | None = None) -> str | None:
        """Run a job of one step; `targets` of a move become those that are asked for meanwhile."""
        self._job_axes, self._job_id, self._stopped = axes, "", ""
        try:
            name = f"{step.kind} {', '.join(axes)} by EPICS"[:120]
            self._job_id = (await self._tutti.enqueue_job(Job(name, [step]), None, self._terms)).id
            if self._stopped:
                await self._cancel(self._stopped, self._job_id)
            async with running(self._tutti.wait_for_job(self._job_id)) as ending:
                ending.add_done_callback(lambda _: self._changed.set())
                refusal = None if targets is None else await self._follow_targets(ending, targets)
                report = await ending
        except TuttiError as error:
            return describe(error)
        finally:
            self._job_axes = []
        if report.state == "done":
            self._stopped = ""
            self._on_done(report)
            return refusal
        return None if self._stopped else f"{report.name} is {report.state}: {report.reason}"

    async def _follow_targets(self, ending: asyncio.Task[JobReport], targets: dict[str, float]) -> str | None:
        """Send the present job to newer targets until it ends; return why a target was refused."""
        refusal: str | None = None
        while not ending.done():
            self._changed.clear()
            if ending.done():
                break
            newest_targets = {axis: wish.target for axis, wish in self._moving.items()}
            if newest_targets == targets or self._stopped:
                await self._changed.wait()
                continue
            try:
                await self._tutti.retarget_job(self._job_id, newest_targets)
                targets.update(newest_targets)
                refusal = None
            except Refusal as error:
                if error.code in ("not-running", "not-moving", "ended"):
                    await asyncio.wait([ending], timeout=RETRY_S)
                else:
                    targets.update(newest_targets)
                    refusal = describe(error)
        return refusal
