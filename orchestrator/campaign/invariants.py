"""The invariants of the design (section 7), checked against the ground truth of the simulated controllers."""

from collections.abc import Iterable, Mapping, Sequence

from orchestrator.campaign.faults import FaultKind
from orchestrator.campaign.fleets import HOME_ANYWHERE
from orchestrator.campaign.job_ends import check_end, check_live_job
from orchestrator.campaign.jobs import JobOrder
from orchestrator.campaign.motion_checks import MotionChecker
from orchestrator.campaign.recording.recorder import BusRecorder, RecordedRequest
from orchestrator.campaign.records import STEP_WINDOW_NS, CampaignPhase, PhaseRecords
from orchestrator.campaign.stages.fleet_parts import find_traits
from orchestrator.campaign.stages.flown_scans import find_flown_scan
from orchestrator.campaign.start_checks import AtOnceChecker, find_outlasted
from orchestrator.campaign.watched_axes import WatchedAxes
from orchestrator.campaign.zone_checks import ends_at_a_zone, may_be_refused
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.report import FINISHED_STATES, JobReport, MemberReport, StepReport
from orchestrator.model.state import AxisEvidence, ControllerState, TimeInterval
from orchestrator.runtime.virtual.fleet import VirtualFleet

GREEN_TOLERANCE_S = 0.05  # of a duration that a green verdict stands for: the evidence is an interval
CRYSTAL_SHARE = 2e-4  # of the duration, for the controller's crystal
HOMING_SPREAD_COUNTS = 2  # largest difference between two homings of one axis


