"""The sync budget before a step and the verdict after it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import ceil
from typing import Literal

from orchestrator.clock.base import NS_PER_S
from orchestrator.model.messages import BudgetTerm, Proposal
from orchestrator.model.profile import Profile
from orchestrator.model.report import MemberBudget, PredictedSkew, SkewInterval, SyncBudget
from orchestrator.model.state import TimeInterval

Verdict = Literal["green", "amber", "red", "none"]

SLOWEST_FRACTION = 0.1  # of the peak velocity: below it, a distance from the path is not expressed as time


@dataclass(frozen=True, slots=True)
class StartWindow:
    """The window of a member's start around T0, term by term. edge: the part of it that all members on one trigger
    line share, i.e. the window of the line's edge around T0; None for a member that does not wait for a line."""

    terms: list[BudgetTerm]
    edge: tuple[int, int] | None = None

    @property
    def earliest_ns(self) -> int:
        return sum(term.earliest_ns for term in self.terms)

    @property
    def latest_ns(self) -> int:
        return sum(term.latest_ns for term in self.terms)


def make_budget(windows: Mapping[str, StartWindow], allowed_ns: int) -> SyncBudget:
    """The guaranteed spread of starts around T0, and the member and term with the largest share."""
    members = {
        name: MemberBudget(terms=window.terms, earliest_ns=window.earliest_ns, latest_ns=window.latest_ns)
        for name, window in windows.items()
    }
    # The axes of one controller that start together differ by at most its own window; the instant of a trigger line's
    # edge does not matter if all wait for it.
    edges = {window.edge for window in windows.values()}
    common = next(iter(edges)) if len(edges) == 1 else None
    predicted_ns = max(m.latest_ns for m in members.values()) - min(m.earliest_ns for m in members.values())
    if common is not None:
        predicted_ns -= common[1] - common[0]
    predicted_ns -= _find_shared_ns(members)
    worst = max(members, key=lambda name: members[name].latest_ns - members[name].earliest_ns)
    term = max(members[worst].terms, key=lambda part: part.latest_ns - part.earliest_ns, default=None)
    return SyncBudget(
        predicted_ns=predicted_ns,
        allowed_ns=allowed_ns,
        worst_member=worst,
        worst_term=term.name if term else "none",
        by_trigger_line=common is not None,
        members=members,
    )


def _find_shared_ns(members: Mapping[str, MemberBudget]) -> int:
    """How much of the windows a start at once is, which all axes of its one controller share."""
    terms = [term for member in members.values() for term in member.terms if term.name == "at-once"]
    return sum(term.latest_ns - term.earliest_ns for term in terms) if len(members) == 1 else 0


def measure_skew(instants: Iterable[TimeInterval], budget: SyncBudget | None = None) -> SkewInterval | None:
    """The spread of instants that are known as intervals; None without instants.

    budget: for starts by one trigger line, whose instant need not be known: they are as close as predicted.
    """
    spans = list(instants)
    if not spans:
        return None
    at_most_ns = max(span.latest_ns for span in spans) - min(span.earliest_ns for span in spans)
    at_least_ns = max(0, max(span.earliest_ns for span in spans) - min(span.latest_ns for span in spans))
    if budget is not None and budget.by_trigger_line:
        at_most_ns = max(at_least_ns, min(at_most_ns, budget.predicted_ns))
    # A single axis has no skew, however uncertain its start is.
    return SkewInterval(at_least_ns=at_least_ns, at_most_ns=at_most_ns if len(spans) > 1 else 0)


def judge_skew(measured: SkewInterval | None, budget: SyncBudget | None) -> Verdict:
    """green: certainly within the allowed skew; red: certainly not; amber: the evidence does not decide."""
    if measured is None or budget is None:
        return "none"
    if measured.at_most_ns <= budget.allowed_ns:
        return "green"
    return "red" if measured.at_least_ns > budget.allowed_ns else "amber"


def worse_verdict(first: Verdict, second: Verdict) -> Verdict:
    """The worse of two verdicts on the same starts: green only if both are."""
    order: tuple[Verdict, ...] = ("none", "green", "amber", "red")
    return order[max(order.index(first), order.index(second))]


@dataclass(frozen=True, slots=True)
class AxisDeviation:
    """The deviation of an axis from its plan between start and end, in ns: how much longer it is planned, and by how
    much its end and its path may deviate from that for reasons of its own."""

    member: str
    longer_ns: float
    end_off_ns: float
    path_off_ns: float


def make_deviations(
    proposals: Mapping[str, Proposal], profiles: Mapping[str, Mapping[str, Profile]], duration_s: float
) -> list[AxisDeviation]:
    """The deviations of all axes of a step. profiles: by member and axis."""
    deviations: list[AxisDeviation] = []
    for member, proposal in proposals.items():
        for axis, took_s in proposal.durations_s.items():
            profile = profiles[member][axis]
            if not profile.peak_velocity:
                continue
            crystal_ns = took_s * proposal.clock_ppm * 1e3
            # At a tenth of the peak velocity a given distance corresponds to the longest time.
            path_off_ns = (
                proposal.path_error_counts.get(axis, 0.0) / (SLOWEST_FRACTION * profile.peak_velocity) * NS_PER_S
            )
            longer_ns = (took_s - duration_s) * NS_PER_S
            deviations.append(AxisDeviation(member, longer_ns, crystal_ns + proposal.tick_ns, crystal_ns + path_off_ns))
    return deviations


def predict_end(budget: SyncBudget, ways: list[AxisDeviation], allowed_ns: int | None) -> PredictedSkew | None:
    """The guaranteed spread of the ends: that of the starts, and what each axis adds until its end."""
    return _predict_skew(budget, [(way.member, way.longer_ns, way.end_off_ns) for way in ways], allowed_ns)


def predict_path(budget: SyncBudget, ways: list[AxisDeviation], allowed_ns: int | None) -> PredictedSkew | None:
    """The guaranteed time offset between axes along their path, at a tenth of the peak velocity of each or more."""
    return _predict_skew(budget, [(way.member, 0.0, way.path_off_ns) for way in ways], allowed_ns)


def _predict_skew(
    budget: SyncBudget, ways: list[tuple[str, float, float]], allowed_ns: int | None
) -> PredictedSkew | None:
    spans = {
        index: (
            budget.members[member].earliest_ns + shift_ns - off_ns,
            budget.members[member].latest_ns + shift_ns + off_ns,
        )
        for index, (member, shift_ns, off_ns) in enumerate(ways)
        if member in budget.members
    }
    if not spans:
        return None
    worst = max(spans, key=lambda index: spans[index][1] - spans[index][0])
    predicted_ns = max(late for _, late in spans.values()) - min(early for early, _ in spans.values())
    predicted_ns -= _find_shared_ns(budget.members)
    return PredictedSkew(predicted_ns=ceil(predicted_ns), allowed_ns=allowed_ns, worst_member=ways[worst][0])
