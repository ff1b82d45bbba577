"""The Python API without `async`, for scripts and notebooks.

with BlockingTutti("tcp/127.0.0.1:7447") as tutti:
    tutti.home()
    tutti.move({"gantry.x": 120})
    print(tutti.position("gantry.x"))

Written by `tools/blocking_client.py` from the asynchronous API; a change belongs there. Ctrl-C stops what the
interrupted call has begun, and says so; a job that was submitted stays in the queue.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Self

from orchestrator.bus.base import Bus
from orchestrator.bus.endpoint import DEFAULT_ENDPOINT
from orchestrator.client.api import Tutti
from orchestrator.client.armed import ArmedMove
from orchestrator.client.attendance import Attendance
from orchestrator.client.connection import ANSWER_S
from orchestrator.client.jobs import SubmittedJob
from orchestrator.client.live import LiveJob
from orchestrator.client.manual import VALID_MS, ManualControl
from orchestrator.client.points import OnPoints
from orchestrator.client.ready import ReadyCallback
from orchestrator.client.results import FleetStates, JobQueue, JobResult
from orchestrator.client.states import StateReading
from orchestrator.client.worker import BlockingObject, LoopThread, Worker
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.forecast import JobForecast
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.rest import JobRest
from orchestrator.model.jobs.restart import StartPreview
from orchestrator.model.jobs.service import FleetNames, JobRetargeted, JobRetried, JobShown, WireFinding
from orchestrator.model.messages import TraceReply
from orchestrator.model.operation.alarms import AlarmRecord
from orchestrator.model.operation.approval import JobPlan, JobPlanned
from orchestrator.model.operation.axis_info import AxisInfo
from orchestrator.model.operation.commands import CommandRecord
from orchestrator.model.operation.statistics import StatisticsRead
from orchestrator.model.operation.virtual_state import VirtualState
from orchestrator.model.operation.zone_state import ZoneState
from orchestrator.model.positions.entries import PositionEntry
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import (
    JobProgress,
    JobReport,
    JobState,
    JobTransition,
    LeaseState,
    PointRecord,
    QueueEntry,
    StepRecording,
    StepReport,
)
from orchestrator.model.state import AxisState, ControllerEvent, ControllerInfo
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.templates.template import Template


class BlockingJob(BlockingObject[SubmittedJob]):
    """The id of a job, with methods to follow it. As text it can be stored and passed to other processes, which get
    the same object from `tutti.job(id)`."""

    @property
    def id(self) -> str:
        """The id as plain text."""
        return self._wrapped.id

    @property
    def waits_for(self) -> str:
        """What the job waited for when it was submitted; empty: nothing."""
        return self._wrapped.waits_for

    def events(self) -> Iterator[JobTransition | JobProgress]:
        """All transitions from the beginning on, each once, from the journal, and progress in between from the bus.

        Ends with the job. Raises `Refusal` for a job that does not exist. Waits on while the coordinator is away.
        """
        return self._iterate(self._wrapped.events())

    def follow_points(self, step: int | None = None) -> Iterator[PointRecord]:
        """What is recorded at the points of its scans, each once and in order, as soon as it is final: first those so
        far. Ends with the job. step: only of the scan that begins with this step; ends with it.

        Raises `Refusal` for a job that does not exist. Waits on while the coordinator is away.
        """
        return self._iterate(self._wrapped.follow_points(step))

    def result(self, *, progress: bool = False) -> JobResult:
        """Wait for the job's end and return its report. progress: show a bar, on a terminal or in a notebook. Raises
        `Refusal` for a job that does not exist."""
        return self._run(self._wrapped.result(progress=progress))

    def wait(self, on_ready: ReadyCallback | None = None, *, progress: bool = False) -> JobResult | StartPreview:
        """Wait for the job's end and return its report; or, as soon as it is ready to begin after a cause, what would
        move first. on_ready: called with that; if it returns true the job begins, and the wait goes on. progress: show
        a bar, on a terminal or in a notebook. Raises `Refusal` for a job that does not exist."""
        return self._run(self._wrapped.wait(on_ready, progress=progress))

    def show(self) -> JobShown:
        """All that the journal has of the job. Raises `Refusal`."""
        return self._run(self._wrapped.show())

    def cancel(self) -> None:
        """Cancel the job, queued or running. Raises `Refusal`."""
        self._run(self._wrapped.cancel())

    def hold(self) -> None:
        """Hold the queued job until it is released. Raises `Refusal`: code `not-queued`."""
        self._run(self._wrapped.hold())

    def release(self) -> None:
        """Release the held job, or give the word for one that had to wait for a cause. Raises `Refusal`."""
        self._run(self._wrapped.release())

    def pause(self, *, now: bool = False) -> None:
        """Pause the job after its current step, or `now` inside a motion step; it keeps its axes. Raises `Refusal`:
        code `not-running`."""
        self._run(self._wrapped.pause(now=now))

    def override(self, percent: float) -> None:
        """Play the path that the job moves on at `percent` (10 to 120) of its planned speed; where it is on none, plan
        its next moves so (10 to 100). Raises `Refusal`: codes `not-running`, `not-on-path`, `override`."""
        self._run(self._wrapped.override(percent))

    def retarget(
        self, to: Mapping[str, float | str] | None = None, *, by: Mapping[str, float | str] | None = None
    ) -> JobRetargeted:
        """Send the axes of the move that the job executes now to other targets, by `to` (user positions) or `by`
        (distances from the targets that they have). Raises `Refusal`: codes `not-running`, `not-moving`, `not-a-move`,
        `other-axes`, `soft-limit`, `paused`, `permit`."""
        return self._run(self._wrapped.retarget(to, by=by))

    def go(self, at_fleet_ns: int | None = None) -> int:
        """Start the step of the job that waits armed, at that instant (fleet time, ns) or as soon as all controllers
        can; return T0. Raises `Refusal`: codes `not-running`, `not-armed`, `begun`, `too-near`, `too-late`."""
        return self._run(self._wrapped.go(at_fleet_ns))

    def resume(self) -> None:
        """Resume the paused job. Raises `Refusal`: codes `not-running`, `not-paused`."""
        self._run(self._wrapped.resume())


class BlockingManualControl(BlockingObject[ManualControl]):
    """The lease of `axes` (axes, groups, controllers) and the motion under it. Made by `Tutti.manual_control`."""

    def __enter__(self) -> Self:
        self._run(self._wrapped.__aenter__())
        return self

    def __exit__(self, *error: object) -> None:
        self._run(self._wrapped.__aexit__(*error))

    @property
    def axes(self) -> list[str]:
        """The axes that it has, as they were named or as `controller.axis`."""
        return self._wrapped.axes

    @property
    def lost(self) -> Refusal | None:
        """Why the lease ended before it was released; None while it lasts."""
        return self._wrapped.lost

    @property
    def holder(self) -> str:
        """The holder of the lease, as others are shown it."""
        return self._wrapped.holder

    def release(self) -> None:
        """Stop what still moves and release the axes. Raises nothing: a lease that is not renewed ends by itself."""
        self._run(self._wrapped.release())

    def jog(self, velocities: Mapping[str, float], valid_ms: int = VALID_MS) -> None:
        """Move each `controller.axis` at a velocity (its unit/s, user's direction) for `valid_ms`; 0 stops it.

        At most 200 ms, unless it is renewed. Returns when all controllers have accepted it, and renews it until then;
        one that refuses stops the others. Raises `Refusal`: codes `not-leased`, `leased`, `too-fast`, `soft-limit`,
        `not-enabled`, and others of the adapter.

        Virtual axes are jogged by their real ones, which this object must have; it returns when they have the velocity,
        at the end of their common ramp. They are not jogged together with real axes (code `mixed`).
        """
        self._run(self._wrapped.jog(velocities, valid_ms))

    def renew_jog(self, velocities: Mapping[str, float] | None = None, valid_ms: int = VALID_MS) -> None:
        """Continue all motion for `valid_ms` from now, at the last velocities, or at new ones (unit/s).

        Raises `Refusal`: code `not-jogging` for an axis that has been stopped meanwhile, or was not renewed in time.
        """
        self._run(self._wrapped.renew_jog(velocities, valid_ms))

    def request_jog(self, velocities: Mapping[str, float], *, renew: bool = False) -> None:
        """`jog`, or `renew_jog`, by one request to each controller, which is not renewed while it is on its way.

        For a caller that passes on the requests of a user, and must not continue a motion that the user has ended.
        Raises `Refusal` as they do. A virtual axis has its velocity after some of them: each is one step of its ramp.
        """
        self._run(self._wrapped.request_jog(velocities, renew=renew))

    def stop(self) -> None:
        """Stop all axes that this object has set in motion by their ramps, virtual ones by their common ramp. Raises
        `Refusal` if a controller does not answer."""
        self._run(self._wrapped.stop())


class BlockingArmedMove(BlockingObject[ArmedMove]):
    """Step `number` of live job `job_id`, which waits armed: planned, agreed on, and loaded in all its controllers."""

    @property
    def number(self) -> int:
        """The number of the step in its live job."""
        return self._wrapped.number

    @property
    def lead_s(self) -> float:
        """From `go` to the start of the axes, s, as things were when it was armed."""
        return self._wrapped.lead_s

    @property
    def most_lead_s(self) -> float:
        """The same at most: `go` comes while the controllers are being loaded anew."""
        return self._wrapped.most_lead_s

    @property
    def until_fleet_ns(self) -> int:
        """The end of the wait, fleet time, ns."""
        return self._wrapped.until_fleet_ns

    def go(self) -> int:
        """Start it as soon as all controllers can; return T0, fleet time in ns, once it is agreed. Raises `Refusal`:
        codes `not-armed` after the end of its wait, with what has ended it as the reason of its report, and `begun`."""
        return self._run(self._wrapped.go())

    def go_at(self, fleet_ns: int) -> int:
        """Start it at an instant of fleet time, ns, which is agreed shortly before it. Raises `Refusal`: codes
        `too-near`, with the nearest that is possible, `too-late`, `not-armed`, `begun`."""
        return self._run(self._wrapped.go_at(fleet_ns))

    def wait(self) -> StepReport:
        """Wait until it is done, however it was started; `waited_armed` of its report says how. Raises as
        `LiveJob.wait_for` does."""
        return self._run(self._wrapped.wait())


class BlockingLiveJob(BlockingObject[LiveJob]):
    """A live job; use it as a context, which begins and ends it. It has its axes for itself from beginning to end, and
    is one job in the journal, with a row for each move. It ends with this program: also when that is interrupted,
    suspended or killed, or loses its connection, its axes stop within a second."""

    def __enter__(self) -> Self:
        self._run(self._wrapped.__aenter__())
        return self

    def __exit__(self, *error: object) -> None:
        self._run(self._wrapped.__aexit__(*error))

    @property
    def id(self) -> str:
        """The id as plain text."""
        return self._wrapped.id

    @property
    def axes(self) -> list[str]:
        """The axes that it has, as they were named or as `controller.axis`."""
        return self._wrapped.axes

    @property
    def result(self) -> JobResult | None:
        """The record of the job; None while it runs."""
        return self._wrapped.result

    def begin(self) -> None:
        """Begin: its axes are this program's when this returns. Raises `Refusal`, and `JobFailed` if it is refused
        then."""
        self._run(self._wrapped.begin())

    def end(self) -> JobResult:
        """End it behind the steps that were asked for, and return its record. Raises `JobFailed` if it was not done.
        May be called twice."""
        return self._run(self._wrapped.end())

    def cancel(self) -> None:
        """Stop its axes and end it. Raises nothing: without a connection it ends within a second."""
        self._run(self._wrapped.cancel())

    def move(
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
        return self._run(self._wrapped.move(to, by, speed=speed, sync=sync, replace=replace))

    def run(self, step: Step) -> StepReport:
        """Run one step, and return its report when it is done; a cancelled task stops it. Raises as `move` does."""
        return self._run(self._wrapped.run(step))

    def make_move(
        self,
        to: Mapping[str, int | float | str] | str | None = None,
        by: Mapping[str, int | float | str] | None = None,
        *,
        speed: float | str | Mapping[str, float | str] | None = None,
        sync: Literal["time", "phase", "none"] = "time",
    ) -> Move:
        """A move for `submit`, at the speed of this live job if none is given. Raises `WrongValue`."""
        return self._wrapped.make_move(to, by, speed=speed, sync=sync)

    def submit(self, *steps: Step) -> list[int]:
        """Ask for steps, up to 100 ahead, and return their numbers when they are accepted: moves are then chained, each
        loaded while the one before it moves. None is accepted if one is refused. Raises `Refusal`: codes `ended`,
        `too-many`, `not-of-job`, and those of a check; and `FileError`."""
        return self._run(self._wrapped.submit(*steps))

    def arm(
        self, step: Move | FollowPath, *, input: str | None = None, level: bool = False, timeout_s: float = 60.0
    ) -> BlockingArmedMove:
        """Plan and load a move or a path in all its controllers, and return when it waits for `go`. It is refused if
        its budget does not hold.

        input: `controller.input`, which starts it too when it becomes active; level: also if it is active already,
        which is refused otherwise. timeout_s: the end of the wait. Raises as `move` does."""
        return BlockingArmedMove(
            self._run(self._wrapped.arm(step, input=input, level=level, timeout_s=timeout_s)), self._worker
        )

    def wait_for(self, number: int) -> StepReport:
        """Wait until a submitted step is done, and return its report; those of the last 200 are kept. Raises as `move`
        does."""
        return self._run(self._wrapped.wait_for(number))

    def stop(self) -> None:
        """Stop its axes by their ramps and forget the steps that wait; the live job goes on. Raises nothing: a program
        without a connection ends its live job."""
        self._run(self._wrapped.stop())

    def path(self, path: FollowPath) -> StepReport:
        """Move axes along a path, from its start. Raises as `move` does, and `FileError` for a file of a path."""
        return self._run(self._wrapped.path(path))

    def home(self, *axes: str) -> StepReport:
        """Find the reference of axes; without any, of all of this live job. Raises as `move` does."""
        return self._run(self._wrapped.home(*axes))

    def enable(self, *axes: str) -> StepReport:
        """Switch motors on; without axes, of all of this live job. Raises as `move` does."""
        return self._run(self._wrapped.enable(*axes))

    def disable(self, *axes: str) -> StepReport:
        """Switch motors off; without axes, of all of this live job. Raises as `move` does."""
        return self._run(self._wrapped.disable(*axes))

    def output(self, output: str, *, on: bool = True, pulse_s: float | None = None) -> StepReport:
        """Switch the output `controller.output`; back after `pulse_s`. Raises as `move` does."""
        return self._run(self._wrapped.output(output, on=on, pulse_s=pulse_s))

    def wait_input(self, name: str, *, on: bool = True, timeout_s: float = 10.0) -> StepReport:
        """Wait until the input `controller.input` is active (`on=False`: passive). Raises as `move` does."""
        return self._run(self._wrapped.wait_input(name, on=on, timeout_s=timeout_s))

    def dwell(self, seconds: float) -> StepReport:
        """Wait, as a step of the fleet's own. Raises as `move` does."""
        return self._run(self._wrapped.dwell(seconds))


class BlockingAttendance(BlockingObject[Attendance]):
    """One session; use it as a context."""

    def __enter__(self) -> Self:
        self._run(self._wrapped.__aenter__())
        return self

    def __exit__(self, *error: object) -> None:
        self._run(self._wrapped.__aexit__(*error))

    @property
    def session(self) -> str:
        """The session, for the terms of jobs that belong to it."""
        return self._wrapped.session


class BlockingTutti(BlockingObject[Tutti]):
    """A connection to one fleet, with all requests; use it as a context. For its arguments see `FleetConnection`."""

    def __init__(
        self,
        connect: str | Bus = DEFAULT_ENDPOINT,
        fleet: str | None = None,
        actor: str = "api",
        worker: Worker | None = None,
    ) -> None:
        """worker: runs the requests; None: a thread of its own."""
        super().__init__(Tutti(connect, fleet, actor), worker or LoopThread())
        self._closed = False

    def connect(self) -> Self:
        """Connect, for a notebook; entering the context does it, and `close` ends it. Raises `RouterUnreachable`, or
        `Refusal` with code `no-fleet` or `which-fleet`."""
        try:
            self._run(self._wrapped.open())
        except BaseException:
            self.close()
            raise
        return self

    def __enter__(self) -> Self:
        return self.connect()

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection. May be called twice."""
        if not self._closed:
            self._closed = True
            self._run(self._wrapped.close())
            self._worker.close()

    @property
    def actor(self) -> str:
        """The user or program that makes the requests."""
        return self._wrapped.actor

    def live(
        self,
        axes: Sequence[str] | str | Job,
        *,
        name: str = "live",
        speed: float | str = "manual",
        gather: str = "0 ms",
        wait: bool = False,
    ) -> BlockingLiveJob:
        """A live job, which begins when its context is entered: `with tutti.live(["gantry.x"]) as live:`.

        axes: that it may move, as axes, groups or controllers; nothing else moves them while it lasts. Or a job with
        one `Live` step, which may state skews, and outputs of other controllers. speed: of its moves, as in `move`.
        gather: moves of different axes that are asked for within this time are one synchronised move. wait: for axes
        that are in use; otherwise that is refused. Raises `WrongValue`.
        """
        return BlockingLiveJob(self._wrapped.live(axes, name=name, speed=speed, gather=gather, wait=wait), self._worker)

    def find_rest(self, job_id: str, file: Path | str | None = None) -> JobRest:
        """What is left of a job that has ended, and the way back to where it stood; nothing moves.

        file: that the job was made of, such as a program in G-code; it is compared with what ran. Raises `Refusal`, as
        with code `not-ended`, `nothing-left`, `needs-file`, `zero-changed`, and `FileError` with what has changed.
        """
        return self._run(self._wrapped.find_rest(job_id, file))

    def continue_job(
        self, rest: JobRest, terms: QueueTerms | None = None, *, client_key: str | None = None
    ) -> BlockingJob:
        """Submit the rest of a job as a new job, whose terms name the old one. Its axes must stand where `rest` begins:
        run `rest.move` before, if there is one. What `rest.outputs` names is switched first. Raises `Refusal`,
        `JobFailed`."""
        return BlockingJob(self._run(self._wrapped.continue_job(rest, terms, client_key=client_key)), self._worker)

    def run(
        self,
        job: Job | Step | Sequence[Step],
        *,
        wait: bool = False,
        on_ready: ReadyCallback | None = None,
        progress: bool = False,
    ) -> JobResult:
        """Run a job, or steps, and return its report when it is done; it ends with this program.

        wait: let it wait for axes that are in use, for a permit, an e-stop; otherwise that is refused. on_ready: called
        with what would move first once a cause is gone that it had to wait for; it begins if that returns true.
        progress: show a bar, on a terminal or in a notebook. Raises `Refusal` if it does not begin (`ReadyToBegin`
        after a cause, without `on_ready`), and `JobFailed` if it is not done. Unlike a job that is submitted, it begins
        also while the queue is stopped, and does not survive an interruption.
        """
        return self._run(self._wrapped.run(job, wait=wait, on_ready=on_ready, progress=progress))

    def move(
        self,
        to: Mapping[str, int | float | str] | str | None = None,
        by: Mapping[str, int | float | str] | None = None,
        *,
        speed: float | str | Mapping[str, float | str] = "manual",
        sync: Literal["time", "phase", "none"] = "time",
        wait: bool = False,
    ) -> JobResult:
        """Move axes together: to positions, or by distances, in their units or with one (`"6 mm"`).

        to: by axis, a quantity or the name of a position; or one name, for all its axes.
        speed: as in a job: a fraction of the limits, `"5 mm/s"`, or one by axis; without it `manual_speed` of each
        axis, 20 % unless the fleet file says otherwise. sync, wait: as in a job, and in `run`. Raises `Refusal`,
        `JobFailed`.
        """
        return self._run(self._wrapped.move(to, by, speed=speed, sync=sync, wait=wait))

    def home(self, *axes: str, wait: bool = False) -> JobResult:
        """Find the reference of axes (groups, controllers); without any, of the whole fleet in its home_order.

        Raises `Refusal`, `JobFailed`."""
        return self._run(self._wrapped.home(*axes, wait=wait))

    def enable(self, *axes: str, wait: bool = False) -> JobResult:
        """Switch the motors of axes (groups, controllers) on; without any, of the whole fleet. Raises `Refusal`,
        `JobFailed`."""
        return self._run(self._wrapped.enable(*axes, wait=wait))

    def disable(self, *axes: str, wait: bool = False) -> JobResult:
        """Switch the motors of axes (groups, controllers) off. Raises `Refusal`, `JobFailed`."""
        return self._run(self._wrapped.disable(*axes, wait=wait))

    def set_position(self, axes: Mapping[str, int | float | str | None], *, wait: bool = False) -> JobResult:
        """Set the present positions of axes; None removes an axis's offset. Nothing moves. Raises `Refusal`,
        `JobFailed`."""
        return self._run(self._wrapped.set_position(axes, wait=wait))

    def set_output(self, output: str, *, on: bool = True, wait: bool = False) -> JobResult:
        """Switch the output `controller.output`. Raises `Refusal`, `JobFailed`."""
        return self._run(self._wrapped.set_output(output, on=on, wait=wait))

    def wait_input(self, name: str, *, on: bool = True, timeout_s: float = 10.0) -> JobResult:
        """Wait until the input `controller.input` is active (`on=False`: passive). Raises `Refusal`, and `JobFailed`
        after `timeout_s`."""
        return self._run(self._wrapped.wait_input(name, on=on, timeout_s=timeout_s))

    def dwell(self, seconds: float) -> JobResult:
        """Wait, as a step of the fleet's own. Raises `Refusal`, `JobFailed`."""
        return self._run(self._wrapped.dwell(seconds))

    def submit(
        self,
        job: Job | Template | Path | str,
        client_key: str | None = None,
        terms: QueueTerms | None = None,
        *,
        parameters: Mapping[str, object] | None = None,
    ) -> BlockingJob:
        """Submit a job; it is in the journal when this returns. Raises `Refusal`, and `FileError` for a file or a
        template. What it returns prints with what the job waits for, such as a stopped queue.

        job: a job, a template, or the path of a job file; without an actor it gets the actor of this connection.
        client_key: the same key is the same job, however often it is submitted. terms: priority, repeats, predecessor
        and start time. parameters: values for those of the template or file, `{"width": "20 mm"}`.
        """
        return BlockingJob(self._run(self._wrapped.submit(job, client_key, terms, parameters=parameters)), self._worker)

    def attend(self) -> BlockingAttendance:
        """A session for jobs that a person waits for: they end when its context does, or its process."""
        return BlockingAttendance(self._wrapped.attend(), self._worker)

    def find_job(self, reference: str, *, newest: bool = False) -> QueueEntry:
        """The job that a user means: by the beginning of its id, its name, or `last`, the newest.

        newest: take the newest of that name. Raises `Refusal`: codes `unknown-job`, and `ambiguous`, with what fits.
        """
        return self._run(self._wrapped.find_job(reference, newest=newest))

    def job(self, job_id: str) -> BlockingJob:
        """A job by its id, to follow it."""
        return BlockingJob(self._wrapped.job(job_id), self._worker)

    def enqueue_job(self, job: Job, client_key: str | None = None, terms: QueueTerms | None = None) -> QueueEntry:
        """Submit a job and return its place in the queue. Raises `Refusal`, and `FileError` for a file of points."""
        return self._run(self._wrapped.enqueue_job(job, client_key, terms))

    def dry_run(self, job: Job, on_steps: Callable[[int], None] | None = None) -> JobForecast:
        """Run a job forward from the present positions, each step from where the one before it leaves its axes, and
        ask every controller what it would be sent. Nothing moves. Raises `Refusal`.

        on_steps: called with the number of steps that are done. The work ends with this call: the job is sent in parts.
        """
        return self._run(self._wrapped.dry_run(job, on_steps))

    def list_jobs(
        self, limit: int = 50, state: JobState | None = None, name: str = "", since: str | None = None
    ) -> JobQueue:
        """The newest jobs, newest first; `total` is the number of all that match. Raises `Refusal`.

        state: only jobs in it. name: only jobs with this text in their name. since: only jobs submitted at this RFC
        3339 time or later.
        """
        return self._run(self._wrapped.list_jobs(limit, state, name, since))

    def load_recording(self, job_id: str, step: int) -> StepRecording | None:
        """The plan and the polled samples of a motion step; None if there is no recording."""
        return self._run(self._wrapped.load_recording(job_id, step))

    def cancel_job(self, job_id: str) -> None:
        """Cancel a queued or running job. Raises `Refusal`."""
        self._run(self._wrapped.cancel_job(job_id))

    def pause_job(self, job_id: str, *, now: bool = False) -> None:
        """Pause a running job after its current step; it keeps its axes. Raises `Refusal`: code `not-running`.

        now: pause inside a motion step by a feed hold; the axes brake together, and `resume_job` continues from there.
        """
        self._run(self._wrapped.pause_job(job_id, now=now))

    def override_job(self, job_id: str, percent: float) -> None:
        """Play the path that a job moves on at `percent` (10 to 120) of its planned speed, from as soon as all members
        can; where it is on none, plan its next moves for `percent` (10 to 100) of theirs. Raises `Refusal`: codes
        `not-running`, `not-on-path`, `override`, `path-ramp`, `late`."""
        self._run(self._wrapped.override_job(job_id, percent))

    def resume_job(self, job_id: str) -> None:
        """Resume a paused job. Raises `Refusal`: codes `not-running`, `not-paused`."""
        self._run(self._wrapped.resume_job(job_id))

    def retry_job(
        self,
        job_id: str,
        from_step: int | tuple[int, int] = 0,
        *,
        dry_run: bool = False,
        terms: QueueTerms | None = None,
        client_key: str | None = None,
    ) -> JobRetried:
        """Re-run a finished job from a step on, as a new job. Raises `Refusal`: codes `not-ended`, `no-step`.

        from_step: its index, counted from 0, or that of a scan and the number of a point of it, from 1: `(2, 17)`.
        dry_run: only report the remaining steps and the present positions of their axes.
        """
        return self._run(
            self._wrapped.retry_job(job_id, from_step, dry_run=dry_run, terms=terms, client_key=client_key)
        )

    def wait_for_job(
        self,
        job_id: str,
        on_progress: Callable[[JobProgress], None] | None = None,
        poll_s: float = 1.0,
        on_ready: ReadyCallback | None = None,
    ) -> JobReport:
        """Wait for a job's end and return its report, as the journal has it. on_progress: called with progress from
        the bus, and at once with what a queued job waits for; what it raises is raised here. on_ready: called with what
        would move first when the job is ready to begin after a cause; if it returns true the job begins. Without it,
        the word is given elsewhere.

        Raises `Refusal` for a job that does not exist, and `ReadyToBegin` if `on_ready` does not return true. Waits on
        while the coordinator is away.
        """
        return self._run(self._wrapped.wait_for_job(job_id, on_progress, poll_s, on_ready))

    def retarget_job(
        self, job_id: str, to: Mapping[str, float | str] | None = None, *, by: Mapping[str, float | str] | None = None
    ) -> JobRetargeted:
        """Send the axes of the move that a job executes now to other targets: all of its axes, each by `to` (user
        position) or by `by` (distance from the target that it has). Returns as soon as the new targets count. Raises
        `Refusal`: codes `not-running`, `not-moving`, `not-a-move`, `other-axes`, `soft-limit`, `paused`, `permit`."""
        return self._run(self._wrapped.retarget_job(job_id, to, by=by))

    def preview_start(self, *job_ids: str) -> StartPreview:
        """What would move first if these jobs were released; without any, if the queue was started. Raises `Refusal`:
        code `not-queued`."""
        return self._run(self._wrapped.preview_start(*job_ids))

    def start_queue(self, preview: StartPreview | None = None) -> StartPreview:
        """Let the jobs of the queue begin again after a break or a stop, and those that had to wait for a cause which
        is gone. preview: what was shown to a person; without one, what would move at this moment. Returns it. Raises
        `Refusal`: code `not-shown` if something else would move first by now."""
        return self._run(self._wrapped.start_queue(preview))

    def stop_queue(self) -> None:
        """Let no further job begin; running jobs continue. Raises `Refusal`."""
        self._run(self._wrapped.stop_queue())

    def hold_jobs(self, *job_ids: str) -> None:
        """Hold queued jobs until they are released. Raises `Refusal`: code `not-queued`."""
        self._run(self._wrapped.hold_jobs(*job_ids))

    def release_jobs(self, *job_ids: str, preview: StartPreview | None = None) -> None:
        """Release held jobs, and give the word for jobs that had to wait for a cause; without ids, all held jobs but
        those that wait for approval or for a word. preview: what was shown to a person; without one, what these jobs
        would move at this moment. Raises `Refusal`: codes `awaits-approval`, `cause-lasts`, `not-shown`."""
        self._run(self._wrapped.release_jobs(*job_ids, preview=preview))

    def plan_job(self, job_id: str) -> JobPlanned:
        """What a waiting job would do if it began now, as a plan with a hash, and what differs from the plan that was
        approved last. Raises `Refusal`: codes `not-queued`, and `absent`, `offline`, `moving` if it is not known."""
        return self._run(self._wrapped.plan_job(job_id))

    def approve_job(self, job_id: str, plan: JobPlan | str) -> None:
        """Approve the plan of a proposed job, and release it: it begins only with this plan. plan: the one that was
        seen, or its hash. Raises `Refusal`: codes `plan-changed`, `not-proposed`, `not-queued`, `journal`."""
        self._run(self._wrapped.approve_job(job_id, plan))

    def reorder_job(self, job_id: str, before: str) -> None:
        """Move a queued job before another one, with that one's priority. Raises `Refusal`: code `not-queued`."""
        self._run(self._wrapped.reorder_job(job_id, before))

    def prune_jobs(self, older_s: float, keep: int) -> int:
        """Delete finished jobs that were submitted more than `older_s` ago, except the newest `keep`; return how
        many."""
        return self._run(self._wrapped.prune_jobs(older_s, keep))

    def go_job(self, job_id: str, at_fleet_ns: int | None = None) -> int:
        """Start the step of a job that waits armed (`do: wait_armed`); return the instant at which all axes start,
        fleet time in ns, once it is agreed. Raises `Refusal`: codes `not-running`, `not-armed`, `begun`, `too-near`,
        `too-late`, and what has ended the wait.

        at_fleet_ns: an instant to start at instead, which is agreed shortly before it, and returned at once; without
        it, as soon as all controllers can."""
        return self._run(self._wrapped.go_job(job_id, at_fleet_ns))

    def show_job(self, job_id: str) -> JobShown:
        """All that the journal has of a job. Raises `Refusal`."""
        return self._run(self._wrapped.show_job(job_id))

    def follow_points(self, job_id: str, step: int | None = None) -> Iterator[PointRecord]:
        """What is recorded at the points of the scans of a job, each once and in order, as soon as it is final: first
        those so far. Ends with the job. step: only of the scan that begins with this step; ends with it.

        Raises `Refusal` for a job that does not exist. Waits on while the coordinator is away.
        """
        return self._iterate(self._wrapped.follow_points(job_id, step))

    def follow_point_batches(self, job_id: str, step: int | None = None) -> Iterator[list[PointRecord]]:
        """`follow_points`, with those together that become known together: for what is written to a file."""
        return self._iterate(self._wrapped.follow_point_batches(job_id, step))

    def send_points(self, job: Job, on_points: OnPoints | None = None) -> Job:
        """Read the points of all scans that are in files or specs, and send them; return the job that names what is
        stored. Points that are stored already are not sent again.

        Files of paths are read as well. on_points: called with the progress. Raises `FileError` with every wrong line,
        and `Refusal`: codes `point-store-full`, `no-scanspec`, `bad-scanspec`.
        """
        return self._run(self._wrapped.send_points(job, on_points))

    def iterate_points(self, job_id: str, step: int | None = None) -> Iterator[PointRecord]:
        """What was recorded at the points of the scans of a job so far, in their order. Raises `Refusal`.

        step: only of the scan that begins with this step.
        """
        return self._iterate(self._wrapped.iterate_points(job_id, step))

    def iterate_point_batches(self, job_id: str, step: int | None = None) -> Iterator[list[PointRecord]]:
        """`iterate_points`, many at a time: for what is written to a file."""
        return self._iterate(self._wrapped.iterate_point_batches(job_id, step))

    def load_points(self, job_id: str) -> list[PointRecord]:
        """What was recorded at the points of the scans of a job. Of a long scan take `iterate_points`. Raises
        `Refusal`."""
        return self._run(self._wrapped.load_points(job_id))

    def manual_control(
        self, axes: Sequence[str], what: str = "manual control", ttl_s: float = 3.0
    ) -> BlockingManualControl:
        """Manual control of axes (groups, controllers) while the context lasts: nothing else moves them, and they can
        be jogged.

        with tutti.manual_control(["gantry.x"], what="alignment") as manual:
            manual.jog({"gantry.x": 5.0})

        what: shown to clients that are refused meanwhile. ttl_s: how long the axes stay acquired if this process dies.
        Entering raises `Refusal`: code `leased` while another holder has one of them, `permit` while one is missing.
        """
        return BlockingManualControl(self._wrapped.manual_control(axes, what, ttl_s), self._worker)

    def reserve_axes(self, axes: Sequence[str], seconds: float, what: str = "manual work") -> tuple[list[str], str]:
        """Reserve axes (groups, controllers) for work at the machine, for `seconds` or until `release_axes`.

        Jobs that need them wait, other holders are refused. Returns all reserved axes, and the holder. Raises
        `Refusal`: code `leased`.
        """
        return self._run(self._wrapped.reserve_axes(axes, seconds, what))

    def release_axes(self, holder: str) -> None:
        """Release all axes of a manual `holder`. Raises `Refusal`."""
        self._run(self._wrapped.release_axes(holder))

    def list_leases(self) -> list[LeaseState]:
        """The lease of each controller; where several holders have its axes, one of them."""
        return self._run(self._wrapped.list_leases())

    def send_raw(self, controller: str, command: str, *, i_know: bool) -> str:
        """Send a command in the controller's own language, with all its axes acquired meanwhile. Raises `Refusal`.

        i_know: must be True, because no limit is checked.
        """
        return self._run(self._wrapped.send_raw(controller, command, i_know=i_know))

    def list_positions(self) -> list[PositionEntry]:
        """All named positions: those of the fleet file, and those that are saved. Raises `Refusal`."""
        return self._run(self._wrapped.list_positions())

    def save_position(
        self, name: str, *axes: str, at: Mapping[str, int | float | str] | None = None, description: str | None = None
    ) -> PositionEntry:
        """Save the present user positions of axes (groups, controllers) under a name; an earlier saved position of
        this name is replaced. Without axes and `at`: of all axes that are referenced.

        at: values that are given instead, by axis. Raises `Refusal`: codes `bad-name`, `moving`, `not-referenced`,
        `offline`, `unknown-name`, `bad-unit`, `soft-limit`.
        """
        return self._run(self._wrapped.save_position(name, *axes, at=at, description=description))

    def remove_position(self, name: str) -> PositionEntry | None:
        """Remove a saved position; return that of the fleet file with the same name, which counts again. Raises
        `Refusal`: codes `unknown-name`, `in-file`."""
        return self._run(self._wrapped.remove_position(name))

    def axes(self) -> dict[str, AxisState]:
        """The state of every axis, by `controller.axis`; those of controllers that are offline are old."""
        return self._run(self._wrapped.axes())

    def axis(self, name: str) -> AxisInfo:
        """What does not change about `controller.axis` while a program runs: unit, resolution, limits, make. Raises
        `Refusal`: codes `unknown-axis`, and `absent` while its offset is not known."""
        return self._run(self._wrapped.axis(name))

    def position(self, axis: str) -> float:
        """The present position of `controller.axis`, or of a virtual axis, in its unit. Raises `Refusal`: codes
        `unknown-axis`, `offline`."""
        return self._run(self._wrapped.position(axis))

    def positions(self, axes: Sequence[str] | None = None, hz: float = 10.0) -> Iterator[dict[str, float]]:
        """The positions of axes (None: of all real ones), in their units, `hz` times a second, until the loop is left.

        For a display: where the axes are now, by the last state of each. What was where at an event is in the report of
        its move (`positions`), in the points of a scan, and in `states`, which have instants. An axis whose controller
        is offline has the position NaN. A position is as old as its poll: the fleet file's `state` says how often.
        Raises `Refusal`: code `unknown-axis`.
        """
        return self._iterate(self._wrapped.positions(axes, hz))

    def states(self, axes: Sequence[str] | None = None) -> Iterator[StateReading]:
        """Every state of the controllers of axes (None: of all) once, as they come, until the loop is left.

        Each has the interval of fleet time in which its positions were sampled, and UTC; the first ones are those of
        now. A consumer that is 100 states of a controller behind goes on with the newest, which counts what was missed;
        it delays no other. While a controller or the router is away its states pause, and go on by themselves. Raises
        `Refusal`: codes `unknown-axis`, `no-axes`, and `closed` when the connection is closed meanwhile.
        """
        return self._iterate(self._wrapped.states(axes))

    def events(self, controller: str | None = None) -> Iterator[ControllerEvent]:
        """The events of the fleet, or of one controller, as they come: starts, ends, faults, limits, e-stops."""
        return self._iterate(self._wrapped.events(controller))

    def status(self, timeout_s: float = ANSWER_S) -> FleetStates:
        """The state of every controller that has an adapter now, by id. An adapter that hangs costs `timeout_s`; what
        cannot be read is left out."""
        return self._run(self._wrapped.status(timeout_s))

    def virtual_states(self) -> dict[str, VirtualState]:
        """The state of every group of virtual axes, by its name; none of a fleet that has none. Raises `Refusal`."""
        return self._run(self._wrapped.virtual_states())

    def zone_state(self) -> ZoneState:
        """Where the bodies of the keep-out zones are now, mm, and what each rule says to that; all empty for a fleet
        without. Software, no safety function. Raises `Refusal`."""
        return self._run(self._wrapped.zone_state())

    def stop(self, mode: str = "decelerate", known: Iterable[str] = ()) -> dict[str, Refusal | None]:
        """Stop every controller, directly, and the running jobs, and hold the queued ones.

        Returns the refusal of each controller, by id; None where it has accepted the stop. mode: `decelerate`, or
        `abort` for the shortest stop. known: controllers that are stopped at once, before any others are looked for.
        """
        return self._run(self._wrapped.stop(mode, known))

    def estop(self, reason: str = "", timeout_s: float = 2.0) -> dict[str, bool]:
        """Send an e-stop; return which controllers report its latch within `timeout_s`, by id."""
        return self._run(self._wrapped.estop(reason, timeout_s))

    def wait_for_latch(self, timeout_s: float = 2.0) -> dict[str, bool]:
        """Wait until all controllers report an e-stop latch, at most `timeout_s`; return which do, by id."""
        return self._run(self._wrapped.wait_for_latch(timeout_s))

    def reset(self, event: str | None = None) -> dict[str, Refusal | None]:
        """Release the e-stop latch named `event` (None: any) on every controller, and clear faults that can be cleared.

        All controllers check first whether it is safe; if one refuses, none is released. Returns the refusal of each,
        by id; None where it has been reset.
        """
        return self._run(self._wrapped.reset(event))

    def reload_fleet(self, fleet: Fleet) -> list[str]:
        """Load another fleet file into the running fleet; return the controllers that have changed.

        Raises `Refusal`.
        """
        return self._run(self._wrapped.reload_fleet(fleet))

    def load_fleet(self) -> Fleet:
        """The fleet file as it runs, without `notify`. Raises `Refusal`."""
        return self._run(self._wrapped.load_fleet())

    def check_wiring(self) -> list[WireFinding]:
        """Check each wire of the fleet file; nothing moves. Raises `Refusal` while wired axes are in use."""
        return self._run(self._wrapped.check_wiring())

    def repair_epoch(self) -> list[str]:
        """Let controllers that remember another epoch accept the present coordinator; return them. Raises `Refusal`
        while an axis moves."""
        return self._run(self._wrapped.repair_epoch())

    def hand_over(self) -> list[str]:
        """Let a standby lead; return the names of those that wait. Raises `Refusal` where none does, or something would
        be interrupted."""
        return self._run(self._wrapped.hand_over())

    def forget_times(self, *controllers: str) -> None:
        """Forget what was learned of the times of controllers, in memory and in the journal: their next steps have the
        lead times that they declare. Without a name: of all, and of the fleet as a whole. Raises `Refusal`."""
        self._run(self._wrapped.forget_times(*controllers))

    def list_names(self, timeout_s: float = ANSWER_S) -> FleetNames:
        """The names of the fleet: of its coordinator, or else of the adapters that answer. Raises `Refusal`, code
        `no-fleet`, if nothing answers."""
        return self._run(self._wrapped.list_names(timeout_s))

    def controller_info(self, controller: str) -> ControllerInfo:
        """Identity, capabilities and configuration of a controller, as its adapter has it. Raises `Refusal`."""
        return self._run(self._wrapped.controller_info(controller))

    def axis_config(self, axis: str) -> dict[str, Any]:
        """The configuration of `controller.axis`, as its adapter has it. Raises `Refusal`."""
        return self._run(self._wrapped.axis_config(axis))

    def read_trace(self, controller: str, *, after: int = 0, last_s: float | None = None) -> TraceReply:
        """The last minute of bytes on a controller's link, in the order of their instants.

        after: only what was recorded after the entry with this number, `newest` of an earlier answer. last_s: only that
        of so many seconds. Raises `Refusal`.
        """
        return self._run(self._wrapped.read_trace(controller, after=after, last_s=last_s))

    def list_alarms(self, *, normal: bool = False) -> list[AlarmRecord]:
        """The alarms: those that wait for a user first, by priority. normal: also those that are over and acknowledged.
        Raises `Refusal`."""
        return self._run(self._wrapped.list_alarms(normal=normal))

    def list_alarm_history(self, limit: int = 100) -> list[AlarmRecord]:
        """The last changes of alarms, the newest first: each alarm as it was then. Raises `Refusal`."""
        return self._run(self._wrapped.list_alarm_history(limit))

    def acknowledge_alarms(self, *alarm_ids: str) -> list[AlarmRecord]:
        """Acknowledge alarms, for this actor; without ids, all of them. Returns those that have changed. Raises
        `Refusal`: codes `unknown-alarm`, `journal`."""
        return self._run(self._wrapped.acknowledge_alarms(*alarm_ids))

    def shelve_alarm(self, alarm_id: str, for_s: float, why: str = "") -> AlarmRecord:
        """Set an alarm aside for at most a day; it comes back by itself. Raises `Refusal`: codes `unknown-alarm`,
        `journal`."""
        return self._run(self._wrapped.shelve_alarm(alarm_id, for_s, why))

    def unshelve_alarm(self, alarm_id: str) -> AlarmRecord:
        """End the shelving of an alarm. Raises `Refusal`: codes `unknown-alarm`, `journal`."""
        return self._run(self._wrapped.unshelve_alarm(alarm_id))

    def read_statistics(self, since: str | None = None, *, by_day: bool = False) -> StatisticsRead:
        """What axes, controllers and jobs have done. since: a UTC day, `2026-01-31`; None: the last week. by_day: also
        those of each day. Raises `Refusal`: codes `too-much`, `journal`."""
        return self._run(self._wrapped.read_statistics(since, by_day=by_day))

    def list_commands(self, limit: int = 100, *, before: str | None = None, by: str = "") -> list[CommandRecord]:
        """The commands of users that changed something, the newest first, at most 1000. before: an RFC 3339 time, e.g.
        that of the last one of a list, for the next ones. by: only of users with this text in their name. Raises
        `Refusal`: code `journal`."""
        return self._run(self._wrapped.list_commands(limit, before=before, by=by))
