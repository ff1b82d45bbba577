"""Which messages belong to the recording of a job, and when a job begins and ends."""

from collections import deque
from dataclasses import dataclass, field

from orchestrator.model.base import Model
from orchestrator.model.names import controller_of
from orchestrator.model.operation.recording import AxisReading, JobBegun, StepStart
from orchestrator.model.operation.virtual_state import VirtualState
from orchestrator.model.report import FINISHED_STATES, JobProgress, JobReport, LeaseState, QueueState
from orchestrator.model.state import ControllerEvent, ControllerState, TimeInterval
from orchestrator.monitor.recording.channels import Channel

# The job is not executed in these states, so that it has no recording.
_WAITING = frozenset({"queued"})
KEPT_READINGS = 64  # of a controller: at 100 readings a second, those of the last 0.6 s
_COMMON = frozenset({"estop", "estop-reset"})  # belong to every job that runs


@dataclass(slots=True)
class TrackedJob:
    """A job that is executed, as far as the messages show it.

    step: its present step. begun_steps: those whose start positions are recorded already. ended: its report has come,
    or a final state. missing: it is no longer among the jobs of the queue: its end was not seen.
    """

    job_id: str
    name: str
    controllers: set[str] = field(default_factory=set[str])
    step: int | None = None
    begun_steps: set[int] = field(default_factory=set[int])
    ended: bool = False
    missing: bool = False

    @property
    def is_over(self) -> bool:
        """Whether it has ended, as far as is known."""
        return self.ended or self.missing


class JobTracker:
    """The jobs that run, and the last readings of all axes, from the messages of the bus."""

    def __init__(self) -> None:
        self.running: dict[str, TrackedJob] = {}
        self._holders: dict[str, str] = {}
        self._states: dict[str, deque[tuple[int, bytes]]] = {}
        """By controller, its last states with the instants of their readings; as text, which costs less to keep."""

    def take_message(self, message: Model | None, payload: bytes) -> list[StepStart]:
        """Take a message into account; return the starts of steps that it completes. payload: its text."""
        if isinstance(message, ControllerState):
            self._take_state(message, payload)
        elif isinstance(message, JobBegun):
            self._find_job(message.job_id, message.name)
        elif isinstance(message, JobProgress):
            return self._take_progress(message)
        elif isinstance(message, JobReport):
            job = self.running.get(message.job_id)
            if job is not None:
                job.ended = True
                return self._complete_step(job)
        elif isinstance(message, LeaseState):
            self._take_lease(message)
        elif isinstance(message, QueueState):
            listed_jobs = {entry.id for entry in message.jobs}
            for job in self.running.values():
                job.missing = job.job_id not in listed_jobs
        elif isinstance(message, ControllerEvent) and message.kind == "started" and message.job in self.running:
            return self._begin_step(self.running[message.job], message)
        return []

    def find_jobs(self, channel: Channel, message: Model | None) -> list[str]:
        """The running jobs that a message belongs to; none: it belongs to the fleet."""
        parts = channel.parts
        if parts[0] in _COMMON:
            return list(self.running)
        if parts[0] == "job":
            return [parts[1]] if parts[1] in self.running else []
        if parts[0] in ("ctl", "lease"):
            return [job.job_id for job in self.running.values() if parts[1] in job.controllers]
        if isinstance(message, VirtualState):
            controllers = {controller_of(axis) for axis in message.of}
            return [job.job_id for job in self.running.values() if controllers & job.controllers]
        if isinstance(message, StepStart):
            return [message.job_id] if message.job_id in self.running else []
        return []

    def _list_readings(self, before_ns: int | None) -> dict[str, AxisReading]:
        """The last reading of every axis; before_ns: not later than this instant of fleet time."""
        readings: dict[str, AxisReading] = {}
        for controller, states in self._states.items():
            early = [text for read_ns, text in states if before_ns is None or read_ns <= before_ns]
            state = ControllerState.read_message((early or [states[0][1]])[-1])
            for name, axis in state.axes.items():
                readings[f"{controller}.{name}"] = AxisReading(
                    position=axis.position,
                    commanded=axis.commanded,
                    raw_counts=axis.raw_counts,
                    unit=axis.unit,
                    moving=axis.moving,
                    referenced=axis.referenced,
                    read_fleet_ns=state.read_fleet_ns,
                )
        return readings

    def _take_state(self, state: ControllerState, payload: bytes) -> None:
        # A start is reported some milliseconds after it: the readings before that are looked for.
        kept_state = self._states.get(state.controller)
        if kept_state is None:
            kept_state = self._states[state.controller] = deque(maxlen=KEPT_READINGS)
        kept_state.append((state.read_fleet_ns or 0, payload))
        if self.running:
            for holder in {*state.leases.values(), state.job or ""} & set(self.running):
                self.running[holder].controllers.add(state.controller)

    def _take_lease(self, lease: LeaseState) -> None:
        if lease.holder in self.running:
            self.running[lease.holder].controllers.add(lease.controller)
        elif lease.holder:
            # The lease is published before the first progress of its job.
            self._holders[lease.controller] = lease.holder
        else:
            self._holders.pop(lease.controller, None)

    def _find_job(self, job_id: str, name: str) -> TrackedJob:
        job = self.running.get(job_id)
        if job is None:
            job = self.running[job_id] = TrackedJob(job_id, name)
            job.controllers |= {controller for controller, holder in self._holders.items() if holder == job_id}
            for states in self._states.values():
                state = ControllerState.read_message(states[-1][1])
                if job_id in state.leases.values():
                    job.controllers.add(state.controller)
        return job

    def _take_progress(self, progress: JobProgress) -> list[StepStart]:
        if progress.state in FINISHED_STATES or progress.state in _WAITING:
            job = self.running.get(progress.job_id)
            if job is not None and progress.state in FINISHED_STATES:
                job.ended = True
            return []
        job = self._find_job(progress.job_id, progress.name)
        job.missing = False
        starts = self._complete_step(job) if job.step is not None and job.step != progress.step else []
        job.step = progress.step
        return starts

    def _begin_step(self, job: TrackedJob, event: ControllerEvent) -> list[StepStart]:
        """The first axis of a step has started."""
        if event.step is None or event.step in job.begun_steps:
            return []
        first = min(
            (evidence.start for evidence in event.evidence.values()),
            key=lambda interval: interval.earliest_ns,
            default=None,
        )
        # The start may come before the progress that shows it.
        lines_before = self._complete_step(job) if job.step != event.step else []
        return [*lines_before, self._make_start(job, event.step, first)]

    def _complete_step(self, job: TrackedJob) -> list[StepStart]:
        """A step has ended in which nothing has started."""
        if job.step is None or job.step in job.begun_steps:
            return []
        return [self._make_start(job, job.step, None)]

    def _make_start(self, job: TrackedJob, step: int, start: TimeInterval | None) -> StepStart:
        job.begun_steps.add(step)
        before_ns = None if start is None else start.earliest_ns
        return StepStart(job_id=job.job_id, step=step, start=start, axes=self._list_readings(before_ns))
