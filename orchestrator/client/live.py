"""A live job: a program moves axes step by step, and has them for itself meanwhile.

async with tutti.live(["gantry", "stage.u"], name="alignment") as live:
    for x in range(10):
        await live.move({"gantry.x": x, "stage.u": x / 2})
"""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from itertools import accumulate
from typing import Any, Literal, Self

from orchestrator.client.armed import ArmedMove
from orchestrator.client.attendance import Attendance
from orchestrator.client.continuing import RestRequests
from orchestrator.client.live_follow import LiveFollower
from orchestrator.client.live_verbs import LiveVerbs
from orchestrator.client.results import JobResult
from orchestrator.client.steps import JobFailed, make_move
from orchestrator.model.errors import Refusal, TuttiError
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.live import AskLive, LiveAsked, require_room
from orchestrator.model.jobs.service import JobReference
from orchestrator.model.messages import Reply
from orchestrator.model.paths.files.steps import read_path_steps
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import StepReport
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.live import Live
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.steps.wait_armed import WaitArmed

ANSWER_S = 10.0  # a path is checked before it is accepted


class StepFailed(TuttiError):
    """A step of a live job that was not done; the live job goes on, unless it has moved. report: of the step."""

    def __init__(self, report: StepReport) -> None:
        super().__init__(f"{report.do} is {report.state}: {report.reason}")
        self.report = report


