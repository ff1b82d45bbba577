"""What a phase of a run consisted of: its steps by the recorded requests, and the true motions that belong to them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from orchestrator.campaign.faults import FaultKind
from orchestrator.campaign.jobs import JobOrder
from orchestrator.campaign.recording.recorder import BusRecorder, RecordedRequest
from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.fleet import Axis
from orchestrator.model.report import JobReport
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.core.controller import CommandedMotion

# A motion belongs to a step when it begins this near to its T0, or during it; but not before any member was armed for
# the step: the first step of a new leader can follow the step that it stopped sooner than this. Where two steps of one
# axis follow each other sooner than this, a motion between their T0 belongs to the nearer.
STEP_WINDOW_NS = 300 * NS_PER_MS
# after homing was abandoned: earlier commands still take effect, and the stop follows them
IN_TRANSIT_NS = 100 * NS_PER_MS


@dataclass(frozen=True, slots=True)
class JogRecord:
    """A jogged axis. Instants in host ns."""

    controller: str
    motor: str
    from_ns: int
    renewed_ns: int


@dataclass(slots=True)
class CampaignPhase:
    """One phase of a run: the jobs submitted, the fault injected, and the motions made.

    jobs: job orders by job id.
    motions_before: number of earlier motions of each controller.
    affected: controllers that the fault affects.
    queue_started_ns: when the operator started the queue after the fault.

    Instants in host ns, None for events that have not happened.
    """

    fault: FaultKind
    member: str
    affected: list[str]
    motions_before: dict[str, int]
    jobs: dict[str, JobOrder] = field(default_factory=dict[str, JobOrder])
    jogs: list[JogRecord] = field(default_factory=list[JogRecord])
    fault_ns: int | None = None
    repair_ns: int | None = None
    at_rest: set[str] = field(default_factory=set[str])
    queue_started_ns: int | None = None

    @property
    def unstoppable(self) -> set[str]:
        """Controllers that could not be stopped during the fault."""
        if self.fault_ns is None or self.fault.must_stop is False:
            return set()
        # A controller of a daisy chain that is off disconnects those after it from the link.
        off = self.fault.reach == "power"
        return set(self.affected) - ({self.member} if off else set()) if off or self.fault.unstoppable else set()


@dataclass(frozen=True, slots=True)
class StepRecord:
    """A step whose members received `go`, or the homing of one member, by the recorded requests.

    begins_ns: from when on a motion belongs to the step, by member and axis.
    until_ns: the last instant at which one does, None for no limit.
    t0_ns: None for a homing.
    axes: those that each member moves; a member without axes only drives a trigger line.

    Instants in host ns."""

    job: str
    index: int
    requested_ns: int
    begins_ns: Mapping[tuple[str, str], int]
    until_ns: int | None
    t0_ns: int | None
    axes: Mapping[str, Sequence[str]]


class PhaseRecords:
    """Relates the true motions of a fleet to the steps that its coordinators requested."""

    def __init__(self, fleet: VirtualFleet, recorder: BusRecorder) -> None:
        self._fleet = fleet
        self._recorder = recorder

    def origin_ns(self) -> int:
        """Return the origin of fleet time, in host ns; the same for all leaders on one kernel."""
        return next(
            coordinator.leadership.scale.origin_host_ns
            for _, coordinator in self._fleet.coordinators.values()
            if coordinator.leadership.epoch
        )

    def find_steps(self, phase: CampaignPhase) -> list[StepRecord]:
        """Return the steps of the phase's jobs that at least one member was requested to execute, in that order."""
        axes: dict[tuple[str, int], dict[str, Sequence[str]]] = {}
        for arm in self._recorder.find_requests("arm"):
            axes.setdefault(arm.step_id, {})[arm.member] = arm.fields["axes"]
        releases: dict[tuple[str, int], list[list[RecordedRequest]]] = {}
        for go in self._recorder.find_requests("go"):
            if go.job_id in phase.jobs:
                _add_to_part(releases.setdefault(go.step_id, []), go)
        searches = [request for request in self._recorder.find_searches() if request.job_id in phase.jobs]
        records: list[StepRecord] = []
        for search in searches:
            # A controller that hung executes earlier commands whenever it resumes; commands in transit at a stop take
            # effect until the stop arrives.
            until_ns = search.answered_ns
            if until_ns is not None:
                until_ns = None if search.member in phase.unstoppable else until_ns + IN_TRANSIT_NS
            axes_of = {search.member: search.fields["axes"]}
            begins_ns = {(search.member, axis): search.sent_ns for axis in search.fields["axes"]}
            job, index = search.step_id
            records.append(
                StepRecord(
                    job=job,
                    index=index,
                    requested_ns=search.sent_ns,
                    begins_ns=begins_ns,
                    until_ns=until_ns,
                    t0_ns=None,
                    axes=axes_of,
                )
            )
        for step, parts in releases.items():
            for part in parts:
                members = axes[step] if len(parts) == 1 else {go.member: self._find_axes(go) for go in part}
                records.append(self._make_record(step, part, members))
        return sorted(records, key=lambda step: step.requested_ns)

    def _find_axes(self, go: RecordedRequest) -> Sequence[str]:
        """The axes that a member was armed to move at last before it was started: what is left of an interrupted step
        may be the motion of a few."""
        arms = (arm for arm in self._recorder.find_requests("arm") if arm.step_id == go.step_id)
        own_axes = [arm.fields["axes"] for arm in arms if arm.member == go.member and arm.sent_ns <= go.sent_ns]
        return own_axes[-1] if own_axes else ()

    def _make_record(
        self, step: tuple[str, int], releases: Sequence[RecordedRequest], members: Mapping[str, Sequence[str]]
    ) -> StepRecord:
        """The record of a step, or of a part of it, by the requests that have started it."""
        # With a trigger line each member has a T0 of its own.
        t0_ns = min(go.fields["t0_fleet_ns"] for go in releases) + self.origin_ns()
        begins_ns = {
            (name, axis): self.earliest_motion_ns(step, t0_ns, name, axis)
            for name, moved_axes in members.items()
            for axis in moved_axes
        }
        return StepRecord(
            job=step[0],
            index=step[1],
            requested_ns=releases[0].sent_ns,
            begins_ns=begins_ns,
            until_ns=None,
            t0_ns=t0_ns,
            axes=members,
        )

    def earliest_motion_ns(self, step: tuple[str, int], t0_ns: int, name: str, axis: str) -> int:
        """Return the earliest instant at which a motion of an axis may belong to a step that moves it: near its T0,
        nearer than to that of the step that moved this axis before, and after the first arm request. Host ns."""
        earliest_ns = max(t0_ns - STEP_WINDOW_NS, self._recorder.first_arms_ns[step])
        own_ns = t0_ns - self.origin_ns()
        preceding_ns = [
            before_ns
            for part_ns, before_ns in self._recorder.preceding_t0_ns.get((step, name, axis), {}).items()
            if abs(part_ns - own_ns) <= STEP_WINDOW_NS
        ]
        # A step is armed while a shorter one before it runs.
        return max([earliest_ns, *((before_ns + self.origin_ns() + t0_ns) // 2 for before_ns in preceding_ns)])

    def completed_steps(self, report: JobReport | None) -> list[tuple[int, int | None]]:
        """Return index and T0 (host ns) of the completed steps of a job."""
        done_steps = [step for step in report.steps if step.state == "done"] if report is not None else []
        return [
            (step.index, None if step.t0_fleet_ns is None else self.origin_ns() + step.t0_fleet_ns)
            for step in done_steps
        ]

    def find_step(
        self, name: str, axis: str, motion: CommandedMotion, steps: Sequence[StepRecord]
    ) -> StepRecord | None:
        """Return the last step that had begun, or was about to, when the axis began to move."""
        own_records = [step for step in steps if (name, axis) in step.begins_ns]
        begun_records = [step for step in own_records if step.begins_ns[name, axis] <= motion.start_ns]
        if not begun_records or (
            begun_records[-1].until_ns is not None and begun_records[-1].until_ns < motion.start_ns
        ):
            return None
        return begun_records[-1]

    def declared_stop_ns(self, name: str) -> int:
        """Return the stop time that a member declared in its last propose reply."""
        costs = [
            request.reply["costs"]
            for request in self._recorder.find_requests("propose")
            if request.member == name and request.accepted
        ]
        return costs[-1]["stop_ns"] if costs else 0

    def find_axis(self, name: str, motion: CommandedMotion) -> tuple[str, Axis] | None:
        axes = self._fleet.fleet.controllers[name].axes
        return next(((axis_name, axis) for axis_name, axis in axes.items() if axis.motors[0] == motion.axis), None)

    def find_motions(
        self, phase: CampaignPhase, name: str, axis: str, step: tuple[str, int], t0_host_ns: int
    ) -> list[CommandedMotion]:
        """Return the motions of an axis in the step that begins at T0 and moves it, up to the next step, homing or jog.
        Slow motions consist of several pieces."""
        motor = self._fleet.fleet.controllers[name].axes[axis].motors[0]
        later_begins = self._find_later_begins(phase, name, axis, step, t0_host_ns)
        until_ns = min(later_begins, default=None)
        from_ns = self.earliest_motion_ns(step, t0_host_ns, name, axis)
        return [
            motion
            for motion in self._fleet.controllers[name].commanded_motions[phase.motions_before[name] :]
            if motion.axis == motor and motion.start_ns >= from_ns and (until_ns is None or motion.start_ns < until_ns)
        ]

    def _find_later_begins(
        self, phase: CampaignPhase, name: str, axis: str, step: tuple[str, int], t0_host_ns: int
    ) -> Iterator[int]:
        """Find the instants from which motions of an axis belong to something after a step: steps, homings, jogs."""
        motor = self._fleet.fleet.controllers[name].axes[axis].motors[0]
        for go in self._recorder.find_requests("go"):
            if go.member != name or axis not in self._recorder.find_armed_axes(go.step_id, name):
                continue
            t0_ns = go.fields["t0_fleet_ns"] + self.origin_ns()
            # Another part of the same step, after a feed hold, is armed anew.
            if go.step_id == step and t0_ns > t0_host_ns + STEP_WINDOW_NS:
                yield t0_ns - STEP_WINDOW_NS
            elif go.step_id != step and t0_ns > t0_host_ns:
                # Also of a step that was withdrawn before: it may have been meant to begin later than this one.
                yield max(self.earliest_motion_ns(go.step_id, t0_ns, name, axis), (t0_host_ns + t0_ns) // 2)
        searches = (request for request in self._recorder.find_searches() if request.member == name)
        searched_ns = (search.sent_ns for search in searches if axis in search.fields["axes"])
        jogs = (jog.from_ns for jog in phase.jogs if (jog.controller, jog.motor) == (name, motor))
        yield from (begin_ns for begin_ns in (*searched_ns, *jogs) if begin_ns > t0_host_ns)


def _add_to_part(parts: list[list[RecordedRequest]], go: RecordedRequest) -> None:
    """Add a request to the part of its step that it starts: one that was interrupted is started again later."""
    if not parts or abs(go.fields["t0_fleet_ns"] - parts[-1][0].fields["t0_fleet_ns"]) > STEP_WINDOW_NS:
        parts.append([])
    parts[-1].append(go)
