"""Checks of true motions: each belongs to a step or a jog, stays within its limits, and stops in time."""

from collections.abc import Callable, Mapping, Sequence

from orchestrator.campaign.recording.recorder import BusRecorder
from orchestrator.campaign.records import CampaignPhase, PhaseRecords, StepRecord
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.fleet import Axis
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.queue import SESSION_TIMEOUT_NS
from orchestrator.model.report import JobReport
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.core.controller import CommandedMotion

# Longest time from a fault to the start of the deceleration ramp: a silent adapter is detected after 0.7 s (the
# guardian detects a hung one sooner), then the other members are stopped. A requested stop needs no detection.
DETECTION_NS = 1000 * NS_PER_MS
REQUESTED_STOP_NS = 500 * NS_PER_MS
REST_AFTER_END_NS = (
    400 * NS_PER_MS
)  # from the end of a failed job, by the journal, to the rest of its axes, without the ramp
REQUESTED_STOPS = ("stop", "estop", "operator-interrupts", "operator-resets-early", "states-lost")
# Faults after which no waiting job begins until the operator has started the queue.
BREAKS = ("stop", "estop", "operator-resets-early", "fleet-restarted", "disk-bit-flip", "states-lost")
ABSENCE_NS = SESSION_TIMEOUT_NS + REQUESTED_STOP_NS  # from a lost command to the start of the deceleration
JOG_END_NS = 700 * NS_PER_MS  # from the last renewal of a jog to the end of its motion, without the ramp