class InvariantChecker:
    """Checks one fleet. Violations are collected in `violations`."""

    def __init__(self, fleet: VirtualFleet, recorder: BusRecorder, seed: int = 0) -> None:
        self.violations: list[str] = []
        self._fleet = fleet
        self._recorder = recorder
        self._whole_fleet = fleet.fleet
        self._untrusted: set[str] = set()
        self._speeds: dict[tuple[str, str], tuple[int, float]] = {}
        self._home_offsets: dict[str, float] = {}
        self._position_lost: set[str] = set()
        self.starts = AtOnceChecker(fleet.journal, self.add_violation)
        self._changed_crystals: set[str] = set()
        self._records = PhaseRecords(fleet, recorder)
        self.watched = WatchedAxes(fleet, recorder, self._records, seed, self.add_violation)
        self._motions = MotionChecker(fleet, recorder, self._records, self._untrusted, self.add_violation)

    def add_violation(self, invariant: str, text: str) -> None:
        self.violations.append(f"invariant {invariant}: {text}")

    # During a run

    def note_request(self, request: RecordedRequest) -> None:
        """Check a request to a member when it is sent and when it is answered."""
        self.starts.check_request(request)
        self.watched.note_request(request)

    def check_velocities(self, now_ns: int) -> None:
        """Check invariant 5 for moving axes: velocity, and its growth."""
        for name, unit in self._fleet.controllers.items():
            for axis in self._whole_fleet.controllers[name].axes.values():
                motor = axis.motors[0]
                moves = unit.is_moving(motor)
                if not moves:
                    self._speeds.pop((name, motor), None)
                    continue
                speed = abs(unit.velocity(motor))
                scale = float(axis.counts_per_unit)
                begin = axis.start_rate.max * scale if axis.start_rate else 0.0
                most = axis.limits.velocity * scale
                if speed > most * 1.02 + begin:
                    self.add_violation("5", f"{name}.{motor} moves at {speed:.0f} counts/s; its limit is {most:.0f}")
                then_ns, speed_before = self._speeds.get((name, motor), (now_ns, speed))
                grown_acceleration = axis.limits.acceleration * scale * (now_ns - then_ns) / NS_PER_S
                if speed - speed_before > grown_acceleration * 1.1 + 2 * begin + most * 0.01:
                    self.add_violation(
                        "5", f"{name}.{motor}: accelerated from {speed_before:.0f} to {speed:.0f} counts/s too quickly"
                    )
                self._speeds[name, motor] = (now_ns, speed)

    def check_positions(self, states: Mapping[str, ControllerState]) -> None:
        """Check invariant 5 at rest: an axis that is reported as referenced is there. states: current ones."""
        for name, state in states.items():
            for axis_name, axis in self._whole_fleet.controllers[name].axes.items():
                axis_state, label = state.axes[axis_name], f"{name}.{axis_name}"
                # Some axes take their current position, or the nearest index, as reference when they are homed.
                anywhere = axis.homing.method in HOME_ANYWHERE or name in self._position_lost
                if state.mode == "offline" or not axis_state.referenced or anywhere:
                    continue
                origin = self._fleet.controllers[name].physical_position(axis.motors[0]) - axis_state.commanded_counts
                off = origin - self._home_offsets.setdefault(label, origin)
                if abs(off) > HOMING_SPREAD_COUNTS:
                    self.add_violation(
                        "5", f"{label} is reported as referenced, but its position is off by {off:g} counts"
                    )

    def note_fault(self, fault: FaultKind, member: str, affected: Iterable[str]) -> None:
        """Note a fault that was injected: some evidence cannot be right then. affected: controllers."""
        if fault.outside_model:
            self._untrusted |= set(affected)
        if fault.name == "crystal":
            self._changed_crystals.add(member)
        if _loses_position(fault, self._whole_fleet.controllers[member].adapter):
            self._position_lost.add(member)

    # After a phase

    def check_phase(self, phase: CampaignPhase) -> None:
        """Check all motions of a phase against the recorded decisions, and the final states of its jobs."""
        if phase.fault_ns is not None:
            self.note_fault(phase.fault, phase.member, phase.affected)
        steps = self._records.find_steps(phase)
        reports = {job_id: self._fleet.journal.load_report(job_id) for job_id in phase.jobs}
        self._check_promises(phase)
        for text in (*self._recorder.starts.take_unasked(), *find_outlasted(self._recorder.requests, phase)):
            self.add_violation("11", text)
        self._check_jobs(phase, reports)
        for name in self._whole_fleet.controllers:
            motions = self._fleet.controllers[name].commanded_motions[phase.motions_before[name] :]
            for motion in motions:
                self._motions.check_motion(phase, name, motion, steps, reports)
            if name not in phase.at_rest:
                self.add_violation("3", f"{name} is not at rest after the end of all jobs")
        self.watched.check_phase(phase, steps, reports, self._untrusted)
        for job_id, report in reports.items():
            for step in report.steps if report is not None else []:
                self._check_evidence(phase, job_id, step)
        # A crystal whose rate was changed keeps the new rate.
        self._untrusted &= self._changed_crystals

    def _check_promises(self, phase: CampaignPhase) -> None:
        """Check invariants 1, 7, 9 and 10 on the requests: no member receives `go` before all have made the same
        promise."""
        asked_requests = [
            request for request in self._recorder.requests if request.verb == "lease" or request.job_id in phase.jobs
        ]
        highest: dict[str, int] = {}
        for request in asked_requests:
            if request.accepted and request.fields["epoch"] < highest.get(request.member, 0):
                self.add_violation(
                    "9",
                    f"{request.member} accepted {request.verb} of epoch {request.fields['epoch']} after a newer one",
                )
            if request.accepted:
                highest[request.member] = max(highest.get(request.member, 0), request.fields["epoch"])
        promises: dict[tuple[str, int], list[RecordedRequest]] = {}
        for request in asked_requests:
            if request.verb in ("arm", "commit"):
                promises.setdefault(request.step_id, []).append(request)
        parts: dict[tuple[str, int], tuple[RecordedRequest, int]] = {}
        for go in (request for request in asked_requests if request.verb == "go"):
            since_ns = _find_part(parts, go)
            requests_before = [
                request for request in promises.get(go.step_id, ()) if since_ns < request.sent_ns < go.sent_ns
            ]
            self._check_release(go, requests_before)
        if phase.fault.name == "host-other-file" and phase.fault_ns is not None and phase.repair_ns is not None:
            for request in asked_requests:
                is_between = phase.fault_ns < request.sent_ns < phase.repair_ns
                has_begun = request.verb in ("home", "arm") and request.accepted
                if has_begun and request.member == phase.member and is_between:
                    self.add_violation(
                        "10", f"{request.member} accepted {request.verb} with a configuration other than its host's"
                    )

    def _check_release(self, go: RecordedRequest, before: Sequence[RecordedRequest]) -> None:
        """Check invariant 1 for one `go`: every member of the last arming has made its promise. Arming again with a
        longer lead time starts over."""
        last: dict[str, dict[str, RecordedRequest]] = {}
        for request in before:
            if request.fields["epoch"] == go.fields["epoch"]:
                last.setdefault(request.member, {})[request.verb] = request
        for member in sorted(last):
            if "arm" in last[member]:
                self._check_promise(go, member, last[member])

    def _check_promise(self, go: RecordedRequest, member: str, last: Mapping[str, RecordedRequest]) -> None:
        """Check invariant 1: `member` was armed, and has promised, before any member received `go`. last: the last
        request to it, by verb."""
        begins_ns = go.fields["t0_fleet_ns"] + go.fields["advance_ns"]
        shift_ns = abs(last["arm"].fields["t0_fleet_ns"] - begins_ns)
        for verb in ("arm", "commit"):
            request = last.get(verb)
            is_kept = (
                request is not None
                and request.accepted
                and request.answered_ns is not None
                and request.answered_ns <= go.sent_ns
            )
            if not is_kept:
                self.add_violation("1", f"{go.member} received go for {go.step_id} before {member} had answered {verb}")
        if "commit" in last and last["commit"].promise_terms != last["arm"].promise_terms:
            self.add_violation(
                "1", f"{member} was armed for {last['arm'].promise_terms} and promised {last['commit'].promise_terms}"
            )
        # Members on a trigger line begin at instants of their own.
        if shift_ns > (0 if member == go.member else STEP_WINDOW_NS):
            self.add_violation(
                "1", f"{member} was armed for another T0 than {go.member}, by {shift_ns / NS_PER_MS:g} ms"
            )

    def _check_jobs(self, phase: CampaignPhase, reports: Mapping[str, JobReport | None]) -> None:
        """Check invariants 6 and 7: every job ends exactly once, and jobs that the fault does not affect are done."""
        journal = self._fleet.journal
        is_broken = phase.fault_ns is not None
        for job_id, order in phase.jobs.items():
            row, report = journal.load_record(job_id), reports[job_id]
            if row is None:
                self.add_violation("6", f"job {job_id} was accepted, but is missing from the journal")
                continue
            if row.state not in FINISHED_STATES or report is None:
                self.add_violation("6", f"job {order.job.name} has not ended: {row.state} ({row.reason})")
                continue
            check_end(journal, row, report, order.job, self.add_violation)
            if order.asked_steps:
                check_live_job(journal, row, self.add_violation)
            if row.state == "done":
                continue
            if not row.reason:
                self.add_violation("3", f"job {order.job.name} is {row.state} without a reason")
            touched_controllers = (
                is_broken and not phase.fault.harmless and set(order.controllers) & set(phase.affected)
            )
            is_refused = ends_at_a_zone(report, row.reason) and may_be_refused(phase, order)
            if not touched_controllers and not is_refused:
                self.add_violation(
                    "7", f"job {order.job.name}, which the fault does not affect, is {row.state}: {row.reason}"
                )

    # Evidence

    def _check_evidence(self, phase: CampaignPhase, job_id: str, step: StepReport) -> None:
        """Check invariant 8: every reported interval contains the true instant, and starts lie in their promised
        windows."""
        if step.t0_fleet_ns is None:
            return
        origin_ns, t0_ns = self._records.origin_ns(), step.t0_fleet_ns
        driven_targets = {
            connection.target for connection in self._whole_fleet.connections if connection.source in self._untrusted
        }
        for name, member in step.members.items():
            # A member started by a trigger line begins when the driving controller does.
            if name in self._untrusted or (member.start_class == "line" and name in driven_targets):
                continue
            for axis, evidence in _list_evidence(phase.jobs[job_id], name, member):
                label = f"{name}.{axis} of {phase.jobs[job_id].job.name}"
                truth = self._records.find_motions(phase, name, axis, (job_id, step.index), origin_ns + t0_ns)
                if not truth:
                    self.add_violation("8", f"{label} reports a start and did not move")
                    continue
                start_ns, end_ns = truth[0].start_ns - origin_ns, truth[-1].end_ns
                self._check_contains(f"{label} start", evidence.start, start_ns)
                if step.state == "done" and evidence.end is not None and end_ns is not None:
                    self._check_contains(f"{label} end", evidence.end, end_ns - origin_ns)
                if step.state == "done" and step.verdict == "green" and end_ns is not None:
                    taken_s = (truth[-1].end_ns - truth[0].start_ns) / NS_PER_S if truth[-1].end_ns else 0.0
                    self._check_green(label, taken_s, member.lowered_s.get(axis))
                window = step.budget.members.get(name) if step.budget and not step.budget.by_trigger_line else None
                if window is not None and not self._is_delayed(name, member, truth[0].start_ns):
                    promised_interval = TimeInterval(
                        earliest_ns=t0_ns + window.earliest_ns, latest_ns=t0_ns + window.latest_ns
                    )
                    self._check_contains(f"{label} promised start", promised_interval, start_ns)

    def _check_green(self, label: str, taken_s: float, promised_s: float | None) -> None:
        """Check invariant 12: the axes of a green step have moved as they were planned."""
        if promised_s is not None and abs(taken_s - promised_s) > GREEN_TOLERANCE_S + promised_s * CRYSTAL_SHARE:
            self.add_violation(
                "12", f"{label} took {taken_s:.3f} s, promised {promised_s:.3f} s, and the verdict is green"
            )

    def _is_delayed(self, name: str, member: MemberReport, start_ns: int) -> bool:
        """Whether a start command may have been delayed by more than the model of its connection allows."""
        return member.start_class in ("host", "sync") and self._fleet.wires[name].delayed_start(start_ns)

    def _check_contains(self, what: str, claimed: TimeInterval, truth_ns: int) -> None:
        if not claimed.earliest_ns <= truth_ns <= claimed.latest_ns:
            self.add_violation("8", f"{what} at {truth_ns}, claimed {claimed.earliest_ns} to {claimed.latest_ns}")


