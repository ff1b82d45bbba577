"""The sync budget before a step and the verdict after it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import ceil
from typing import Literal

from orchestrator.clock.base import NS_PER_S
from orchestrator.model.messages import Proposal, Term
from orchestrator.model.profile import Profile
from orchestrator.model.report import Budget, MemberBudget, Predicted, Skew
from orchestrator.model.state import Interval

SLOWEST = 0.1  # of the peak velocity: below it a distance from the path is no time


@dataclass(frozen=True, slots=True)
class Window:
    """Where a member starts about T0, term by term. edge: the part of it that all who wait for one line have in common,
    from when to when about T0 the line's edge is; None for a member that does not."""

    terms: list[Term]
    edge: tuple[int, int] | None = None

    @property
    def earliest_ns(self) -> int:
        return sum(term.earliest_ns for term in self.terms)

    @property
    def latest_ns(self) -> int:
        return sum(term.latest_ns for term in self.terms)


def make_budget(windows: Mapping[str, Window], allowed_ns: int) -> Budget:
    """The guaranteed spread of starts about T0, and the member and term that make it worst."""
    members = {
        name: MemberBudget(terms=each.terms, earliest_ns=each.earliest_ns, latest_ns=each.latest_ns)
        for name, each in windows.items()
    }
    # The axes of one controller that start together differ by no more than its own window; and it does not matter
    # when the edge of a line comes that all of them wait for.
    edges = {each.edge for each in windows.values()}
    common = next(iter(edges)) if len(edges) == 1 else None
    predicted_ns = max(m.latest_ns for m in members.values()) - min(m.earliest_ns for m in members.values())
    if common is not None:
        predicted_ns -= common[1] - common[0]
    worst = max(members, key=lambda name: members[name].latest_ns - members[name].earliest_ns)
    term = max(members[worst].terms, key=lambda each: each.latest_ns - each.earliest_ns, default=None)
    return Budget(
        predicted_ns=predicted_ns,
        allowed_ns=allowed_ns,
        worst_member=worst,
        worst_term=term.name if term else "none",
        by_line=common is not None,
        members=members,
    )


def skew(instants: Iterable[Interval], budget: Budget | None = None) -> Skew | None:
    """The spread of instants that are known as intervals; None for fewer than one.

    budget: of starts by one line, whose instant need not be known: they are together as well as was predicted.
    """
    spans = list(instants)
    if not spans:
        return None
    at_most_ns = max(span.latest_ns for span in spans) - min(span.earliest_ns for span in spans)
    at_least_ns = max(0, max(span.earliest_ns for span in spans) - min(span.latest_ns for span in spans))
    if budget is not None and budget.by_line:
        at_most_ns = max(at_least_ns, min(at_most_ns, budget.predicted_ns))
    # One axis alone has no skew, however badly its start is known.
    return Skew(at_least_ns=at_least_ns, at_most_ns=at_most_ns if len(spans) > 1 else 0)


def judge(measured: Skew | None, budget: Budget | None) -> Literal["green", "amber", "red", "none"]:
    """green: surely within what the job allows; red: surely not; amber: the evidence does not decide."""
    if measured is None or budget is None:
        return "none"
    if measured.at_most_ns <= budget.allowed_ns:
        return "green"
    return "red" if measured.at_least_ns > budget.allowed_ns else "amber"


@dataclass(frozen=True, slots=True)
class Way:
    """An axis from its start to its end, beside its plan, in ns: how much it is planned longer, how far its end and its
    way may be off that for its own reasons."""

    member: str
    longer_ns: float
    end_off_ns: float
    path_off_ns: float


def make_ways(
    proposals: Mapping[str, Proposal], profiles: Mapping[str, Mapping[str, Profile]], duration_s: float
) -> list[Way]:
    """The axes of a step. profiles: by member and axis."""
    found: list[Way] = []
    for member, proposal in proposals.items():
        for axis, took_s in proposal.durations_s.items():
            profile = profiles[member][axis]
            if not profile.peak_velocity:
                continue
            crystal_ns = took_s * proposal.clock_ppm * 1e3
            # Where it is slowest, a tenth of its peak, a distance is most of time.
            beside_ns = proposal.path_error_counts.get(axis, 0.0) / (SLOWEST * profile.peak_velocity) * NS_PER_S
            longer_ns = (took_s - duration_s) * NS_PER_S
            found.append(Way(member, longer_ns, crystal_ns + proposal.tick_ns, crystal_ns + beside_ns))
    return found


def predict_end(budget: Budget, ways: list[Way], allowed_ns: int | None) -> Predicted | None:
    """How far the ends are apart at the most: the starts, and what each axis adds on its way."""
    return _predict(budget, [(way.member, way.longer_ns, way.end_off_ns) for way in ways], allowed_ns)


def predict_path(budget: Budget, ways: list[Way], allowed_ns: int | None) -> Predicted | None:
    """How far the axes are apart in time on their way at the most, where each has a tenth of its peak velocity."""
    return _predict(budget, [(way.member, 0.0, way.path_off_ns) for way in ways], allowed_ns)


def _predict(budget: Budget, ways: list[tuple[str, float, float]], allowed_ns: int | None) -> Predicted | None:
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
    return Predicted(predicted_ns=ceil(predicted_ns), allowed_ns=allowed_ns, worst_member=ways[worst][0])
