"""The stages of each motion step of a job, from its report alone.

Stages of the coordinator lie between the instants of the report (arming, settled, T0) and the transitions of the job
(planning, armed, committed, running). A step that was loaded behind a moving one has no transitions of its own, and the
later points of a scan have none either: its stages are fewer, and a remark says so.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal

from pydantic import Field

from orchestrator.clock.base import NS_PER_S
from orchestrator.model.base import Int53, Model
from orchestrator.model.report import FeedHold, JobReport, JobState, JobTransition, MemberReport, StepChain, StepReport
from orchestrator.model.state import AxisEvidence, TimeInterval
from orchestrator.model.steps.numbers import name_step


class TimelineStage(Model):
    """A stage; instants relative to T0, in ns."""

    name: str
    begin_ns: Int53
    end_ns: Int53


class TimelineAxis(Model):
    """Start and end of an axis by its controller's evidence, relative to T0, in ns.

    modelled: the start where the promise makes it narrower. late_ns: how much later than promised the host gave the
    start. settled_s: from the end of its profile until it was in its window."""

    start: TimeInterval
    modelled: TimeInterval | None = None
    late_ns: Int53 = 0
    end: TimeInterval | None = None
    settled_s: float | None = None


class TimelineMember(Model):
    """A member: the stages of its arming, in the adapter, and its axes."""

    start_class: str
    stages: list[TimelineStage]
    axes: dict[str, TimelineAxis]


class StepTimeline(Model):
    """One motion step. t0_fleet_ns: T0 in fleet time, to which all instants are relative.

    coordinator: plan (with the proposals), arm, commit (the promises), decide (the journal), go, fire (until T0), run.
    remarks: which stages the report does not have, and why."""

    step: int
    name: str
    state: str
    verdict: str
    t0_fleet_ns: Int53
    coordinator: list[TimelineStage]
    members: dict[str, TimelineMember]
    chain: StepChain | None = None
    feed_holds: list[FeedHold] = Field(default=[])
    remarks: list[str] = Field(default=[])


class JobTimeline(Model):
    """The motion steps of a job; of scans, those points that have a report of their own."""

    schema_: Literal["tutti.timeline/1"] = Field(default="tutti.timeline/1", alias="schema")
    job_id: str
    name: str
    steps: list[StepTimeline]


def make_timeline(report: JobReport) -> JobTimeline:
    """The timeline of all motion steps that were armed."""
    armed_steps = [step for step in report.steps if step.members and step.t0_fleet_ns is not None]
    since_ns = [0, *(step.t0_fleet_ns or 0 for step in armed_steps)]
    steps = [
        _make_step(step, report.transitions, since_ns) for step, since_ns in zip(armed_steps, since_ns, strict=False)
    ]
    return JobTimeline(job_id=report.job_id, name=report.name, steps=steps)


def _make_step(step: StepReport, transitions: Sequence[JobTransition], since_ns: int) -> StepTimeline:
    """since_ns: T0 of the motion step before."""
    t0_ns = step.t0_fleet_ns or 0
    remarks: list[str] = []
    if step.chain is not None and step.chain.kept:
        remarks.append(
            f"loaded behind {name_step(step.chain.step)}, as it moved: members that hold one move arm after its end"
        )
    members = {name: _make_member(member, step, t0_ns, remarks) for name, member in step.members.items()}
    return StepTimeline(
        step=step.index,
        name=step.name,
        state=step.state,
        verdict=step.verdict,
        t0_fleet_ns=t0_ns,
        coordinator=_make_coordinator(step, _own_transitions(step, transitions, since_ns), remarks),
        members=members,
        chain=step.chain,
        feed_holds=step.feed_holds,
        remarks=list(dict.fromkeys(remarks)),
    )


def _own_transitions(step: StepReport, transitions: Sequence[JobTransition], since_ns: int) -> dict[JobState, int]:
    """When the job took the states of this start, fleet time; none for a step that was released while it was running.

    Of several starts of one step, after feed holds, these are the last."""
    t0_ns, instants = step.t0_fleet_ns or 0, dict[JobState, int]()
    for transition in transitions:
        if transition.fleet_ns is None or not since_ns <= transition.fleet_ns <= t0_ns:
            continue
        if transition.state == "planning":
            instants = {}
        instants.setdefault(transition.state, transition.fleet_ns)
    return instants if "planning" in instants else {}


def _make_coordinator(step: StepReport, went: dict[JobState, int], remarks: list[str]) -> list[TimelineStage]:
    t0_ns = step.t0_fleet_ns or 0
    arming_ns, settled_ns = step.arming_fleet_ns or t0_ns, step.settled_fleet_ns or t0_ns
    stages: list[tuple[str, int]] = []
    if went:
        stages.append(("plan", went["planning"]))
        if went.get("arming", arming_ns) < arming_ns:
            stages.append(("align", went["arming"]))
            remarks.append("`align`: the wait for an aligned start, or armings that were late and repeated")
    else:
        remarks.append("the job has no transitions of this step: no `plan`, `decide` and `go`; `fire` has the release")
    first_ns = min((member.arming_fleet_ns or arming_ns for member in step.members.values()), default=arming_ns)
    if first_ns >= settled_ns:  # it started at once: decided first, then loaded and started
        stages += [("decide", settled_ns), ("start", min(went.get("committed", first_ns), first_ns))]
        return _make_stages(step, stages)
    stages += [("arm", arming_ns), ("commit", went.get("armed", _last_armed_ns(step, arming_ns, settled_ns)))]
    if "committed" in went and "running" in went:
        stages += [("decide", settled_ns), ("go", went["committed"]), ("fire", went["running"])]
    else:
        stages.append(("fire", settled_ns))
    return _make_stages(step, stages)


def _make_stages(step: StepReport, stages: Sequence[tuple[str, int]]) -> list[TimelineStage]:
    """The stages up to T0, each with its begin in fleet time, and the motion."""
    t0_ns = step.t0_fleet_ns or 0
    ends = [
        evidence.end.latest_ns
        for member in step.members.values()
        for evidence in member.evidence.values()
        if evidence.end
    ]
    bounds = [*stages, ("run", t0_ns), ("", max(ends, default=t0_ns))]
    return [
        TimelineStage(name=name, begin_ns=begin_ns - t0_ns, end_ns=max(begin_ns, end_ns) - t0_ns)
        for (name, begin_ns), (_, end_ns) in pairwise(bounds)
    ]


def _last_armed_ns(step: StepReport, arming_ns: int, settled_ns: int) -> int:
    """When the last member was armed, by their reports."""
    ends = [(member.arming_fleet_ns or arming_ns) + member.armed_in_ns for member in step.members.values()]
    return min(max(ends), settled_ns)


def _make_member(member: MemberReport, step: StepReport, t0_ns: int, remarks: list[str]) -> TimelineMember:
    begin_ns = member.arming_fleet_ns
    if begin_ns is None:
        begin_ns = step.arming_fleet_ns or t0_ns
        remarks.append(
            "the report does not have when each member began to arm: it is shown from the beginning of `arm`"
        )
    # The driver's stages are the last part of arming; before them the move is compiled and settings are compared.
    rest_ns = max(0, member.armed_in_ns - sum(member.stages_ns.values()))
    at_ns, stages = begin_ns - t0_ns, list[TimelineStage]()
    for name, took_ns in {"prepare": rest_ns, **member.stages_ns}.items():
        stages.append(TimelineStage(name=name, begin_ns=at_ns, end_ns=at_ns + took_ns))
        at_ns += took_ns
    axes = {name: _make_axis(evidence, t0_ns) for name, evidence in member.evidence.items()}
    return TimelineMember(start_class=member.start_class, stages=stages, axes=axes)


def _make_axis(evidence: AxisEvidence, t0_ns: int) -> TimelineAxis:
    return TimelineAxis(
        start=_shift(evidence.start, t0_ns),
        modelled=None if evidence.modelled is None else _shift(evidence.modelled, t0_ns),
        late_ns=evidence.late_ns,
        end=None if evidence.end is None else _shift(evidence.end, t0_ns),
        settled_s=evidence.settled_s,
    )


def _shift(interval: TimeInterval, t0_ns: int) -> TimeInterval:
    return TimeInterval(earliest_ns=interval.earliest_ns - t0_ns, latest_ns=interval.latest_ns - t0_ns)


def settled_ns(axis: TimelineAxis) -> int | None:
    """When an axis was in its window, relative to T0; None without such a check."""
    if axis.end is None or axis.settled_s is None:
        return None
    return axis.end.latest_ns + round(axis.settled_s * NS_PER_S)
