"""How far the axes of a path have been off it at most, proven afterwards by what the controllers state about its start
and its end.

A member's time is off the plan's by what it started late, and by its crystal since then. Both intervals, of its start
and of its end, bound that at every instant, because the crystal is within the bound of its rate. Of a member that
executes the path in chunks only the start counts, and the time since the last fit of its clock. A time that all members
have in common changes nothing on the path, as in `path_bound`.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.motion.negotiation import StartAgreement
from orchestrator.model.names import controller_of
from orchestrator.model.profile import Profile
from orchestrator.model.report import MemberReport, PathReport

Array = NDArray[np.float64]

SAMPLES = 4001
OTHER_RATE = 0.01  # of the duration: a path that took another time was held, or went at another rate


def prove_path(agreement: StartAgreement, reports: Mapping[str, MemberReport], t0_fleet_ns: int) -> PathReport | None:
    """The report of a path with what is proven; as it was agreed without evidence of every start, and for a path that
    was held or went at another rate. reports: of the members that moved, when the path is over."""
    path = agreement.path
    if path is None or path.bound is None:
        return path
    own_names = ("profile-fit", "compensation", "execution")
    own = float(np.sum([term.size for term in path.bound.terms if term.name in own_names]))
    movers = agreement.movers
    # Where the axes of one member alone fly, the times of members take none off its line.
    is_apart = any(term.size for term in path.bound.terms if term.name in ("start", "clock"))
    if len(movers) == 1 or not is_apart:
        return path.model_copy(update={"bound": path.bound.model_copy(update={"proven": own})})
    duration_s = agreement.plan.duration_s if agreement.first is None else agreement.first.course.duration_s
    times_s = np.linspace(0.0, duration_s, SAMPLES)
    spans: dict[str, tuple[Array, Array]] = {}
    for member in movers:
        span = _find_delays(agreement, reports, member, times_s, t0_fleet_ns)
        if span is None:
            return path
        spans[member] = span
    # The middle of all is the time of the path, at each instant or as it was at the start: whatever time is taken, each
    # is a bound. With clocks of different bounds the middle of all would move, and that at the start is closer.
    middle = (np.min([low for low, _ in spans.values()], axis=0) + np.max([high for _, high in spans.values()], 0)) / 2
    off = min(_find_off(agreement, spans, times_s, time) for time in (middle, np.full(SAMPLES, middle[0])))
    return path.model_copy(update={"bound": path.bound.model_copy(update={"proven": own + off})})


def _find_off(
    agreement: StartAgreement, spans: Mapping[str, tuple[Array, Array]], times_s: Array, middle: Array
) -> float:
    """How far the axes are off the path at most, if its time is `middle`."""
    squares = np.zeros(SAMPLES)
    for member, (low, high) in spans.items():
        most_s = np.maximum(middle - low, high - middle)
        squares += (most_s * _sample_speeds(agreement, member, times_s)) ** 2
    return float(np.sqrt(squares.max()))


def _find_delays(
    agreement: StartAgreement, reports: Mapping[str, MemberReport], member: str, times_s: Array, t0_ns: int
) -> tuple[Array, Array] | None:
    """By how much a member was late at instants of the plan, at least and at most, s; None if it is not known."""
    report, first, duration_s = reports[member], agreement.first, float(times_s[-1])
    if not report.evidence or len(report.evidence) < len(report.axes):
        return None
    has_chunks = first is not None and member in first.members
    ends_ns = [evidence.end.latest_ns - t0_ns for evidence in report.evidence.values() if evidence.end is not None]
    if first is not None and not _took(ends_ns, duration_s):
        return None
    ages_s = times_s if first is None or not has_chunks else np.minimum(times_s, first.most_s + first.load_s)
    rate = agreement.proposals[member].clock_ppm * 1e-6
    early_ns, late_ns = narrow_start(agreement, member, report, t0_ns)
    low, high = early_ns - ages_s * rate * NS_PER_S, late_ns + ages_s * rate * NS_PER_S
    from_start = low, high
    for axis, evidence in report.evidence.items():
        planned_s = report.lowered_s.get(axis)
        if has_chunks or evidence.end is None or planned_s is None:
            continue
        ahead_ns = np.maximum(planned_s - times_s, 0.0) * rate * NS_PER_S
        low = np.maximum(low, evidence.end.earliest_ns - t0_ns - planned_s * NS_PER_S - ahead_ns)
        high = np.minimum(high, evidence.end.latest_ns - t0_ns - planned_s * NS_PER_S + ahead_ns)
    if (low > high).any():  # an end that does not belong to this start tells nothing about the way
        low, high = from_start
    return low / NS_PER_S, high / NS_PER_S


def narrow_start(agreement: StartAgreement, member: str, report: MemberReport, t0_ns: int) -> tuple[int, int]:
    """The start of a member around T0, ns: its evidence, narrowed by its promise where both agree."""
    starts = [evidence.start_for_verdict for evidence in report.evidence.values()]
    early_ns, late_ns = (
        min(start.earliest_ns for start in starts) - t0_ns,
        max(start.latest_ns for start in starts) - t0_ns,
    )
    window = None if agreement.budget is None else agreement.budget.members.get(member)
    if window is None:
        return early_ns, late_ns
    delayed_ns = max(evidence.late_ns for evidence in report.evidence.values())
    narrow = max(early_ns, window.earliest_ns), min(late_ns, window.latest_ns + delayed_ns)
    return narrow if narrow[0] <= narrow[1] else (early_ns, late_ns)


def _took(ends_ns: list[int], duration_s: float) -> bool:
    """Whether a path in chunks has taken its own time: it was neither held nor at another rate."""
    last_s = max(ends_ns, default=0) / NS_PER_S
    return abs(last_s - duration_s) <= 0.1 + OTHER_RATE * duration_s


def _sample_speeds(agreement: StartAgreement, member: str, times_s: Array) -> Array:
    """The speed of a member's axes together at instants, each at least that of its neighbours, in the unit of the path
    per s."""
    squares = np.zeros(len(times_s))
    if agreement.first is not None:
        course = agreement.first.course
        velocities = course.motion.evaluate(times_s)[1]
        columns = [number for number, axis in enumerate(course.axes) if controller_of(axis.name) == member]
        squares += (velocities[:, columns] ** 2).sum(axis=1)
    else:
        for axis, profile in agreement.plan.profiles.items():
            squares += _sample_squares(profile, times_s) if controller_of(axis) == member else 0.0
    wide = np.pad(squares, 1, mode="edge")
    return np.sqrt(np.maximum(np.maximum(wide[:-2], wide[2:]), squares))


def _sample_squares(profile: Profile, times_s: Array) -> Array:
    at = profile.make_evaluator()
    return np.array([(at(t).velocity / profile.scale_counts) ** 2 for t in times_s.tolist()])
