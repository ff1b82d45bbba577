"""Reports of motion steps: planned against actual, budget against verdict."""

from collections.abc import Mapping

from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.interval import find_other_duration
from orchestrator.coordinator.motion.budget import Verdict, judge_skew, measure_skew, worse_verdict
from orchestrator.coordinator.motion.negotiation import StartAgreement
from orchestrator.coordinator.motion.path_proof import prove_path
from orchestrator.coordinator.motion.planning import StepRequest
from orchestrator.coordinator.motion.start import StartState
from orchestrator.model.messages import ArmedReply
from orchestrator.model.names import split_name
from orchestrator.model.report import MemberReport, SkewInterval, StepReport, SyncBudget
from orchestrator.model.state import AxisEvidence, ControllerState, TimeInterval

POSITION_TOLERANCE_COUNTS = 1  # rounding of the last count


def narrow_evidence(budget: SyncBudget | None, t0_fleet_ns: int, member: str, evidence: AxisEvidence) -> AxisEvidence:
    """Narrow the start interval by the member's promise, where the controller's evidence is weaker, e.g. because a
    serial adapter delays answers. If the two do not intersect, something was outside the model."""
    window = budget.members.get(member) if budget is not None else None
    stated_ns = evidence.start.latest_ns - evidence.start.earliest_ns
    if window is None or stated_ns <= window.latest_ns - window.earliest_ns:
        return evidence
    earliest_ns = max(evidence.start.earliest_ns, t0_fleet_ns + window.earliest_ns)
    latest_ns = min(evidence.start.latest_ns, t0_fleet_ns + window.latest_ns + evidence.late_ns)
    if earliest_ns > latest_ns:
        return evidence
    return evidence.model_copy(update={"modelled": TimeInterval(earliest_ns=earliest_ns, latest_ns=latest_ns)})


def find_t0(budget: SyncBudget, t0_fleet_ns: int, evidence: Mapping[str, AxisEvidence]) -> int:
    """T0 of a step, once its start is known: of one that begins when the step before has ended, it is the beginning of
    the evidence, before which its controller can only state the earliest instant."""
    terms = [term.name for member in budget.members.values() for term in member.terms]
    starts_ns = [axis_evidence.start.earliest_ns for axis_evidence in evidence.values()]
    return max(t0_fleet_ns, min(starts_ns, default=0)) if "at-once" in terms else t0_fleet_ns


def make_member_report(agreement: StartAgreement, armed: ArmedReply, member: str) -> MemberReport:
    """The report of a member before its start is known."""
    profiles = agreement.profiles(member)
    return MemberReport(
        start_class=agreement.proposals[member].start_class,
        axes=list(profiles),
        arming_fleet_ns=armed.began_fleet_ns,
        armed_in_ns=armed.took_ns,
        stages_ns=armed.stages_ns,
        mapping=armed.mapping,
        planned_s={axis: profile.duration_s for axis, profile in profiles.items()},
        lowered_s=armed.durations_s,
    )


