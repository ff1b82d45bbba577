"""What a socket does in the fleet: stops, manual control with jogs, one-step jobs, and a live job."""

import asyncio
import contextlib
import sys
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, cast

from pydantic import ValidationError

from orchestrator.client import Tutti
from orchestrator.client.attendance import Attendance
from orchestrator.client.manual import ManualControl
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.clock.owner import TaskOwner
from orchestrator.gateway.access.refusals import describe_refusal
from orchestrator.gateway.stream.live_acts import LiveActs
from orchestrator.gateway.stream.socket import Frame, Handler, UserSocket
from orchestrator.gateway.stream.step_fields import fill_speed, refuse_fields
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.job import Job
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import JobProgress, JobReport

LEASE_S = 2.0
LOOK_NS = 200 * NS_PER_MS  # period of looking whether the user is still there
MAX_AXES = 64
WORK_STEPS = ("enable", "disable", "home", "move", "set-position", "output")

Stop = Callable[[str, Tutti, str], Awaitable[dict[str, Any]]]


class FleetActs:
    """The acts of one socket.

    tutti: with the actor of its user. stop: stops the fleet, by `stop` or `estop`, with a reason.
    """

    def __init__(self, socket: UserSocket, tutti: Tutti, clock: Clock, stop: Stop) -> None:
        self.handlers: Mapping[str, Handler] = {
            "stop": self._stop,
            "estop": self._estop,
            "acquire": self._acquire,
            "release": self._release,
            "jog": self._jog,
            "renew": self._renew,
            "work": self._work,
            "cancel-work": self._cancel_work,
            **(live := LiveActs(socket, tutti)).handlers,
        }
        self._live = live
        self._socket, self._tutti, self._clock, self._stop_fleet = socket, tutti, clock, stop
        self._manual: ManualControl | None = None
        self._named: list[str] = []
        self._jogged: dict[str, float] = {}
        self._running: asyncio.Task[None] | None = None
        self._tasks, self._watches = TaskOwner(), TaskOwner()

    async def close(self) -> None:
        """Stop what this socket moves, and give its axes back."""
        self._watches.cancel_all()
        if self._running is not None:
            self._running.cancel()
        await self._live.close()
        await self._end_manual()
        if tasks := self._tasks.pending:
            await asyncio.wait(tasks, timeout=LEASE_S)

    # Stops

    async def _stop(self, _: Frame) -> dict[str, Any]:
        return await self._stop_fleet("stop", self._tutti, "")

    async def _estop(self, frame: Frame) -> dict[str, Any]:
        reason = frame.get("reason", "")
        return await self._stop_fleet("estop", self._tutti, reason if isinstance(reason, str) else "")

    # Manual control

    async def _acquire(self, frame: Frame) -> dict[str, Any]:
        self._require("acquire-axes")
        axes = _read_axes(frame)
        await self._end_manual()
        manual = self._tutti.manual_control(axes, what="the operators' page", ttl_s=LEASE_S)
        await manual.acquire()
        if not self._socket.is_alive:
            await manual.release()
            raise Refusal("not-there", "the user has gone meanwhile", "acquire the axes again")
        self._manual, self._named = manual, axes
        self._watch()
        # Virtual axes are named beside the real ones that are leased for them.
        held_axes = list(dict.fromkeys([*(name for name in axes if "." in name), *manual.axes]))
        self._socket.send({"manual": {"axes": held_axes, "lost": None}})
        return {"axes": held_axes}

    async def _release(self, _: Frame) -> dict[str, Any]:
        await self._end_manual()
        self._socket.send({"manual": {"axes": [], "lost": None}})
        return {}

    async def _jog(self, frame: Frame) -> dict[str, Any]:
        self._require("jog")
        axis, velocity = frame.get("axis"), _read_velocity(frame)
        if not isinstance(axis, str) or velocity is None:
            raise Refusal("bad-request", "a jog needs an `axis`, and a `velocity` that is not 0", "for example 5.0")
        self._require_manual(axis)
        self._jogged = {axis: velocity}
        self._send_jog(renew=False)
        return {}

    async def _renew(self, frame: Frame) -> dict[str, Any]:
        """Renew the jog, also at another velocity: unlike `jog` it never moves an axis that has been stopped."""
        if not self._jogged:
            raise Refusal("not-jogging", "no axis is being jogged", "begin with `jog`")
        if "velocity" in frame:
            velocity = _read_velocity(frame)
            if velocity is None:
                text = "the `velocity` of a renewal must be a number that is not 0"
                raise Refusal("bad-request", text, "leave it out to keep the last one; end a jog by `end-jog`")
            self._jogged = dict.fromkeys(self._jogged, velocity)
        self._send_jog(renew=True)
        return {}

    def end_jog(self) -> None:
        """Stop the jog: the request is on its way when this returns to the event loop."""
        self._jogged = {}
        if self._manual is not None:
            self._tasks.spawn(self._stop_manual(self._manual))

    def _send_jog(self, *, renew: bool) -> None:
        """Pass a jog on; the frame is answered without waiting for the controller, which may take longer than the
        user's next frame."""
        if self._manual is not None:
            self._tasks.spawn(self._request_jog(self._manual, dict(self._jogged), renew=renew))

    async def _request_jog(self, manual: ManualControl, velocities: Mapping[str, float], *, renew: bool) -> None:
        try:
            await manual.request_jog(velocities, renew=renew)
        except Refusal as error:
            if self._jogged == velocities:
                self._jogged = {}
                axis = next(iter(velocities))
                self._socket.send({"jog": {"axis": axis, "refused": describe_refusal(error)}})

    async def _stop_manual(self, manual: ManualControl) -> None:
        try:
            await manual.stop()
        except Refusal as error:
            axis = next(iter(manual.axes), "")
            self._socket.send({"jog": {"axis": axis, "refused": describe_refusal(error)}})

    async def _end_manual(self) -> None:
        manual, self._manual, self._jogged = self._manual, None, {}
        if manual is not None:
            await manual.release()

    def _require_manual(self, axis: str) -> None:
        # Of virtual axes the lease has the real ones.
        if self._manual is None or axis not in {*self._manual.axes, *self._named}:
            raise Refusal("not-leased", f"{axis[:100]} is not under manual control of this page", "acquire it first")

    # One-step jobs

    async def _work(self, frame: Frame) -> dict[str, Any]:
        self._require("work")
        if self._running is not None and not self._running.done():
            raise Refusal("busy", "a one-step job of this page runs", "wait for its end, or stop it")
        job = _make_job(frame.get("step"))
        number = frame.get("id", 0)
        # Its own axes are in its way.
        await self._release(frame)
        self._running = self._tasks.spawn(self._run_work(number, job))
        self._watch()
        return {}

    async def _cancel_work(self, _: Frame) -> dict[str, Any]:
        if self._running is not None:
            self._running.cancel()
        return {}

    async def _run_work(self, number: object, job: Job) -> None:
        def show(state: str, **fields: Any) -> None:
            self._socket.send({"work": {"id": number, "state": state, **fields}})

        def show_progress(progress: JobProgress) -> None:
            show(progress.state, job_id=progress.job_id, reason=progress.reason, fraction=progress.fraction)

        tutti = self._tutti
        try:
            async with Attendance(tutti, lambda: self._socket.is_alive) as attendance:
                terms = QueueTerms(session=attendance.session, now=True)
                # Not cancelled while it is submitted: a job whose id is unknown cannot be stopped.
                submit = asyncio.get_running_loop().create_task(tutti.enqueue_job(job, None, terms))
                try:
                    report = await tutti.wait_for_job((await asyncio.shield(submit)).id, show_progress)
                except asyncio.CancelledError:
                    with contextlib.suppress(Refusal):
                        await tutti.cancel_job((await submit).id)
                    show("cancelled", reason="stopped on the page", remedy="")
                    raise
        except Refusal as error:
            show("failed", reason=error.text, remedy=error.remedy)
            return
        show(report.state, job_id=report.job_id, **_explain_end(report))

    # Inside

    def _require(self, verb: str) -> None:
        self._socket.identity.require_right(verb)

    def _watch(self) -> None:
        """Look whether the user is still there, as long as something depends on it."""
        if not self._watches.pending:
            self._watches.spawn(self._watch_user())

    async def _watch_user(self) -> None:
        while self._manual is not None or (self._running is not None and not self._running.done()):
            await sleep_ns(self._clock, LOOK_NS)
            manual = self._manual
            if not self._socket.is_alive:
                await self._end_manual()
                self._socket.send({"manual": {"axes": [], "lost": describe_refusal(_SILENT)}})
            elif manual is not None and manual.lost is not None:
                lost_refusal = describe_refusal(manual.lost)
                await self._end_manual()
                self._socket.send({"manual": {"axes": [], "lost": lost_refusal}})


