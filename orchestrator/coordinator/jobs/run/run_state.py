"""The state of a running job: its step, how far that is, and a requested pause; recorded and published."""

import asyncio

from orchestrator.bus.base import Priority
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.coordinator.jobs.run.flight_rows import FlightRows
from orchestrator.coordinator.jobs.run.outcome import JobInterrupted
from orchestrator.coordinator.jobs.run.sequence import StepSequence
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.journal.records import JobRecord, JournalError
from orchestrator.coordinator.motion.step import MotionStep
from orchestrator.model.report import ArmedState, JobProgress, JobState

PROGRESS_NS = NS_PER_S // 5
WAITS_FOR_MOVES = "waits for moves of its program"


class JobPause:
    """Whether a job is to pause. paused_by: the originator of the pause, or of a requested one. braked: by a feed hold,
    inside a motion step. cause: what a refused step waits for; empty: a user has paused the job. lends_axes: commands
    of persons may use its axes, to end that cause. given_up: why the job begins no further step."""

    def __init__(self) -> None:
        self.paused_by: str | None = None
        self.cause = ""
        self.lends_axes = False
        self.resumed_by = ""
        self.braked = False
        self.resumed = asyncio.Event()
        self.given_up: JobInterrupted | None = None

    def request_pause(self, actor: str, cause: str = "") -> None:
        """Pause after the present step, or before it for a cause."""
        self.paused_by, self.cause, self.lends_axes = actor, cause, bool(cause)
        self.resumed.clear()

    def give_up(self, interrupt: JobInterrupted) -> None:
        """Begin no further step."""
        self.given_up = interrupt
        self.resumed.set()

    def resume(self, actor: str) -> None:
        """Continue, or cancel a requested pause."""
        self.paused_by, self.resumed_by, self.braked, self.lends_axes = None, actor, False, False
        self.resumed.set()


