"""Profiles to a program of the SMC30, and the instant at which it is started.

A program that the host starts (E) holds a delay that is as long as the line still needs for the units after it:
starting lines follow each other in slots of whole hundredths of a second, so that the delays, which come in hundredths,
make all units of the line begin together. The last one waits one slot as well, and all programs are alike up to the
motion. A program that waits for a wired line holds N instead (L2088-L2147). Targets are absolute: what is carried
out twice by mistake moves nothing twice.
"""

from dataclasses import dataclass
from math import ceil
from typing import Literal

from adapters.contract import CannotDo, Lowered, require_how, too_quick
from adapters.smc30.options import Options
from adapters.smc30.ramp import Shape, fit
from adapters.smc30.unitaxis import POSITION_MAX, START_MAX, START_MIN, bounds, only_axis
from adapters.toolkit.path_error import in_host_time, path_error_counts
from adapters.toolkit.wired_points import driven, waited_for
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US
from orchestrator.clock.inferred import KnownClock
from orchestrator.clock.latency import Latency
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import LineDrive, LineWait, StartWay, Term
from orchestrator.model.profile import Profile
from orchestrator.model.state import Costs, StartClass

DELAY_NS = 10 * NS_PER_MS  # D counts hundredths of a second (L2525)
DELAY_MAX = 32_000
LINES_BEFORE = 5  # program lines up to the motion or the edge, with the one that does it: S, T, R, D, G or A
GAP_LINES = 2  # between two motor commands: T, G
_START_CHARACTERS = 4  # of a starting line: address, E, checksum, CR
_ANSWER_CHARACTERS = 3  # Y, checksum, CR


@dataclass(frozen=True, slots=True)
class Slots:
    """How the starting lines of a bus follow each other. place: of this unit, from 0. each_ns: whole `DELAY_NS`."""

    place: int
    count: int
    each_ns: int

    @property
    def delay_ns(self) -> int:
        """What this unit's program waits for, to begin together with the others."""
        return (self.count - self.place) * self.each_ns


def slots(options: Options, char_ns: int, place: int, count: int) -> Slots:
    """From the end of one starting line to the end of the next; by then the first is answered, as late as it may be.

    The next one is on its way while the answer comes: both directions have a wire of their own.
    """
    late_us = options.fire_late_us + options.decode_us + options.decode_spread_us
    late_us += 2 * options.wire_jitter_us + options.hold_us
    needed_ns = max(_ANSWER_CHARACTERS * char_ns + late_us * NS_PER_US, _START_CHARACTERS * char_ns)
    return Slots(place, count, ceil(needed_ns / DELAY_NS) * DELAY_NS)


@dataclass(frozen=True, slots=True)
class Point:
    """An input or output of the unit that a step uses. high: its level when active."""

    name: str
    number: int
    high: bool


@dataclass(frozen=True, slots=True)
class SmcLowered(Lowered):
    """What `arm` needs. lead_ns: the end of the starting line is at the unit so long before T0. program_ns: from there
    to the motion or the edge, least and most. target: None, when nothing moves."""

    axis: str = ""
    start_counts: int = 0
    target: int | None = None
    shape: Shape | None = None
    program: tuple[str, ...] = ()
    lead_ns: int = 0
    program_ns: tuple[int, int] = (0, 0)
    wait: Point | None = None
    drive: Point | None = None
    window_ns: tuple[int, int] = (0, 0)
    """About T0: where the start lies, by all terms."""