def measure_gap_s(before: StepReport, after: StepReport) -> float | None:
    """The time from the last end of one step to the first start of the next, s, in the middle of the evidence; None
    without evidence."""
    ends = [evidence.end for member in before.members.values() for evidence in member.evidence.values()]
    starts = [evidence.start_for_verdict for member in after.members.values() for evidence in member.evidence.values()]
    known_ends = [end for end in ends if end is not None]
    if not known_ends or not starts:
        return None
    last_ns = max((interval.earliest_ns + interval.latest_ns) // 2 for interval in known_ends)
    first_ns = min((start.earliest_ns + start.latest_ns) // 2 for start in starts)
    return (first_ns - last_ns) / NS_PER_S


def find_wrong_durations(agreement: StartAgreement, reports: Mapping[str, MemberReport]) -> list[str]:
    """Axes whose motion has certainly taken another time than their controller has promised, in words."""
    durations: list[str] = []
    for member, report in reports.items():
        ppm = agreement.proposals[member].clock_ppm
        for axis, evidence in report.evidence.items():
            promised_s = report.lowered_s.get(axis)
            if promised_s is None or evidence.end is None:
                continue
            taken_s = find_other_duration(evidence.start_for_verdict, evidence.end, promised_s, ppm)
            if taken_s is not None:
                durations.append(f"{member}.{axis} took {taken_s:.3f} s, promised {promised_s:.3f} s")
    return durations


def find_misplaced_axes(
    agreement: StartAgreement, states: Mapping[str, ControllerState], t0_fleet_ns: int
) -> list[str]:
    """Axes that are not commanded to their targets after the step, in words. A state from before its end says nothing:
    behind a step that another one follows at once there may be none, and its end is the controller's evidence."""
    ends_ns = t0_fleet_ns + round(agreement.plan.duration_s * NS_PER_S)
    axes: list[str] = []
    for axis, profile in agreement.plan.profiles.items():
        controller, name = split_name(axis)
        state = states.get(controller)
        if state is None or state.mode == "offline" or state.read_fleet_ns is None or state.read_fleet_ns < ends_ns:
            continue
        off = state.axes[name].commanded_counts - profile.end_counts
        if abs(off) > POSITION_TOLERANCE_COUNTS and not state.axes[name].moving:
            axes.append(f"{axis} is {off:+d} counts from its target")
    return axes


def judge_ends(verdict: Verdict, ends: SkewInterval | None, budget: SyncBudget | None) -> Verdict:
    """The verdict with the allowed end skew, if the job has one."""
    allowed_ns = budget.end.allowed_ns if budget is not None and budget.end is not None else None
    if ends is None or allowed_ns is None or ends.at_most_ns <= allowed_ns:
        return verdict
    if ends.at_least_ns > allowed_ns:
        return "red"
    return "amber" if verdict == "green" else verdict


def judge_completed_step(
    report: StepReport, agreement: StartAgreement, states: Mapping[str, ControllerState]
) -> StepReport:
    """The report of a step that is done with the verdict on all that was promised: starts, durations, ends and
    positions. states: of its members, after the step."""
    deviations = [
        *find_wrong_durations(agreement, report.members),
        *find_misplaced_axes(agreement, states, report.t0_fleet_ns or 0),
    ]
    verdict = report.verdict
    if verdict != "none":
        verdict = "red" if deviations else judge_ends(verdict, report.end_skew, agreement.budget)
    return report.model_copy(update={"verdict": verdict, "deviations": deviations})


def judge_starts(agreement: StartAgreement, reports: Mapping[str, MemberReport]) -> Verdict | None:
    """The verdict on the starts of the members; None while one of them is not known."""
    if sum(len(report.evidence) for report in reports.values()) < len(agreement.plan.profiles):
        return None
    measured_skew, promised_skew = _measure_starts(agreement, reports)
    return worse_verdict(judge_skew(measured_skew, agreement.budget), judge_skew(promised_skew, agreement.budget))


def _measure_starts(
    agreement: StartAgreement, reports: Mapping[str, MemberReport]
) -> tuple[SkewInterval | None, SkewInterval | None]:
    """The start skew by evidence alone, and with the promises."""
    plan, starts, promised_starts = (
        agreement.plan if agreement.first is None else agreement.first.plan,
        list[TimeInterval](),
        list[TimeInterval](),
    )
    for member, report in reports.items():
        for axis, evidence in report.evidence.items():
            # Of an axis that rests first, a controller can state a start only when it has begun to move.
            rests = plan.profiles[f"{member}.{axis}"].rests_first
            starts.append(evidence.start_for_verdict if rests else evidence.start)
            promised_starts.append(evidence.start_for_verdict)
    return measure_skew(starts), measure_skew(promised_starts, agreement.budget)


def make_step_report(
    request: StepRequest,
    agreement: StartAgreement,
    state: StartState,
    reports: dict[str, MemberReport],
    failure: tuple[str, str] | None,
) -> StepReport:
    """The report of the whole step. failure: the kind of event that ended it, and why; None when it was done."""
    axes = agreement.plan.profiles
    evidence = [axis_evidence for report in reports.values() for axis_evidence in report.evidence.values()]
    starts = [axis_evidence.start_for_verdict for axis_evidence in evidence]
    is_complete = len(starts) == len(axes)
    ends = [axis_evidence.end for axis_evidence in evidence if axis_evidence.end is not None]
    start_skew, promised_skew = _measure_starts(agreement, reports) if is_complete else (None, None)
    end_skew = measure_skew(ends) if len(ends) == len(axes) else None
    actual_s = None
    if failure is None and ends:
        first_ns = min((start.earliest_ns + start.latest_ns) // 2 for start in starts)
        last_ns = max((end.earliest_ns + end.latest_ns) // 2 for end in ends)
        actual_s = (last_ns - first_ns) / NS_PER_S
    return StepReport(
        index=request.index,
        do=request.move.do,
        name=request.move.name or "",
        state="done" if failure is None else "stopped" if failure[0] == "stopped" else "failed",
        reason="" if failure is None else failure[1],
        planned_s=agreement.plan.duration_s,
        actual_s=actual_s,
        arming_fleet_ns=state.arming_fleet_ns,
        settled_fleet_ns=state.settled_fleet_ns,
        t0_fleet_ns=state.t0_fleet_ns,
        waited_armed=state.waited,
        members=reports,
        budget=agreement.budget,
        path=agreement.path if failure is not None else prove_path(agreement, reports, state.t0_fleet_ns),
        start_skew=start_skew,
        promised_skew=None if promised_skew == start_skew else promised_skew,
        end_skew=end_skew,
        # A verdict belongs to a step that was done.
        verdict="none"
        if failure is not None
        else worse_verdict(judge_skew(start_skew, agreement.budget), judge_skew(promised_skew, agreement.budget)),
    )


def add_return(report: StepReport, returned: StepReport) -> StepReport:
    """The report of a step whose axes were brought back from their overruns by a second motion."""
    times_s = [took_s for took_s in (report.actual_s, returned.actual_s) if took_s is not None]
    return report.model_copy(
        update={
            "state": returned.state,
            "reason": returned.reason,
            "refused": returned.refused,
            "actual_s": sum(times_s) if times_s else None,
            "positions": {**report.positions, **returned.positions},
            "bounds": {**report.bounds, **returned.bounds},
        }
    )
