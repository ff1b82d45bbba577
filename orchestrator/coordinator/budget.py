"""The sync budget before a step and the verdict after it."""

from collections.abc import Iterable, Mapping
from typing import Literal

from orchestrator.model.messages import Armed, Proposal
from orchestrator.model.report import Budget, MemberBudget, Skew
from orchestrator.model.state import Interval


def make_budget(said: Mapping[str, Proposal] | Mapping[str, Armed], allowed_ns: int) -> Budget:
    """The guaranteed spread of starts about T0, and the member and term that make it worst; by what members say."""
    members: dict[str, MemberBudget] = {}
    for name, each in said.items():
        members[name] = MemberBudget(
            terms=each.terms,
            earliest_ns=sum(term.earliest_ns for term in each.terms),
            latest_ns=sum(term.latest_ns for term in each.terms),
        )
    # The axes of one controller that start together differ by no more than its own window.
    predicted_ns = max(m.latest_ns for m in members.values()) - min(m.earliest_ns for m in members.values())
    worst = max(members, key=lambda name: members[name].latest_ns - members[name].earliest_ns)
    term = max(members[worst].terms, key=lambda each: each.latest_ns - each.earliest_ns, default=None)
    return Budget(
        predicted_ns=predicted_ns,
        allowed_ns=allowed_ns,
        worst_member=worst,
        worst_term=term.name if term else "none",
        members=members,
    )


def skew(instants: Iterable[Interval]) -> Skew | None:
    """The spread of instants that are known as intervals; None for fewer than one."""
    spans = list(instants)
    if not spans:
        return None
    at_most_ns = max(span.latest_ns for span in spans) - min(span.earliest_ns for span in spans)
    at_least_ns = max(0, max(span.earliest_ns for span in spans) - min(span.latest_ns for span in spans))
    # One axis alone has no skew, however badly its start is known.
    return Skew(at_least_ns=at_least_ns, at_most_ns=at_most_ns if len(spans) > 1 else 0)


def judge(measured: Skew | None, budget: Budget | None) -> Literal["green", "amber", "red", "none"]:
    """green: surely within what the job allows; red: surely not; amber: the evidence does not decide."""
    if measured is None or budget is None:
        return "none"
    if measured.at_most_ns <= budget.allowed_ns:
        return "green"
    return "red" if measured.at_least_ns > budget.allowed_ns else "amber"