def lower(
    config: Controller,
    options: Options,
    costs: Costs,
    schedule: Slots,
    known: KnownClock,
    profiles: dict[str, Profile],
    how: StartWay,
) -> SmcLowered:
    """known: of the unit's clock. Raises `CannotDo`."""
    require_how(how, ("host", "line"), "the SMC30 has no readable clock to start by")
    wait, drive = _awaited(config, how.wait), _driven(config, how.drive)
    if wait is not None and drive is not None:
        raise CannotDo(
            "start-class",
            f"no output {drive.name} at T0 for a unit that waits for input {wait.name}: its program does one thing "
            "at a time",
            "have another controller drive the line",
        )
    if how.wait is None and how.by == "line":
        raise CannotDo("start-class", "no start by line: no input is named to wait for", "name it in the wiring")
    axis, _ = only_axis(config)
    profile = profiles.get(axis)
    shape = None if profile is None else _shape(config, options, profile, known.rate.factor, how)
    start_counts = 0 if profile is None else profile.start_counts
    target = None if profile is None or shape is None else profile.end_counts
    lead_ns = known.latency.usual_ns + schedule.delay_ns
    hold_ns = 0 if how.drive is None else how.drive.hold_ns
    program = _program(shape, start_counts, target, schedule, wait, drive, hold_ns)
    edge = _host_terms(options, schedule, known.latency)
    start_class: StartClass = "host"
    if wait is not None and how.wait is not None:
        start_class, terms = "line", _line_terms(options, how.wait)
    elif drive is not None:
        # The motion is the line after the one that switches the output.
        terms = _host_terms(options, schedule, known.latency, lines_after=1)
    else:
        terms = edge
    scale = 1 / known.rate.factor
    duration_s = 0.0 if shape is None else shape.duration_s * scale
    return SmcLowered(
        start_class=start_class,
        durations_s={} if profile is None else {axis: duration_s},
        path_error_counts={} if profile is None else {axis: _path_error(profile, shape, scale)},
        terms=terms,
        edge=edge if drive is not None else (),
        tick_ns=0.0,
        clock_ppm=known.clock_ppm(duration_s),
        sooner=True,
        costs=costs,
        commands=("PO", *program, "PX", "Q", "E") if program else (),
        axis=axis,
        start_counts=start_counts,
        target=target,
        shape=shape,
        program=program,
        lead_ns=lead_ns,
        program_ns=_program_ns(options, schedule, drive, target),
        wait=wait,
        drive=drive,
        window_ns=(sum(term.earliest_ns for term in terms), sum(term.latest_ns for term in terms)),
    )


def move_lines(shape: Shape, start_counts: int, target: int) -> tuple[list[str], list[str]]:
    """Parameters of the first motor command; and that command, with all that follows it."""
    sign = 1 if target > start_counts else -1
    first, *rest = shape.parts
    at = start_counts + sign * first.steps
    moves = [f"G{at:+d}"]
    for part in rest:
        at += sign * part.steps
        moves += [f"T{part.t}", f"G{at:+d}"]
    # T below S is a constant rate (L2286).
    s = max(min(START_MAX, part.t + 1) if part.constant else part.s for part in shape.parts)
    return [f"S{s}", f"T{first.t}", f"R{first.r}"], moves


def _program(
    shape: Shape | None,
    start_counts: int,
    target: int | None,
    schedule: Slots,
    wait: Point | None,
    drive: Point | None,
    hold_ns: int,
) -> tuple[str, ...]:
    if shape is None or target is None:
        # Nothing moves; the parameters are there so that all programs take the same time up to the edge.
        parameters, moves = [f"S{START_MIN}", f"T{START_MIN}", "R1"], list[str]()
    else:
        parameters, moves = move_lines(shape, start_counts, target)
    if wait is not None:
        return (*parameters, f"N{wait.number}{wait.number}.{int(wait.high)}9", *moves) if moves else ()
    delay = f"D{schedule.delay_ns // DELAY_NS}"
    if drive is None:
        return (*parameters, delay, *moves) if moves else ()
    left_ns = hold_ns - (0 if shape is None else round(shape.duration_s * NS_PER_S))
    hold = [f"D{min(DELAY_MAX, ceil(left_ns / DELAY_NS))}"] if left_ns > 0 else []
    on, off = ("A", "C") if drive.high else ("C", "A")
    return (*parameters, delay, f"{on}{drive.number}", *moves, *hold, f"{off}{drive.number}")


def _program_ns(options: Options, schedule: Slots, drive: Point | None, target: int | None) -> tuple[int, int]:
    """From the answer to E to the motion, or to the edge of a unit that does not move."""
    lines = LINES_BEFORE + (drive is not None and target is not None)
    line_ns, spread_ns = options.line_us * NS_PER_US, options.line_spread_us * NS_PER_US
    slow_ns = ceil(schedule.delay_ns * options.clock_ppm * 1e-6)
    middle_ns = lines * line_ns + schedule.delay_ns
    return middle_ns - lines * spread_ns - slow_ns, middle_ns + lines * spread_ns + slow_ns


