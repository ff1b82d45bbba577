"""What a motion step was, and how well it went: planned against actual, budget against verdict (design, 6.8)."""

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.motion.budget import judge, skew
from orchestrator.coordinator.motion.moving import Moving
from orchestrator.model.job import Move
from orchestrator.model.report import MemberReport, StepReport
from orchestrator.model.state import AxisEvidence, Interval


def narrowed(moving: Moving, member: str, evidence: AxisEvidence) -> AxisEvidence:
    """With the start by both, where the controller's evidence says less than what the member has promised, e.g.
    because a serial adapter holds answers back. Where they disagree, something was outside the model."""
    window = moving.budget.members.get(member) if moving.budget is not None else None
    said_ns = evidence.start.latest_ns - evidence.start.earliest_ns
    if window is None or said_ns <= window.latest_ns - window.earliest_ns:
        return evidence
    earliest_ns = max(evidence.start.earliest_ns, moving.t0_fleet_ns + window.earliest_ns)
    latest_ns = min(evidence.start.latest_ns, moving.t0_fleet_ns + window.latest_ns + evidence.late_ns)
    if earliest_ns > latest_ns:
        return evidence
    return evidence.model_copy(update={"modelled": Interval(earliest_ns=earliest_ns, latest_ns=latest_ns)})


def member_report(moving: Moving, member: str) -> MemberReport:
    """Of a member, as long as nothing is known of its start."""
    proposal, armed = moving.proposals[member], moving.armed[member]
    profiles = moving.profiles(member)
    return MemberReport(
        start_class=proposal.start_class,
        axes=list(profiles),
        armed_in_ns=armed.took_ns,
        stages_ns=armed.stages_ns,
        mapping=armed.mapping,
        planned_s={axis: profile.duration_s for axis, profile in profiles.items()},
        lowered_s=armed.durations_s,
    )


def step_report(
    moving: Moving, step: Move, reports: dict[str, MemberReport], failure: tuple[str, str] | None
) -> StepReport:
    """Of the whole step. failure: the kind of event that ended it, and why; None when it was done."""
    evidence = [each for report in reports.values() for each in report.evidence.values()]
    starts = [each.judged_start for each in evidence]
    ends = [each.end for each in evidence if each.end is not None]
    complete = len(starts) == len(moving.plan.profiles)
    start_skew = skew(starts, moving.budget) if complete else None
    end_skew = skew(ends) if len(ends) == len(moving.plan.profiles) else None
    actual_s = None
    if failure is None and ends:
        first_ns = min((each.earliest_ns + each.latest_ns) // 2 for each in starts)
        last_ns = max((each.earliest_ns + each.latest_ns) // 2 for each in ends)
        actual_s = (last_ns - first_ns) / NS_PER_S
    return StepReport(
        index=moving.index,
        do="move",
        name=step.name or "",
        state="done" if failure is None else "stopped" if failure[0] == "stopped" else "failed",
        reason="" if failure is None else failure[1],
        planned_s=moving.plan.duration_s,
        actual_s=actual_s,
        arming_fleet_ns=moving.arming_fleet_ns,
        settled_fleet_ns=moving.settled_fleet_ns,
        t0_fleet_ns=moving.t0_fleet_ns,
        members=reports,
        budget=moving.budget,
        start_skew=start_skew,
        end_skew=end_skew,
        verdict=judge(start_skew, moving.budget),
    )
