"""Whether a step keeps a rule: spans of time are halved until each is decided."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from orchestrator.plan.zones.chain import Box
from orchestrator.plan.zones.clearance import MAX_LOOKS, Constraint, OutOfWork, Search, find_violation, halve
from orchestrator.plan.zones.course import Course


@dataclass(frozen=True, slots=True)
class RuleCheck:
    """A rule of a fleet file, by its name, and what must hold."""

    name: str
    constraint: Constraint
    trust_step: bool


@dataclass(frozen=True, slots=True)
class Violation:
    """Where a step may break a rule. positions: by axis; None: within the work that is allowed it was not decided, and
    `nearest` is the smallest distance seen, mm."""

    rule: RuleCheck
    instant_s: float
    positions: Mapping[str, float] | None
    nearest: float


def find_rule_violation(rule: RuleCheck, course: Course, *, trust_step: bool | None = None) -> Violation | None:
    """Where a step may break a rule; None: it keeps it, for all instants, margins and single stops. trust_step: as of
    the rule by default."""
    constraint, trust = rule.constraint, rule.trust_step if trust_step is None else trust_step
    finest_s = course.find_resolution(constraint.axes, trust_step=trust)
    search, spans = Search(MAX_LOOKS + course.segments), [Span(course.begin_s, course.duration_s, {})]
    span = spans[0]
    try:
        begin_box = course.find_begin_box(constraint.axes, trust_step=trust)
        positions = None if begin_box is None else find_violation(search, constraint, begin_box)
        if positions is not None:
            return Violation(rule, 0.0, positions, search.nearest)
        while spans:
            span = spans.pop()
            box = course.find_box(constraint.axes, span.begin_s, span.end_s, trust_step=trust)
            box = {**box, **span.standing}
            look = search.look(constraint, box)
            if look.holds:
                continue
            if look.widest is not None and look.widest not in course.moving:
                spans += [
                    replace(span, standing={**span.standing, look.widest: half}) for half in halve(box, look.widest)
                ]
            elif span.end_s - span.begin_s > finest_s:
                middle_s = (span.begin_s + span.end_s) / 2
                spans += [replace(span, begin_s=middle_s), replace(span, end_s=middle_s)]  # the earlier one first
            else:
                positions = find_violation(search, constraint, box)
                if positions is not None:
                    return Violation(rule, span.begin_s, positions, search.nearest)
    except OutOfWork:
        return Violation(rule, span.begin_s, None, search.nearest)
    return None


@dataclass(frozen=True, slots=True)
class Span:
    """A part of a step: a span of time, s, and parts of the ranges of axes that it does not move."""

    begin_s: float
    end_s: float
    standing: Box


def leads_out(rule: RuleCheck, course: Course) -> bool:
    """Whether a rule may be broken where a step begins, and the step does not make that worse, whatever stops on its
    way. How far axes may be from where they are said to be does not change that."""
    begin_s = course.begin_s
    box = course.find_box(rule.constraint.axes, begin_s, begin_s, trust_step=True)
    if not course.moving or rule.constraint.look(box).holds:
        return False
    exact_course = course.without_margins()
    constraint = rule.constraint.relax(exact_course.find_box(rule.constraint.axes, begin_s, begin_s, trust_step=True))
    return constraint is not None and find_rule_violation(replace(rule, constraint=constraint), exact_course) is None
