"""A live job of one socket: it is asked for steps by frames, and ends with the socket."""

import asyncio
import contextlib
from collections.abc import Mapping
from typing import Any, cast

from pydantic import TypeAdapter, ValidationError

from orchestrator.client import Tutti
from orchestrator.client.live import LiveJob, StepFailed
from orchestrator.client.steps import JobFailed
from orchestrator.clock.owner import TaskOwner
from orchestrator.gateway.access.refusals import describe_refusal
from orchestrator.gateway.stream.socket import Frame, Handler, UserSocket
from orchestrator.gateway.stream.step_fields import fill_speed, refuse_fields
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import StepReport
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.live import AskedStep

_STEPS: TypeAdapter[list[AskedStep]] = TypeAdapter(list[AskedStep])


class LiveActs:
    """The live job of a socket. tutti: with the actor of its user."""

    def __init__(self, socket: UserSocket, tutti: Tutti) -> None:
        self.handlers: Mapping[str, Handler] = {
            "live-begin": self._begin,
            "live-ask": self._ask,
            "live-stop": self._stop,
            "live-end": self._end,
        }
        self._socket, self._tutti = socket, tutti
        self._live: LiveJob | None = None
        self._tasks = TaskOwner()

    async def close(self) -> None:
        """Stop what it moves, and end it."""
        live, self._live = self._live, None
        if live is not None:
            await live.cancel()
        self._tasks.cancel_all()

    async def _begin(self, frame: Frame) -> dict[str, Any]:
        """`axes`, and as wanted `outputs`, `gather`, `name`, and skews of the job."""
        self._socket.identity.require_right("ask-live")
        if self._live is not None and self._live.result is None:
            text = f"live job {self._live.id} of this socket runs"
            raise Refusal("busy", text, "end it by `live-end`, or open another socket")
        live = LiveJob(self._tutti, _make_job(frame), is_alive=lambda: self._socket.is_alive)
        self._live = live
        try:
            await live.begin()
        except BaseException:
            self._live = None
            raise
        self._tasks.spawn(self._report_end(live))
        return {"job_id": live.id}

    async def _ask(self, frame: Frame) -> dict[str, Any]:
        """`steps`, as a job file has them; the answer has the number of each, and a frame `live` what became of it."""
        live = self._require_live()
        numbers = await live.submit(*_read_steps(frame.get("steps")))
        for number in dict.fromkeys(numbers):
            self._tasks.spawn(self._report_step(live, number))
        return {"numbers": numbers}

    async def _stop(self, _: Frame) -> dict[str, Any]:
        await self._require_live().stop()
        return {}

    async def _end(self, _: Frame) -> dict[str, Any]:
        """End it behind the steps that wait; a frame `live` has its end."""
        self._tasks.spawn(self._finish(self._require_live()))
        return {}

    async def _finish(self, live: LiveJob) -> None:
        with contextlib.suppress(JobFailed, Refusal):
            await live.end()

    async def _report_step(self, live: LiveJob, number: int) -> None:
        try:
            report: StepReport | None = await live.wait_for(number)
        except StepFailed as error:
            report = error.report
        except JobFailed:
            return  # its end is reported
        except Refusal as error:
            self._socket.send({"live": {"number": number, "state": "failed", "refused": describe_refusal(error)}})
            return
        fields = {"state": report.state, "reason": report.reason, "verdict": report.verdict}
        positions = {axis: position.to_plain() for axis, position in report.positions.items()}
        self._socket.send({"live": {"number": number, **fields, "positions": positions}})

    async def _report_end(self, live: LiveJob) -> None:
        report = await self._tutti.wait_for_job(live.id)
        # What became of its last steps comes first.
        await asyncio.sleep(0)
        self._socket.send({"live": {"ended": report.state, "job_id": live.id, "reason": report.reason}})

    def _require_live(self) -> LiveJob:
        if self._live is None:
            raise Refusal("not-begun", "this socket has no live job", "begin one by `live-begin`")
        return self._live


def _make_job(frame: Frame) -> Job:
    """The job that a frame asks for. Raises `Refusal`."""
    step = {"do": "live", **{name: frame[name] for name in ("axes", "outputs", "gather") if name in frame}}
    fields = {name: frame[name] for name in ("max_start_skew", "max_end_skew", "max_path_skew") if name in frame}
    try:
        return Job.model_validate(
            {"schema": "tutti.job/1", "name": frame.get("name", "live"), **fields, "steps": [step]}
        )
    except ValidationError as error:
        raise refuse_fields(error, 'for example `{"do": "live-begin", "axes": ["gantry"]}`') from None


def _read_steps(value: object) -> list[Step]:
    """The steps of a frame. Raises `Refusal`."""
    entries = cast(list[object], value) if isinstance(value, list) else []
    steps = [fill_speed(cast(Frame, entry)) if isinstance(entry, dict) else entry for entry in entries]
    if not steps:
        raise Refusal("bad-request", "`steps` must be a list of steps", "see the steps of job files")
    try:
        return list(_STEPS.validate_python(steps))
    except ValidationError as error:
        raise refuse_fields(error) from None
