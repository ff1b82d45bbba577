"""Keep-out zones in a forecast: what is refused ahead, what depends on the world, what is checked in the run only."""

from collections.abc import Iterable, Mapping
from fractions import Fraction

from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import Refusal
from orchestrator.model.steps.base import InnerSteps, Step
from orchestrator.model.steps.kinds import Motion
from orchestrator.plan.forecast.context import ForecastContext
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.forecast.ways import MoveWays
from orchestrator.plan.homing_order import HomingOrder
from orchestrator.plan.path_step import PlannedPath
from orchestrator.plan.probes import ContactRange
from orchestrator.plan.zones.chain import Box
from orchestrator.plan.zones.course import Course, Sweep, Timing, join_spans
from orchestrator.plan.zones.homing import ZoneHoming
from orchestrator.plan.zones.paths import bound_alone, find_path_terms
from orchestrator.plan.zones.refusals import make_refusal
from orchestrator.plan.zones.sweeps import require_swept

ZoneArea = dict[str, tuple[float, float] | None]
"""By axis, between which motor positions it is; None: that is not known."""


def begin_zones(state: ForecastState) -> None:
    """Note where the axes of rules are before a step that is run forward."""
    state.zones_checked, state.scan_area = False, {}
    if state.zones is not None:
        state.spans_before = {name: _find_span(state, name) for name in state.zones.ranges}


def check_move(state: ForecastState, at: ForecastContext, step: Motion, ways: MoveWays) -> None:
    """Check a move that was planned."""
    if ways.plan is None:
        state.zones_checked = True  # it is a problem for another reason
    if state.zones is None or ways.plan is None:
        return
    adrift = [name for name in step.find_axes(state.fleet) if name not in ways.exact]
    profiles = {name: profile for name, profile in ways.plan.profiles.items() if name in ways.exact}
    timing = Timing(state.alone, _find_skew_s(step))
    _check(state, at, Sweep(profiles, _find_positions(state, [*profiles, *adrift], adrift), timing, adrift))


def check_path(
    state: ForecastState,
    at: ForecastContext,
    step: Motion,
    path: PlannedPath,
    afloat: Mapping[str, ContactRange | None],
) -> None:
    """Check a path that was planned. afloat: of the axes that were planned from the lower end of where they may be,
    that range; None: nothing is known of it."""
    if state.zones is None:
        return
    profiles = {name: profile for name, profile in path.plan.profiles.items() if name not in afloat}
    positions = dict(_find_positions(state, [*path.plan.profiles, *afloat], ()))
    for name, reach in afloat.items():
        if reach is not None and name in path.plan.profiles:
            low, high = sorted(map(state.fleet.axis(name).to_unit, path.plan.profiles[name].extent_counts))
            positions[name] = low, high + float(reach.high - reach.low)
    chunks = {name: ability.most_s for name, ability in state.chunks.items() if ability.most_s}
    alone_times = bound_alone(state.alone, {} if path.course is None or step.triggers else chunks)
    timing = Timing(alone_times, _find_skew_s(step))
    _check(state, at, Sweep(profiles, positions, timing, list(afloat), find_path_terms(path)))


def check_swept(state: ForecastState, at: ForecastContext, step: Step) -> None:
    """Check a step whose kind was not checked by its plan: its axes may be anywhere between where they were before it
    and where they are after it. A kind that does not say that this is so is refused."""
    zones = state.zones
    if zones is None or state.zones_checked or step.inner is not None or not step.moves:
        return
    if step.is_open:
        state.notes["each step that it is asked for is checked against zones in the run"] = None
        return
    try:
        require_swept(state.fleet, step)
    except Refusal as error:
        state.add_problem(at, (), error)
        return
    axes = [name for name in step.find_axes(state.fleet) if name in zones.ranges]
    spans = {name: span for name in axes if (span := join_known(state.spans_before[name], _find_span(state, name)))}
    _check(state, at, Sweep({}, {**_find_positions(state, axes, ()), **spans}, Timing(state.alone), axes))


def check_homing(state: ForecastState, at: ForecastContext, order: HomingOrder) -> None:
    """Check a homing; what depends on where axes are referenced and stand before it is a condition."""
    zones = state.zones
    state.zones_checked = True
    if zones is None:
        return
    try:
        ZoneHoming(zones, state.fleet, _find_positions(state, (), ())).require_order(order)
    except Refusal as error:
        is_open = any(_find_span(state, name) is None and _is_open(state, name) for name in zones.ranges)
        if is_open:
            state.notes[f"axes are referenced and stand where zones allow it: {error.text}; {error.remedy}"] = None
        else:
            state.add_problem(at, (), error)