_SILENT = Refusal("silent", "the page has sent nothing for a second, so its axes were released", "acquire them again")


def _read_velocity(frame: Frame) -> float | None:
    """The velocity of a frame, unit/s; None: it is no number, or 0."""
    velocity = frame.get("velocity")
    if isinstance(velocity, bool) or not isinstance(velocity, int | float) or not velocity:
        return None
    return float(velocity) if abs(velocity) <= sys.float_info.max else None


def _read_axes(frame: Frame) -> list[str]:
    axes = frame.get("axes")
    names = cast(list[object], axes) if isinstance(axes, list) else []
    if not 0 < len(names) <= MAX_AXES or not all(isinstance(name, str) for name in names):
        raise Refusal("bad-request", f"`axes` must be 1 to {MAX_AXES} names", 'for example `["gantry.x"]`')
    return [str(name) for name in names]


def _make_job(step: object) -> Job:
    """A job of one step. Raises `Refusal` for a step that is not valid, or is none for a person to wait for."""
    fields: Frame = fill_speed(cast(Frame, step)) if isinstance(step, dict) else {}
    verb = fields.get("do")
    if verb not in WORK_STEPS:
        raise Refusal("bad-request", f"`step` must do one of: {', '.join(WORK_STEPS)}", "submit a job for others")
    try:
        return Job.model_validate({"schema": "tutti.job/1", "name": f"manual: {verb}", "steps": [fields]})
    except ValidationError as error:
        raise refuse_fields(error) from None


def _explain_end(report: JobReport) -> dict[str, Any]:
    step = report.steps[-1] if report.steps else None
    refused_details = None if step is None else step.refused
    reason = "" if report.state == "done" else (step.reason if step is not None else "") or report.reason
    return {"reason": reason, "remedy": "" if refused_details is None else refused_details.remedy, "fraction": 1.0}