class LiveJob(LiveVerbs):
    """A live job; use it as a context, which begins and ends it. It has its axes for itself from beginning to end, and
    is one job in the journal, with a row for each move. It ends with this program: also when that is interrupted,
    suspended or killed, or loses its connection, its axes stop within a second.

    A step that is refused before anything moves raises `Refusal`, and the live job goes on. One that fails in motion
    raises `StepFailed`, and ends the live job, as a stop, an e-stop or a lost permit does: `JobFailed`.
    """

    def __init__(
        self,
        requests: RestRequests,
        job: Job,
        speed: float | str = "manual",
        *,
        wait: bool = False,
        is_alive: Callable[[], bool] = lambda: True,
    ) -> None:
        """job: with one live step. speed: of moves for which none is given. wait: for axes that are in use. is_alive:
        whether its user is still there, for a process that acts for users elsewhere."""
        self.id = ""
        self._requests = requests
        self._job = job
        self._speed = speed
        self._terms = QueueTerms(now=not wait)
        self._attendance = Attendance(requests, is_alive)
        self._follower: LiveFollower | None = None

    def __repr__(self) -> str:
        state = "not begun" if not self.id else "ended" if self.result is not None else "running"
        return f"<LiveJob {self._job.name!r} {self.id} {state}>"

    @property
    def result(self) -> JobResult | None:
        """The record of the job; None while it runs."""
        return None if self._follower is None else self._follower.result

    @property
    def axes(self) -> list[str]:
        """The axes, groups and controllers that it was begun with."""
        return self._job.steps[0].named_axes

    # Beginning and end

    async def __aenter__(self) -> Self:
        await self.begin()
        return self

    async def __aexit__(self, *error: object) -> None:
        if not error or error[0] is None:
            await self.end()
        else:
            await self.cancel()

    async def begin(self) -> None:
        """Begin: its axes are this program's when this returns. Raises `Refusal`, and `JobFailed` if it is refused
        then."""
        if self.id:
            raise Refusal("ended", f"live job {self.id} was begun already", "begin another one: `tutti.live(...)`")
        requests = self._requests
        await self._attendance.__aenter__()
        try:
            terms = self._terms.model_copy(update={"session": self._attendance.session})
            self.id = (await requests.enqueue_job(self._job, None, terms)).id
            self._follower = LiveFollower(requests, self.id)
            await self._follower.open()
            if not await self._follower.wait_until_begun():
                raise self._make_end()
        except BaseException:
            await self._close()
            raise

    async def end(self) -> JobResult:
        """End it behind the steps that were asked for, and return its record. Raises `JobFailed` if it was not done.
        May be called twice."""
        follower = self._require_begun()
        try:
            if follower.result is None:
                with suppress(Refusal):  # it has ended by itself
                    await self._requests.request_service("end-live", self._make_reference(), Reply)
            result = await follower.load_result()
        except BaseException:
            await self.cancel()
            raise
        await self._close()
        if result.state != "done":
            raise JobFailed(result)
        return result

    async def cancel(self) -> None:
        """Stop its axes and end it. Raises nothing: without a connection it ends within a second."""
        follower = self._follower
        if follower is None or follower.result is not None:
            return
        with suppress(Refusal, TimeoutError):
            async with asyncio.timeout(ANSWER_S):
                await self._requests.cancel_job(self.id)
                await follower.load_result()
        await self._close()

    # Steps, each until it is done

    async def move(
        self,
        to: Mapping[str, int | float | str] | str | None = None,
        by: Mapping[str, int | float | str] | None = None,
        *,
        speed: float | str | Mapping[str, float | str] | None = None,
        sync: Literal["time", "phase", "none"] = "time",
        replace: bool = False,
    ) -> StepReport:
        """Move axes together, as `Tutti.move` does; the report has where each was read behind it, `positions`. Raises
        `Refusal`, `StepFailed`, `JobFailed`.

        replace: if these axes are on a move, send them to the new targets instead: it is one step, with an entry for
        each target in `retargets`, and both calls return its report. The speed stays that of the move."""
        move = self.make_move(to, by, speed=speed, sync=sync)
        if replace:
            try:
                reply = await self._requests.retarget_job(self.id, move.to, by=move.by)
            except Refusal as error:
                if error.code != "not-moving":
                    raise
            else:
                return await self.wait_for(reply.step or 0)
        return await self.run(move)

    async def run(self, step: Step) -> StepReport:
        """Run one step, and return its report when it is done; a cancelled task stops it. Raises as `move` does."""
        try:
            (number,) = await self.submit(step)
            return await self.wait_for(number)
        except asyncio.CancelledError:
            await self.stop()
            raise

    # Steps ahead

    def make_move(
        self,
        to: Mapping[str, int | float | str] | str | None = None,
        by: Mapping[str, int | float | str] | None = None,
        *,
        speed: float | str | Mapping[str, float | str] | None = None,
        sync: Literal["time", "phase", "none"] = "time",
    ) -> Move:
        """A move for `submit`, at the speed of this live job if none is given. Raises `WrongValue`."""
        return make_move(to, by, self._speed if speed is None else speed, sync)

    async def submit(self, *steps: Step) -> list[int]:
        """Ask for steps, up to 100 ahead, and return their numbers when they are accepted: moves are then chained, each
        loaded while the one before it moves. None is accepted if one is refused. Raises `Refusal`: codes `ended`,
        `too-many`, `not-of-job`, and those of a check; and `FileError`."""
        follower = self._require_begun()
        prepared_steps = read_path_steps(Job.model_construct(steps=list(steps))).steps
        parts = [list(step.iterate_written()) for step in prepared_steps]  # a file that stops on its way is several
        asked_steps: list[Any] = [part for group in parts for part in group]
        if not asked_steps:
            return []
        require_room(0, len(asked_steps))
        request = AskLive(**self._requests.request_fields(), job_id=self.id, steps=asked_steps)
        try:
            reply = await self._requests.request_service("ask-live", request, LiveAsked, ANSWER_S)
        except Refusal as error:
            if error.code != "ended":
                raise
            await follower.load_result()
            raise self._make_end() from None
        return [reply.numbers[end - 1] for end in accumulate(map(len, parts))]

    async def arm(
        self,
        step: Move | FollowPath,
        *,
        input: str | None = None,
        level: bool = False,
        timeout_s: float = 60.0,
    ) -> ArmedMove:
        """Plan and load a move or a path in all its controllers, and return when it waits for `go`. It is refused if
        its budget does not hold.

        input: `controller.input`, which starts it too when it becomes active; level: also if it is active already,
        which is refused otherwise. timeout_s: the end of the wait. Raises as `move` does."""
        wait = WaitArmed(input=input, level=level, timeout=f"{timeout_s:.9f} s")
        number = (await self.submit(wait, step))[-1]
        follower = self._require_begun()
        armed_state = await follower.wait_until_armed(number)
        if armed_state is None and follower.has_ended(number):
            await self.wait_for(number)  # raises why it does not wait, unless its input has started it at once
        return ArmedMove(self._requests, self, self.id, number, armed_state)

    async def wait_for(self, number: int) -> StepReport:
        """Wait until a submitted step is done, and return its report; those of the last 200 are kept. Raises as `move`
        does."""
        report = await self._require_begun().wait_for_report(number)
        if report is None:
            await self._close()
            raise self._make_end()
        if report.state == "done":
            return report
        if report.refused is not None:
            raise report.refused.as_error()
        raise StepFailed(report)

    async def stop(self) -> None:
        """Stop its axes by their ramps and forget the steps that wait; the live job goes on. Raises nothing: a program
        without a connection ends its live job."""
        if self._follower is not None and self.result is None:
            with suppress(Refusal):
                await self._requests.request_service("stop-live", self._make_reference(), Reply)

    # Inside

    def _make_reference(self) -> JobReference:
        return JobReference(**self._requests.request_fields(), job_id=self.id)

    def _require_begun(self) -> LiveFollower:
        if self._follower is None:
            remedy = "use it as a context: `async with tutti.live(...) as live:`"
            raise Refusal("not-begun", "the live job was not begun", remedy)
        return self._follower

    def _make_end(self) -> TuttiError:
        """Why no step can be done any more."""
        if self.result is not None and self.result.state != "done":
            return JobFailed(self.result)
        return Refusal("ended", f"live job {self.id} has ended", "begin another one: `tutti.live(...)`")

    async def _close(self) -> None:
        if self._follower is not None:
            await self._follower.close()
        await self._attendance.__aexit__()


class LiveRequests(RestRequests):
    """Begin live jobs."""

    def live(
        self,
        axes: Sequence[str] | str | Job,
        *,
        name: str = "live",
        speed: float | str = "manual",
        gather: str = "0 ms",
        wait: bool = False,
    ) -> LiveJob:
        """A live job, which begins when its context is entered: `async with tutti.live(["gantry.x"]) as live:`.

        axes: that it may move, as axes, groups or controllers; nothing else moves them while it lasts. Or a job with
        one `Live` step, which may state skews, and outputs of other controllers. speed: of its moves, as in `move`.
        gather: moves of different axes that are asked for within this time are one synchronised move. wait: for axes
        that are in use; otherwise that is refused. Raises `WrongValue`.
        """
        if isinstance(axes, Job):
            return LiveJob(self, axes, speed, wait=wait)
        step = Live(axes=[axes] if isinstance(axes, str) else list(axes), gather=gather)
        return LiveJob(self, Job(name, [step]), speed, wait=wait)