def check_area(state: ForecastState, area: ZoneArea, words: str) -> None:
    """Check a scan whose axes are anywhere in an area; where that is too large, its ways are checked one by one when it
    runs. words: what these are."""
    zones = state.zones
    state.zones_checked = True
    if zones is None:
        return
    known_spans = {name: span for name, span in area.items() if span is not None}
    state.scan_area = {name: known_spans.get(name, zones.ranges[name]) for name in area if name in zones.ranges}
    sweep = Sweep({}, {**_find_positions(state, area, ()), **known_spans}, Timing(state.alone), list(area))
    violation = next(zones.find_violations(zones.make_course(sweep)), None)
    if violation is not None:
        state.notes[f"checked against zone {violation.rule.name} in the run only: the {words} of the scan"] = None


def find_area(state: ForecastState, names: Iterable[str]) -> ZoneArea:
    """Between which motor positions axes are before a step and now."""
    return {name: join_known(state.spans_before.get(name), _find_span(state, name)) for name in names}


def widen_area(state: ForecastState, area: ZoneArea, name: str, positions: Iterable[Fraction]) -> None:
    """Add user positions of an axis to an area; what they are of an axis that wraps, or whose offset is not known,
    is not known."""
    axis = state.axes[name]
    if axis.offset_kind != "motor" or state.fleet.axis(name).turn_length is not None:
        area[name] = None
        return
    for position in positions:
        motor = float(position - axis.offset)
        area[name] = join_known(area[name], (motor, motor))


def note_unchecked_passes(state: ForecastState, inner: InnerSteps, checked: int) -> None:
    """Say that passes between the first ones and the last, which differ in their targets, are checked in the run."""
    if state.zones is not None:
        state.notes[f"checked against zones in the run only: {inner.word} {checked + 1} to {inner.times - 1}"] = None


def _check(state: ForecastState, at: ForecastContext, sweep: Sweep) -> None:
    """Check a step; what depends on positions that only the world knows is a condition."""
    zones = state.zones
    state.zones_checked = True
    if zones is None:
        return
    course = zones.make_course(sweep)
    for violation in zones.find_violations(course):
        axes = violation.rule.constraint.axes
        open_axes = [name for name in course.unknown if name in axes and _is_open(state, name)]
        scanned_axes = [name for name in state.scanned if name in axes]
        if open_axes or scanned_axes:
            names, count = ", ".join([*open_axes, *scanned_axes]), len(open_axes) + len(scanned_axes)
            verb = "stands" if count == 1 else "stand"
            state.notes[f"{names} {verb} where zone {violation.rule.name} allows it"] = None
        else:
            state.add_problem(at, (), make_refusal(zones, course, violation))
    _note_trust(state, course)


def _note_trust(state: ForecastState, course: Course) -> None:
    """Say which rules rely on no axis of a step stopping alone."""
    for rule in () if state.zones is None else state.zones.rules:
        if rule.trust_step and len(course.moved.intersection(rule.constraint.axes)) > 1:
            axes = " and ".join(name for name in rule.constraint.axes if name in course.moved)
            state.notes[f"{axes} keep step: zone {rule.name} relies on it (trust_step)"] = None


def _find_positions(state: ForecastState, moved: Iterable[str], adrift: Iterable[str]) -> Box:
    """Between what motor positions the axes that rules depend on are, as far as that is known: those that stand, and
    those that the step moves from one span to another. moved: axes whose positions are not asked for here."""
    zones = state.zones
    positions: dict[str, tuple[float, float]] = {}
    moved_axes = set(moved)
    for name in () if zones is None else zones.ranges:
        span = None if name in moved_axes else state.scanned.get(name) or _find_span(state, name)
        if span is not None:
            positions[name] = span
    for name in adrift:
        span = join_known(state.spans_before.get(name), _find_span(state, name))
        if span is not None:
            positions[name] = span
    return positions


def _find_span(state: ForecastState, name: str) -> tuple[float, float] | None:
    """Between what motor positions an axis is now; None: nothing is known of that."""
    axis = state.axes.get(name)
    if axis is None or axis.referenced is False:
        return None
    known_range = state.find_range(name)
    return None if known_range is None else (float(known_range.low), float(known_range.high))


def join_known(first: tuple[float, float] | None, second: tuple[float, float] | None) -> tuple[float, float] | None:
    """The span of both; None where one of them is not known."""
    return None if first is None or second is None else join_spans(first, second)


def _is_open(state: ForecastState, name: str) -> bool:
    """Whether the run may find an axis at a place where a rule is kept: one that is not referenced has none."""
    axis = state.axes.get(name)
    return axis is None or axis.referenced is not False


def _find_skew_s(step: Motion) -> float:
    skews_ns = (step.max_start_skew, step.max_end_skew, step.max_path_skew)
    return max(skew_ns or 0 for skew_ns in skews_ns) / NS_PER_S