class MotionChecker:
    """Checks the motions of one fleet.

    untrusted: controllers whose requests cannot be related to their motions; shared with the creator.
    add_violation: called with the invariant and a text.
    """

    def __init__(
        self,
        fleet: VirtualFleet,
        recorder: BusRecorder,
        records: PhaseRecords,
        untrusted: set[str],
        add_violation: Callable[[str, str], None],
    ) -> None:
        self._fleet = fleet
        self._recorder = recorder
        self._records = records
        self._untrusted = untrusted
        self.add_violation = add_violation
        self._whole_fleet = fleet.fleet

    def check_motion(
        self,
        phase: CampaignPhase,
        name: str,
        motion: CommandedMotion,
        steps: Sequence[StepRecord],
        reports: Mapping[str, JobReport | None],
    ) -> None:
        found_axis = self._records.find_axis(name, motion)
        if found_axis is None:
            self.add_violation("1", f"{name}: motor {motion.axis} moved, which belongs to no axis")
            return
        axis_name, axis = found_axis
        label = f"{name}.{axis_name}"
        if motion.end_ns is None:
            self.add_violation("3", f"{label} never ended its motion")
            return
        step = self._records.find_step(name, axis_name, motion, steps)
        # The position is unknown during homing.
        if step is None or step.t0_ns is not None:
            self._check_soft_limits(label, axis, motion)
        if self._check_jog(phase, label, motion, step):
            return
        if step is None:
            self.add_violation("1/2", f"{label} moved at {_format_seconds(motion.start_ns)} without a decision")
            return
        self._check_asked_for(phase, label, motion, step)
        # A controller that hung, or whose replies were lost, executes earlier commands, whichever job has its lease.
        if name not in phase.unstoppable and name not in self._untrusted:
            self._check_lease(label, name, axis_name, motion, step)
        row, report = self._fleet.journal.load_record(step.job), reports[step.job]
        if row is None or row.state == "done" or name in phase.unstoppable:
            return
        if (step.index, step.t0_ns) in self._records.completed_steps(report):
            return
        if step.t0_ns is not None or phase.fault.name != "limit" or self._is_first_motor(name, motion):
            self._check_stop(phase, label, motion, step)
        end_ns = report.transitions[-1].fleet_ns if report is not None and row.state != "interrupted" else None
        ramp_ns = self._ramp_ns(label)
        if end_ns is not None and motion.end_ns > end_ns + self._records.origin_ns() + REST_AFTER_END_NS + ramp_ns:
            late_ns = motion.end_ns - end_ns - self._records.origin_ns()
            self.add_violation("3", f"{label} moved until {_format_seconds(late_ns)} after its job was {row.state}")

    def _check_asked_for(self, phase: CampaignPhase, label: str, motion: CommandedMotion, step: StepRecord) -> None:
        """Check invariant 11: after a break no job moves anything until a person has started the queue, and none of a
        command that has ended."""
        order, broken_ns = phase.jobs.get(step.job), phase.fault_ns
        if order is None or broken_ns is None:
            return
        is_attended = order.terms.session is not None
        if phase.fault.name in BREAKS and not is_attended:
            until_ns = phase.queue_started_ns
            if step.requested_ns > broken_ns + REQUESTED_STOP_NS and (until_ns is None or step.requested_ns < until_ns):
                at = _format_seconds(motion.start_ns)
                self.add_violation(
                    "11", f"{label} moved at {at}, after {phase.fault.name}, and no one had asked for it"
                )
        if not (is_attended and phase.fault.attended and order.job.name == "main"):
            return
        if step.requested_ns > broken_ns + ABSENCE_NS:
            self.add_violation("11", f"{label} moved for a command that had ended ({phase.fault.name})")
        elif controller_of(label) not in self._untrusted:
            # Also when the move has reached its target in spite of it.
            self._check_braking(phase, label, motion)

    def _ramp_ns(self, label: str) -> int:
        """The longest deceleration of the axis `label`: by its limits, or by what its controller declares."""
        limits = self._whole_fleet.axis(label).limits
        declared_ns = self._records.declared_stop_ns(controller_of(label))
        return max(round(limits.velocity / limits.acceleration * NS_PER_S), declared_ns)

    def _is_first_motor(self, name: str, motion: CommandedMotion) -> bool:
        """Whether it is the motor of its controller that a limit switch of the campaign stops; the others continue
        their homing."""
        return motion.axis == self._fleet.controllers[name].axis_names[0]

    def _check_soft_limits(self, label: str, axis: Axis, motion: CommandedMotion) -> None:
        """Check invariant 5."""
        if axis.soft_limits_counts is None or motion.end_counts is None:
            return
        low, high = axis.soft_limits_counts
        if not low - 1 <= motion.end_counts <= high + 1:
            self.add_violation("5", f"{label} moved to {motion.end_counts}; limits {low} to {high}")

    def _check_jog(self, phase: CampaignPhase, label: str, motion: CommandedMotion, step: StepRecord | None) -> bool:
        """Check invariant 3 of a jog; return whether the motion was one."""
        name, axis = split_name(label)
        own_jogs = (record for record in phase.jogs if (record.controller, record.motor) == (name, motion.axis))
        jog = next(
            (record for record in own_jogs if record.from_ns <= motion.start_ns <= record.renewed_ns + JOG_END_NS), None
        )
        # A new leader gave the axis to a job immediately.
        by_job = jog is not None and step is not None and step.begins_ns[name, axis] > jog.from_ns
        if jog is None or by_job:
            return False
        if name in phase.unstoppable or motion.end_ns is None:
            return True
        if motion.end_ns > jog.renewed_ns + JOG_END_NS + self._ramp_ns(label):
            late_ns = motion.end_ns - jog.renewed_ns
            self.add_violation("3", f"{label} moved until {_format_seconds(late_ns)} after the last renewal of its jog")
        is_before = phase.fault_ns is not None and motion.start_ns < phase.fault_ns
        stops = name in phase.affected and (phase.fault.reach != "power" or name == phase.member)
        if is_before and stops and not phase.fault.jog_may_continue:
            self._check_braking(phase, label, motion)
        return True

    def _check_stop(self, phase: CampaignPhase, label: str, motion: CommandedMotion, step: StepRecord) -> None:
        """Check invariant 3: the members that a fault affects stop in time, together with all other members of the
        step."""
        broken_ns, end_ns = phase.fault_ns, motion.end_ns
        if broken_ns is None or end_ns is None or not phase.fault.must_stop or step.requested_ns > broken_ns:
            return
        if set(step.axes) & set(phase.affected):
            self._check_braking(phase, label, motion)

    def _check_braking(self, phase: CampaignPhase, label: str, motion: CommandedMotion) -> None:
        """Check that a motion which a fault affects stops in time."""
        broken_ns, end_ns = phase.fault_ns, motion.end_ns
        if broken_ns is None or end_ns is None or not phase.fault.must_stop:
            return
        since_ns = max(broken_ns, motion.start_ns) if phase.fault.latent else broken_ns
        ramp_ns = self._ramp_ns(label)
        allowed_ns = DETECTION_NS
        if phase.fault.name in REQUESTED_STOPS:
            allowed_ns = REQUESTED_STOP_NS
        elif phase.fault.name == "operator-lost":
            allowed_ns = ABSENCE_NS
        # The deceleration must begin in time; its duration is the one that the member declared.
        slowing_ns = motion.slowing_ns if motion.slowing_ns is not None else end_ns
        if slowing_ns > since_ns + allowed_ns or end_ns > since_ns + allowed_ns + ramp_ns:
            self.add_violation(
                "3", f"{label} moved {_format_seconds(end_ns - broken_ns)} after {phase.fault.name} of {phase.member}"
            )

    def _check_lease(self, label: str, name: str, axis: str, motion: CommandedMotion, step: StepRecord) -> None:
        """Check invariant 7: the step's job had the lease of the axis when it began to move, and no other job
        acquired it before it came to rest."""
        given_requests = [
            request
            for request in self._recorder.find_requests("lease")
            if request.member == name
            and axis in request.fields["axes"]
            and request.fields["ttl_ms"]
            and request.accepted
        ]
        requests_before = [request for request in given_requests if request.sent_ns <= motion.start_ns]
        # A new leader has no record of earlier leases; its jobs wait for motions that still begin or brake.
        epoch = next(
            (request.fields["epoch"] for request in reversed(requests_before) if request.job_id == step.job), None
        )
        if epoch is None or (requests_before[-1].job_id != step.job and requests_before[-1].fields["epoch"] == epoch):
            holder = requests_before[-1].job_id if requests_before else "no job"
            self.add_violation("7", f"{label} moved for job {step.job} while {holder} had its lease")
        for request in given_requests[len(requests_before) :]:
            is_other = request.job_id != step.job and request.fields["epoch"] == epoch
            if motion.end_ns is not None and request.sent_ns < motion.end_ns and is_other:
                late_ns = motion.end_ns - request.sent_ns
                self.add_violation(
                    "7", f"{label} moved for {_format_seconds(late_ns)} more after {request.job_id} acquired its lease"
                )
                break


def _format_seconds(ns: int) -> str:
    return f"{ns / NS_PER_S:.3f} s"