class RunState:
    """The state of job `row`.

    needs: controllers that no other job may use meanwhile. rate: of the speed of its next moves. is_recorded: its
    beginning is in the journal. motion_step: the present step, if it is a motion. flight: what it stands for, if it
    flies lines of a scan in one motion.
    """

    def __init__(self, services: JobServices, row: JobRecord, steps: StepSequence, needs: frozenset[str]) -> None:
        self.pause = JobPause()
        self.needs = needs
        self.state: JobState = "queued"
        self.is_recorded = False
        self.rate = 1.0
        self.step = row.from_step
        self.motion_step: MotionStep | None = None
        self.flight: FlightRows | None = None
        self._services = services
        self._row = row
        self._steps = steps
        self._reason = ""
        self._step_t0_ns = 0
        self._step_s = 0.0
        self._part = 0.0
        self._doing = ""
        self._line: int | None = None

    @property
    def _is_on_path(self) -> bool:
        return self.motion_step is not None and self.motion_step.is_path

    def describe_place(self) -> str:
        """Where a pause is: in a step, before the first one or after one."""
        is_first = self.step == self._row.from_step
        location = self._steps.locate(self.step if is_first or self._part else self.step - 1)
        return f"{'in' if self._part else 'before' if is_first else 'after'} {location.describe(kinds=False)}"

    def begin_step(self, index: int) -> None:
        """Step number `index` begins."""
        self.step, self._step_t0_ns, self._step_s = index, 0, 0.0
        self._part, self._doing, self._line = 0.0, "", None

    def note_start(self, t0_fleet_ns: int, duration_s: float) -> None:
        """The present motion starts at T0, and is to take `duration_s`."""
        self._step_t0_ns, self._step_s = t0_fleet_ns, duration_s

    async def note_waiting(self, index: int) -> None:
        """A live job waits for step `index`, for which its program has not asked yet. Raises `JournalError`."""
        self.begin_step(index)
        await self.change_state("running", WAITS_FOR_MOVES)
        self._reason = WAITS_FOR_MOVES
        self.publish_progress()

    def note_part(self, part: float, doing: str) -> None:
        """A part of the present step is done, from 0 to 1."""
        self._part, self._doing = part, doing
        self.publish_progress()

    def note_hold(self, *, is_moved: bool) -> None:
        """The present motion is interrupted; is_moved: after a part of it."""
        if is_moved:
            self._part = self._step_fraction()
        self._step_t0_ns = 0

    @property
    def is_urgent(self) -> bool:
        """Whether the job was submitted to be refused instead of letting it wait."""
        return self._row.now

    async def change_state(self, state: JobState, reason: str, actor: str | None = None) -> None:
        """Record and publish a change. Raises `JournalError`."""
        if state == self.state and state != "planning":
            return
        services = self._services
        if self._is_recorded_singly(state):
            transition = services.make_transition(state, reason, actor or self._row.actor)
            await services.execute(services.journal.record_transition, self._row.id, transition)
        self._publish_change(state, reason)

    def note_state(self, state: JobState, reason: str) -> None:
        """Publish a change that nothing relies on: it is recorded with what is recorded next, such as the decision to
        move, or the end of the job."""
        if state == self.state:
            return
        services = self._services
        if self._is_recorded_singly(state):
            transition = services.make_transition(state, reason, self._row.actor)
            services.record_later(self._log_unrecorded, services.journal.record_transition, self._row.id, transition)
        self._publish_change(state, reason)

    def _is_recorded_singly(self, state: JobState) -> bool:
        """Of a scan, the first point stands for all: its points have rows of their own in the journal."""
        point_later = self.is_recorded and self._steps.locate(self.step).is_later_point
        return not point_later or "paused" in (state, self.state)

    def _publish_change(self, state: JobState, reason: str) -> None:
        self.state, self._reason, self.is_recorded = state, reason, True
        epoch = self._services.leadership.epoch
        self._services.log.info(f"job is {state}", job=self._row.id, step=self.step, epoch=epoch)
        self.publish_progress()

    def _log_unrecorded(self, error: JournalError) -> None:
        self._services.log.warning(f"a state of the job is not recorded: {error}", job=self._row.id)

    async def keep_publishing(self) -> None:
        """Publish the progress again and again."""
        while True:
            self.publish_progress()
            await sleep_ns(self._services.clock, PROGRESS_NS)

    def publish_progress(self) -> None:
        """Publish its progress."""
        key = self._services.keys.job_state(self._row.id)
        self._services.bus.put(key, self.make_progress().to_json(), Priority.STATE)

    def make_progress(self) -> JobProgress:
        """The progress of the job: steps done, and the fraction of the current one."""
        step_share, remaining_s = self._step_fraction(), None
        if self._step_t0_ns and self._step_s > 0:
            remaining_s = self._find_times()[1]
        location, rate = self._steps.locate(self.step), self._find_rate()
        within_scan = location.scan is not None
        return JobProgress(
            job_id=self._row.id,
            name=self._row.name,
            actor=self._row.actor,
            state=self.state,
            step=self.step,
            steps=len(self._steps),
            step_name=self._doing or location.step_name,
            scan_step=location.first if within_scan else None,
            point=self._find_point(location.point) + 1 if location.point is not None and within_scan else None,
            points=location.point_count if within_scan else None,
            fraction=min(1.0, (self.step + step_share * self._count_steps()) / max(1, len(self._steps))),
            remaining_s=remaining_s,
            line=self._find_line(),
            override_percent=None if rate is None else round(100 * rate, 3),
            armed=self._find_armed(),
            reason=self._describe_reason(rate),
            utc=self._services.clock.utc(),
        )

    def _find_point(self, first: int) -> int:
        return first if self.flight is None else self.flight.point

    def _count_steps(self) -> int:
        """The steps that the present one stands for."""
        return 1 if self.flight is None else self.flight.steps

    def _find_armed(self) -> ArmedState | None:
        start = None if self.motion_step is None else self.motion_step.armed_start
        return None if start is None else start.armed

    def _find_line(self) -> int | None:
        """The line that runs now of the file of its path; while the path rests, that at which it does."""
        line = None if self.motion_step is None else self.motion_step.line
        self._line = self._line if line is None else line
        return self._line

    def _find_rate(self) -> float | None:
        """The rate of its path, or of its next moves; None where nothing has changed it."""
        rate = None if self.motion_step is None else self.motion_step.rate
        return self.rate if rate is None and self.rate != 1.0 else rate

    def _describe_reason(self, rate: float | None) -> str:
        if self.pause.paused_by is not None and self.state != "paused":
            return f"pauses after this step: {self.pause.paused_by}"
        if rate is None or rate == 1.0:
            return self._reason
        scope = "on its path" if self._is_on_path else "its next moves"
        return f"{self._reason}; " * bool(self._reason) + f"{scope} at {rate:.0%} of the planned speed"

    def _find_times(self) -> tuple[float, float]:
        """How long the current step has moved, and how long it will, s; on a path, at its present speed."""
        times_s = None if self.motion_step is None else self.motion_step.path_times_s
        if times_s is not None:
            return times_s
        elapsed_s = (self._services.leadership.fleet_now_ns() - self._step_t0_ns) / NS_PER_S
        return elapsed_s, max(0.0, self._step_s - elapsed_s)

    def _step_fraction(self) -> float:
        """The fraction of the current step that is done: of the rest after `_part`, by time."""
        if not self._step_t0_ns or self._step_s <= 0:
            return self._part
        elapsed_s, remaining_s = self._find_times()
        return self._part + (1 - self._part) * min(1.0, max(0.0, elapsed_s) / max(elapsed_s + remaining_s, 1e-9))