def _list_evidence(order: JobOrder, name: str, member: MemberReport) -> list[tuple[str, AxisEvidence]]:
    """The evidence of the axes of a member. In a flight only the one that flies moves from its start on; the others
    rest in the first line."""
    scan = find_flown_scan(order.job)
    return [
        (axis, evidence)
        for axis, evidence in member.evidence.items()
        if scan is None or scan.flown_axis == f"{name}.{axis}"
    ]


def _loses_position(fault: FaultKind, make: str) -> bool:
    """Whether the position of a member of this make can no longer be determined: it was stalled, or the limit switch
    that was pressed is its reference."""
    return fault.name == "stall" or (fault.name == "limit" and find_traits(make).references_at_limit)


def _find_part(parts: dict[tuple[str, int], tuple[RecordedRequest, int]], go: RecordedRequest) -> int:
    """The instant since which requests belong to the part of a step that `go` starts, host ns: a step that was
    interrupted is armed again, for the members that still have to move. parts: of the releases before this one; by
    step, the first release of its last part, and that instant."""
    first, since_ns = parts.get(go.step_id, (go, -1))
    if abs(first.fields["t0_fleet_ns"] - go.fields["t0_fleet_ns"]) > STEP_WINDOW_NS:
        first, since_ns = go, first.sent_ns
    parts[go.step_id] = first, since_ns
    return since_ns