def _host_terms(options: Options, schedule: Slots, start: Latency, lines_after: int = 0) -> tuple[Term, ...]:
    """The delay counts by a crystal of which no more is taken for known here than what is assumed."""
    after_us, spread_us = lines_after * options.line_us, lines_after * options.line_spread_us
    slow_ns = ceil(schedule.delay_ns * options.clock_ppm * 1e-6)
    first_ns = start.earliest_ns - start.usual_ns + (after_us - spread_us) * NS_PER_US
    last_ns = start.latest_ns - start.usual_ns + (after_us + spread_us - options.wire_jitter_us) * NS_PER_US
    return (
        options.host_term(),
        _term("wire", 0, options.wire_jitter_us),
        Term(name="firmware", earliest_ns=first_ns - slow_ns, latest_ns=last_ns + slow_ns),
    )


def _line_terms(options: Options, wait: LineWait) -> tuple[Term, ...]:
    least_us = max(0, options.start_us - options.start_spread_us)
    return (
        Term(name="line", earliest_ns=wait.earliest_ns, latest_ns=wait.latest_ns),
        _term("input", 0, options.input_filter_us + options.input_poll_us),
        _term("firmware", -least_us, options.start_us + options.start_spread_us),
    )


def _term(name: Literal["wire", "firmware", "input"], early_us: int, late_us: int) -> Term:
    return Term(name=name, earliest_ns=-early_us * NS_PER_US, latest_ns=late_us * NS_PER_US)


def _awaited(config: Controller, wait: LineWait | None) -> Point | None:
    if wait is None:
        return None
    point = waited_for(config, wait)
    return Point(wait.input, point.number, point.active == "high")


def _driven(config: Controller, drive: LineDrive | None) -> Point | None:
    if drive is None:
        return None
    point = driven(config, drive)
    return Point(drive.output, point.number, point.active == "high")


def _shape(config: Controller, options: Options, profile: Profile, correction: float, how: StartWay) -> Shape | None:
    """correction: seconds of the unit's crystal in one of the host's."""
    name, axis = only_axis(config)
    if any(profile.jerks):
        raise CannotDo("jerk", f"axis {name}: the SMC30 can not limit jerk", "leave `jerk` out of the axis's limits")
    steps = abs(profile.end_counts - profile.start_counts)
    if steps == 0:
        return None
    if max(abs(profile.end_counts), abs(profile.start_counts)) > POSITION_MAX:
        raise CannotDo(
            "too-far",
            f"axis {name}: a move to {profile.end_counts} steps is beyond the counter's {POSITION_MAX}",
            "home the axis, or make the move shorter",
        )
    limits, wanted_s = bounds(axis), profile.duration_s
    gap_s = GAP_LINES * options.line_us * 1e-6
    shape = fit(steps, wanted_s * correction, profile.durations_s[0] * correction, limits, gap_s)
    if shape is None:
        raise CannotDo(
            "limits",
            f"axis {name}: no rates of {START_MIN} to {limits.top} steps/s with a start rate of {limits.start_min} to "
            f"{limits.start_max} steps/s keep its acceleration over {steps} steps",
            "correct `start_rate`, or allow more acceleration",
        )
    if too_quick(shape.duration_s / correction, wanted_s, how):
        raise CannotDo(
            "too-slow",
            f"axis {name}: {steps} steps in {wanted_s:.6g} s is slower than the unit can; the longest that it can take "
            f"is {shape.duration_s / correction:.6g} s",
            f"plan {shape.duration_s / correction:.6g} s or less, lower `start_rate.min`, or let it end early with "
            "`max_end_skew`",
        )
    return shape


def _path_error(profile: Profile, shape: Shape | None, scale: float) -> float:
    """scale: host seconds of a second of the unit."""
    if shape is None:
        return 0.0
    return path_error_counts(profile, in_host_time(shape.legs, 1 / scale))
