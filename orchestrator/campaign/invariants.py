"""The invariants of the design (section 7), checked against the ground truth of the simulated controllers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from orchestrator.campaign.faults import Fault
from orchestrator.campaign.fleets import HERE
from orchestrator.campaign.jobs import Order
from orchestrator.campaign.recorder import Asked, Witness
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.fleet import Axis
from orchestrator.model.report import FINISHED_STATES, JobReport, MemberReport, StepReport
from orchestrator.model.state import ControllerState, TimeInterval
from orchestrator.runtime.virtual import VirtualFleet
from sim.core.controller import CommandedMotion

# Longest time from a fault to the start of the deceleration ramp: a silent adapter is detected after 0.7 s (the
# guardian detects a hung one sooner), then the other members are stopped. A requested stop needs no detection.
DETECTION_NS = 1000 * NS_PER_MS
ASKED_NS = 500 * NS_PER_MS
# A motion belongs to a step when it begins this near to its T0, or during it; but not before any member was armed for
# the step: the first step of a new leader can follow the step that it stopped sooner than this.
WINDOW_NS = 300 * NS_PER_MS
LOOK_NS = 400 * NS_PER_MS  # from the end of a failed job, by the journal, to the rest of its axes, without the ramp
ORIGIN_COUNTS = 2  # largest difference between two homings of one axis
# after homing was abandoned: earlier commands still take effect, and the stop follows them
ON_WIRE_NS = 100 * NS_PER_MS
BY_HAND_NS = 700 * NS_PER_MS  # from the last renewal of a jog to the end of its motion, without the ramp


@dataclass(frozen=True, slots=True)
class Jog:
    """A jogged axis. Instants in host ns."""

    controller: str
    motor: str
    from_ns: int
    renewed_ns: int


@dataclass(slots=True)
class Act:
    """One phase of a run: the jobs submitted, the fault injected, and the motions made.

    jobs: job orders by job id.
    before: number of earlier motions of each controller.
    touched: controllers that the fault affects.

    Instants in host ns, None for events that have not happened.
    """

    fault: Fault
    member: str
    touched: list[str]
    before: dict[str, int]
    jobs: dict[str, Order] = field(default_factory=dict[str, Order])
    jogs: list[Jog] = field(default_factory=list[Jog])
    broken_ns: int | None = None
    mended_ns: int | None = None
    resting: set[str] = field(default_factory=set[str])

    @property
    def deaf(self) -> set[str]:
        """Controllers that could not be stopped during the fault."""
        if self.broken_ns is None or self.fault.must_stop is False:
            return set()
        # A controller of a daisy chain that is off disconnects those after it from the link.
        off = self.fault.reach == "power"
        return set(self.touched) - ({self.member} if off else set()) if off or self.fault.deaf else set()


@dataclass(frozen=True, slots=True)
class _Step:
    """A step whose members received `go`, or the homing of one member, by the recorded requests.

    from_ns, until_ns: a motion that begins between them belongs to the step.
    t0_ns: None for a homing.

    Instants in host ns."""

    job: str
    index: int
    asked_ns: int
    from_ns: int
    until_ns: int | None
    t0_ns: int | None
    axes: Mapping[str, Sequence[str]]


class Judge:
    """Checks one fleet. Violations are collected in `violations`."""

    def __init__(self, fleet: VirtualFleet, witness: Witness) -> None:
        self.violations: list[str] = []
        self._fleet = fleet
        self._witness = witness
        self._whole = fleet.fleet
        self._strange: set[str] = set()
        self._speeds: dict[tuple[str, str], tuple[int, float]] = {}
        self._origins: dict[str, float] = {}
        self._placeless: set[str] = set()
        self._off_beat: set[str] = set()

    def violate(self, invariant: str, text: str) -> None:
        self.violations.append(f"invariant {invariant}: {text}")

    # During a run

    def look(self, now_ns: int) -> None:
        """Check invariant 5 for moving axes: velocity, and its growth."""
        for name, unit in self._fleet.controllers.items():
            for axis in self._whole.controllers[name].axes.values():
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
                    self.violate("5", f"{name}.{motor} moves at {speed:.0f} counts/s; its limit is {most:.0f}")
                then_ns, before = self._speeds.get((name, motor), (now_ns, speed))
                grown = axis.limits.acceleration * scale * (now_ns - then_ns) / NS_PER_S
                if speed - before > grown * 1.1 + 2 * begin + most * 0.01:
                    self.violate(
                        "5", f"{name}.{motor}: accelerated from {before:.0f} to {speed:.0f} counts/s too quickly"
                    )
                self._speeds[name, motor] = (now_ns, speed)

    def judge_places(self, states: Mapping[str, ControllerState]) -> None:
        """Check invariant 5 at rest: an axis that is reported as referenced is at its reported position. states:
        current states from the adapters."""
        for name, state in states.items():
            for axis_name, axis in self._whole.controllers[name].axes.items():
                told, label = state.axes[axis_name], f"{name}.{axis_name}"
                # Some axes take their current position as reference when they are homed.
                anywhere = axis.homing.method == HERE or name in self._placeless
                if state.mode == "offline" or not told.referenced or anywhere:
                    continue
                origin = self._fleet.controllers[name].physical_position(axis.motors[0]) - told.commanded_counts
                off = origin - self._origins.setdefault(label, origin)
                if abs(off) > ORIGIN_COUNTS:
                    self.violate("5", f"{label} is reported as referenced, but its position is off by {off:g} counts")

    def _loses_place(self, act: Act) -> bool:
        """Return whether the member's position can no longer be determined: it was stalled, or the limit switch that
        was pressed is its reference."""
        make = self._whole.controllers[act.member].adapter
        return act.fault.name == "stall" or (act.fault.name == "limit" and make == "smc30")

    # After a phase

    def judge(self, act: Act) -> None:
        """Check all motions of a phase against the recorded decisions, and the final states of its jobs."""
        if act.broken_ns is not None and act.fault.beyond:
            self._strange |= set(act.touched)
        if act.broken_ns is not None and act.fault.name == "crystal":
            self._off_beat.add(act.member)
        if act.broken_ns is not None and self._loses_place(act):
            self._placeless.add(act.member)
        steps = self._steps(act)
        reports = {job_id: self._fleet.journal.load_report(job_id) for job_id in act.jobs}
        self._judge_promises(act)
        self._judge_jobs(act, reports)
        for name in self._whole.controllers:
            made = self._fleet.controllers[name].commanded_motions[act.before[name] :]
            for motion in made:
                self._judge_motion(act, name, motion, steps, reports)
            if name not in act.resting:
                self.violate("3", f"{name} is not at rest after the end of all jobs")
        for job_id, report in reports.items():
            for step in report.steps if report is not None else []:
                self._judge_evidence(act, job_id, step)
        # A crystal whose rate was changed keeps the new rate.
        self._strange &= self._off_beat

    def _origin_ns(self) -> int:
        """Return the origin of fleet time, in host ns; the same for all leaders on one kernel."""
        return next(
            each.leadership.scale.origin_host_ns
            for _, each in self._fleet.coordinators.values()
            if each.leadership.epoch
        )

    def _steps(self, act: Act) -> list[_Step]:
        """Return the steps of the phase's jobs that at least one member was requested to execute, in that order."""
        axes: dict[tuple[str, int], dict[str, Sequence[str]]] = {}
        for arm in self._witness.of("arm"):
            axes.setdefault(arm.step, {})[arm.member] = arm.said["axes"]
        gone: dict[tuple[str, int], list[Asked]] = {}
        for go in self._witness.of("go"):
            if go.job in act.jobs:
                gone.setdefault(go.step, []).append(go)
        homes = [each for each in self._witness.of("home") if each.job in act.jobs]
        found: list[_Step] = []
        for home in homes:
            # A controller that hung executes earlier commands whenever it resumes; commands in transit at a stop take
            # effect until the stop arrives.
            until_ns = home.answered_ns
            if until_ns is not None:
                until_ns = None if home.member in act.deaf else until_ns + ON_WIRE_NS
            axes_of = {home.member: home.said["axes"]}
            found.append(_Step(*home.step, home.asked_ns, home.asked_ns, until_ns, None, axes_of))
        for (job, index), each in gone.items():
            # With a trigger line each member has a T0 of its own.
            t0_ns = min(go.said["t0_fleet_ns"] for go in each) + self._origin_ns()
            from_ns = self._from_ns((job, index), t0_ns)
            found.append(_Step(job, index, each[0].asked_ns, from_ns, None, t0_ns, axes[job, index]))
        return sorted(found, key=lambda step: step.asked_ns)

    def _from_ns(self, step: tuple[str, int], t0_ns: int) -> int:
        """Return the earliest instant at which a motion may belong to the step: near its T0, and after the first arm
        request. Host ns."""
        armed_ns = min(arm.asked_ns for arm in self._witness.of("arm") if arm.step == step)
        return max(t0_ns - WINDOW_NS, armed_ns)

    def _judge_promises(self, act: Act) -> None:
        """Check invariants 1, 7, 9 and 10 on the requests: no member receives `go` before all have made the same
        promise."""
        asked = [each for each in self._witness.asked if each.verb == "lease" or each.job in act.jobs]
        highest: dict[str, int] = {}
        for each in asked:
            if each.taken and each.said["epoch"] < highest.get(each.member, 0):
                self.violate("9", f"{each.member} accepted {each.verb} of epoch {each.said['epoch']} after a newer one")
            if each.taken:
                highest[each.member] = max(highest.get(each.member, 0), each.said["epoch"])
        for go in (each for each in asked if each.verb == "go"):
            before = [each for each in asked if each.asked_ns < go.asked_ns and each.verb in ("arm", "commit")]
            of_step = [each for each in before if each.step == go.step and each.said["epoch"] == go.said["epoch"]]
            # The members of the last arming: arming again with a longer lead time starts over.
            members = {each.member for each in of_step if each.verb == "arm"}
            for member in sorted(members):
                self._judge_promise(go, member, of_step)
        if act.fault.name == "host-other-file" and act.broken_ns is not None and act.mended_ns is not None:
            for each in asked:
                between = act.broken_ns < each.asked_ns < act.mended_ns
                begun = each.verb in ("home", "arm") and each.taken
                if begun and each.member == act.member and between:
                    self.violate("10", f"{each.member} accepted {each.verb} with a configuration other than its host's")

    def _judge_promise(self, go: Asked, member: str, before: Sequence[Asked]) -> None:
        """Check invariant 1: `member` was armed, and has promised, before any member received `go`."""
        last: dict[str, Asked] = {each.verb: each for each in before if each.member == member}
        begins_ns = go.said["t0_fleet_ns"] + go.said["advance_ns"]
        shift_ns = abs(last["arm"].said["t0_fleet_ns"] - begins_ns)
        for verb in ("arm", "commit"):
            each = last.get(verb)
            kept = each is not None and each.taken and each.answered_ns is not None and each.answered_ns <= go.asked_ns
            if not kept:
                self.violate("1", f"{go.member} received go for {go.step} before {member} had answered {verb}")
        if "commit" in last and last["commit"].promise != last["arm"].promise:
            self.violate("1", f"{member} was armed for {last['arm'].promise} and promised {last['commit'].promise}")
        # Members on a trigger line begin at instants of their own.
        if shift_ns > (0 if member == go.member else WINDOW_NS):
            self.violate("1", f"{member} was armed for another T0 than {go.member}, by {shift_ns / NS_PER_MS:g} ms")

    def _judge_jobs(self, act: Act, reports: Mapping[str, JobReport | None]) -> None:
        """Check invariants 6 and 7: every job ends exactly once, and jobs that the fault does not affect are done."""
        journal = self._fleet.journal
        broken = act.broken_ns is not None
        for job_id, order in act.jobs.items():
            row, report = journal.load_record(job_id), reports[job_id]
            if row is None:
                self.violate("6", f"job {job_id} was accepted, but is missing from the journal")
                continue
            if row.state not in FINISHED_STATES or report is None:
                self.violate("6", f"job {order.job.name} has not ended: {row.state} ({row.reason})")
                continue
            ends = sum(change.state in FINISHED_STATES for change in report.transitions)
            decided = [step for step, _ in journal.list_decisions(job_id)]
            if ends != 1 or len(set(decided)) != len(decided):
                self.violate("6", f"job {order.job.name} ended {ends} times; decisions for its steps: {decided}")
            if row.state == "done":
                continue
            if not row.reason:
                self.violate("3", f"job {order.job.name} is {row.state} without a reason")
            touched = broken and not act.fault.harmless and set(order.controllers) & set(act.touched)
            if not touched:
                self.violate(
                    "7", f"job {order.job.name}, which the fault does not affect, is {row.state}: {row.reason}"
                )

    # Motions

    def _judge_motion(
        self,
        act: Act,
        name: str,
        motion: CommandedMotion,
        steps: Sequence[_Step],
        reports: Mapping[str, JobReport | None],
    ) -> None:
        found = self._axis(name, motion)
        if found is None:
            self.violate("1", f"{name}: motor {motion.axis} moved, which belongs to no axis")
            return
        axis_name, axis = found
        ramp_ns = max(round(axis.limits.velocity / axis.limits.acceleration * NS_PER_S), self._declared_ns(name))
        label = f"{name}.{axis_name}"
        if motion.end_ns is None:
            self.violate("3", f"{label} never ended its motion")
            return
        step = self._step_of(name, axis_name, motion, steps)
        limits = axis.soft_limits_counts
        # The position is unknown during homing.
        if limits is not None and motion.end_counts is not None and (step is None or step.t0_ns is not None):
            low, high = limits
            if not low - 1 <= motion.end_counts <= high + 1:
                self.violate("5", f"{label} moved to {motion.end_counts}; limits {low} to {high}")
        jog = next((each for each in act.jogs if (each.controller, each.motor) == (name, motion.axis)), None)
        # A new leader gave the axis to a job immediately.
        by_job = jog is not None and step is not None and step.from_ns > jog.from_ns
        if jog is not None and not by_job and jog.from_ns <= motion.start_ns <= jog.renewed_ns + BY_HAND_NS:
            if motion.end_ns > jog.renewed_ns + BY_HAND_NS + ramp_ns and name not in act.deaf:
                self.violate(
                    "3", f"{label} moved until {_s(motion.end_ns - jog.renewed_ns)} after the last renewal of its jog"
                )
            before = act.broken_ns is not None and motion.start_ns < act.broken_ns
            stops = name in act.touched and (act.fault.reach != "power" or name == act.member)
            if before and stops and not act.fault.hands_on and name not in act.deaf:
                self._judge_brake(act, label, motion, ramp_ns)
            return
        if step is None:
            self.violate("1/2", f"{label} moved at {_s(motion.start_ns)} without a decision")
            return
        # A controller that hung, or whose replies were lost, executes earlier commands, whichever job has its lease.
        if name not in act.deaf and name not in self._strange:
            self._judge_lease(label, name, axis_name, motion, step)
        row, report = self._fleet.journal.load_record(step.job), reports[step.job]
        if row is None or row.state == "done" or name in act.deaf:
            return
        if (step.index, step.t0_ns) in self._done(report):
            return
        self._judge_stop(act, label, motion, step, ramp_ns, motion.axis == self._fleet.controllers[name].axis_names[0])
        ended = report.transitions[-1].fleet_ns if report is not None and row.state != "interrupted" else None
        if ended is not None and motion.end_ns > ended + self._origin_ns() + LOOK_NS + ramp_ns:
            late_ns = motion.end_ns - ended - self._origin_ns()
            self.violate("3", f"{label} moved until {_s(late_ns)} after its job was {row.state}")

    def _judge_stop(
        self, act: Act, label: str, motion: CommandedMotion, step: _Step, ramp_ns: int, first: bool
    ) -> None:
        """Check invariant 3: the members that a fault affects stop in time, together with all other members of the
        step. first: the motor is the one of its controller that a single-motor fault affects."""
        broken_ns, end_ns = act.broken_ns, motion.end_ns
        if broken_ns is None or end_ns is None or not act.fault.must_stop or step.asked_ns > broken_ns:
            return
        if not set(step.axes) & set(act.touched):
            return
        if step.t0_ns is None and act.fault.name == "limit" and not first:
            return  # the other motors of the controller continue their homing
        self._judge_brake(act, label, motion, ramp_ns)

    def _judge_brake(self, act: Act, label: str, motion: CommandedMotion, ramp_ns: int) -> None:
        """Check that a motion which a fault affects stops in time."""
        broken_ns, end_ns = act.broken_ns, motion.end_ns
        if broken_ns is None or end_ns is None or not act.fault.must_stop:
            return
        since_ns = max(broken_ns, motion.start_ns) if act.fault.latent else broken_ns
        allowed_ns = ASKED_NS if act.fault.name in ("stop", "estop") else DETECTION_NS
        # The deceleration must begin in time; its duration is the one that the member declared.
        slowing_ns = motion.slowing_ns if motion.slowing_ns is not None else end_ns
        if slowing_ns > since_ns + allowed_ns or end_ns > since_ns + allowed_ns + ramp_ns:
            self.violate("3", f"{label} moved {_s(end_ns - broken_ns)} after {act.fault.name} of {act.member}")

    def _judge_lease(self, label: str, name: str, axis: str, motion: CommandedMotion, step: _Step) -> None:
        """Check invariant 7: the step's job had the lease of the axis when it began to move, and no other job
        acquired it before it came to rest."""
        given = [
            each
            for each in self._witness.of("lease")
            if each.member == name and axis in each.said["axes"] and each.said["ttl_ms"] and each.taken
        ]
        before = [each for each in given if each.asked_ns <= motion.start_ns]
        # A new leader has no record of earlier leases; its jobs wait for motions that still begin or brake.
        epoch = next((each.said["epoch"] for each in reversed(before) if each.job == step.job), None)
        if epoch is None or (before[-1].job != step.job and before[-1].said["epoch"] == epoch):
            holder = before[-1].job if before else "nobody"
            self.violate("7", f"{label} moved for job {step.job} while {holder} had its lease")
        for each in given[len(before) :]:
            other = each.job != step.job and each.said["epoch"] == epoch
            if motion.end_ns is not None and each.asked_ns < motion.end_ns and other:
                late_ns = motion.end_ns - each.asked_ns
                self.violate("7", f"{label} moved for {_s(late_ns)} more after {each.job} acquired its lease")
                break

    def _done(self, report: JobReport | None) -> list[tuple[int, int | None]]:
        """Return index and T0 (host ns) of the completed steps of a job."""
        done = [step for step in report.steps if step.state == "done"] if report is not None else []
        return [
            (step.index, None if step.t0_fleet_ns is None else self._origin_ns() + step.t0_fleet_ns) for step in done
        ]

    def _step_of(self, name: str, axis: str, motion: CommandedMotion, steps: Sequence[_Step]) -> _Step | None:
        """Return the last step that had begun, or was about to, when the axis began to move."""
        mine = [step for step in steps if axis in step.axes.get(name, ())]
        begun = [step for step in mine if step.from_ns <= motion.start_ns]
        if not begun or (begun[-1].until_ns is not None and begun[-1].until_ns < motion.start_ns):
            return None
        return begun[-1]

    def _declared_ns(self, name: str) -> int:
        """Return the stop time that a member declared in its last propose reply."""
        costs = [each.reply["costs"] for each in self._witness.of("propose") if each.member == name and each.taken]
        return costs[-1]["stop_ns"] if costs else 0

    def _axis(self, name: str, motion: CommandedMotion) -> tuple[str, Axis] | None:
        axes = self._whole.controllers[name].axes
        return next(((each, axis) for each, axis in axes.items() if axis.motors[0] == motion.axis), None)

    # Evidence

    def _judge_evidence(self, act: Act, job_id: str, step: StepReport) -> None:
        """Check invariant 8: every reported interval contains the true instant, and starts lie in their promised
        windows."""
        if step.t0_fleet_ns is None:
            return
        origin_ns, t0_ns = self._origin_ns(), step.t0_fleet_ns
        driven = {each.target for each in self._whole.connections if each.source in self._strange}
        for name, member in step.members.items():
            # A member started by a trigger line begins when the driving controller does.
            if name in self._strange or (member.start_class == "line" and name in driven):
                continue
            axes = self._whole.controllers[name].axes
            for axis, evidence in member.evidence.items():
                label = f"{name}.{axis} of {act.jobs[job_id].job.name}"
                motor = axes[axis].motors[0]
                truth = self._truth(act, name, motor, (job_id, step.index), origin_ns + t0_ns)
                if not truth:
                    self.violate("8", f"{label} reports a start and did not move")
                    continue
                start_ns, end_ns = truth[0].start_ns - origin_ns, truth[-1].end_ns
                self._contain(f"{label} start", evidence.start, start_ns)
                if step.state == "done" and evidence.end is not None and end_ns is not None:
                    self._contain(f"{label} end", evidence.end, end_ns - origin_ns)
                window = step.budget.members.get(name) if step.budget and not step.budget.by_trigger_line else None
                if window is not None and not self._came_late(name, member, truth[0].start_ns):
                    promised = TimeInterval(earliest_ns=t0_ns + window.earliest_ns, latest_ns=t0_ns + window.latest_ns)
                    self._contain(f"{label} promised start", promised, start_ns)

    def _came_late(self, name: str, member: MemberReport, start_ns: int) -> bool:
        """Return whether the start command may have been delayed by more than the model of its connection allows."""
        return member.start_class in ("host", "sync") and self._fleet.wires[name].kept_a_start(start_ns)

    def _truth(self, act: Act, name: str, motor: str, step: tuple[str, int], t0_host_ns: int) -> list[CommandedMotion]:
        """Return the motions of an axis in the step that begins at T0, up to the next step. Slow motions consist of
        several pieces."""
        t0s = [each.said["t0_fleet_ns"] + self._origin_ns() for each in self._witness.of("go") if each.member == name]
        until_ns = min((each for each in t0s if each > t0_host_ns + WINDOW_NS), default=None)
        from_ns = self._from_ns(step, t0_host_ns)
        return [
            each
            for each in self._fleet.controllers[name].commanded_motions[act.before[name] :]
            if each.axis == motor
            and each.start_ns >= from_ns
            and (until_ns is None or each.start_ns < until_ns - WINDOW_NS)
        ]

    def _contain(self, what: str, claimed: TimeInterval, truth_ns: int) -> None:
        if not claimed.earliest_ns <= truth_ns <= claimed.latest_ns:
            self.violate("8", f"{what} at {truth_ns}, claimed {claimed.earliest_ns} to {claimed.latest_ns}")


def _s(ns: int) -> str:
    return f"{ns / NS_PER_S:.3f} s"
