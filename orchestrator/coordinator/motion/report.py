"""Reports of motion steps: planned against actual, budget against verdict."""

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.motion.budget import judge_skew, measure_skew
from orchestrator.coordinator.motion.negotiation import StartAgreement
from orchestrator.coordinator.motion.planning import StepRequest
from orchestrator.coordinator.motion.start import StartState
from orchestrator.model.messages import ArmedReply
from orchestrator.model.report import MemberReport, StepReport, SyncBudget
from orchestrator.model.state import AxisEvidence, TimeInterval


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


def make_member_report(agreement: StartAgreement, armed: ArmedReply, member: str) -> MemberReport:
    """The report of a member before its start is known."""
    profiles = agreement.profiles(member)
    return MemberReport(
        start_class=agreement.proposals[member].start_class,
        axes=list(profiles),
        armed_in_ns=armed.took_ns,
        stages_ns=armed.stages_ns,
        mapping=armed.mapping,
        planned_s={axis: profile.duration_s for axis, profile in profiles.items()},
        lowered_s=armed.durations_s,
    )


def make_step_report(
    request: StepRequest,
    agreement: StartAgreement,
    state: StartState,
    reports: dict[str, MemberReport],
    failure: tuple[str, str] | None,
) -> StepReport:
    """The report of the whole step. failure: the kind of event that ended it, and why; None when it was done."""
    axes = agreement.plan.profiles
    evidence = [each for report in reports.values() for each in report.evidence.values()]
    starts = [each.start_for_verdict for each in evidence]
    ends = [each.end for each in evidence if each.end is not None]
    start_skew = measure_skew(starts, agreement.budget) if len(starts) == len(axes) else None
    end_skew = measure_skew(ends) if len(ends) == len(axes) else None
    actual_s = None
    if failure is None and ends:
        first_ns = min((each.earliest_ns + each.latest_ns) // 2 for each in starts)
        last_ns = max((each.earliest_ns + each.latest_ns) // 2 for each in ends)
        actual_s = (last_ns - first_ns) / NS_PER_S
    return StepReport(
        index=request.index,
        do="move",
        name=request.move.name or "",
        state="done" if failure is None else "stopped" if failure[0] == "stopped" else "failed",
        reason="" if failure is None else failure[1],
        planned_s=agreement.plan.duration_s,
        actual_s=actual_s,
        arming_fleet_ns=state.arming_fleet_ns,
        settled_fleet_ns=state.settled_fleet_ns,
        t0_fleet_ns=state.t0_fleet_ns,
        members=reports,
        budget=agreement.budget,
        start_skew=start_skew,
        end_skew=end_skew,
        verdict=judge_skew(start_skew, agreement.budget),
    )
