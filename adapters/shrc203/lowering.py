"""Profiles to lines of the SHRC-203: a prebuffer move an axis, all started by one `G:`, or by an input.

Where one move can not take the planned time, a second one is loaded behind it while it runs.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from adapters.contract import CannotDo, Lowered, require_how, too_quick
from adapters.shrc203.axes import letter
from adapters.shrc203.fleetaxes import bounds, motor
from adapters.shrc203.interpolation import Steady, Straight, straight_line
from adapters.shrc203.lines import Drive, Wait, driven, edge_terms, waited_for, waiting_terms
from adapters.shrc203.options import Options
from adapters.shrc203.pair import Pair, pairs
from adapters.shrc203.trapezoid import DISTANCE_MAX, RAMP_MAX_MS, Bounds, Trapezoid, fit
from adapters.toolkit.path_error import in_host_time, path_error_counts
from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.inferred import KnownClock
from orchestrator.clock.latency import Latency
from orchestrator.model.fleet import Axis, Controller
from orchestrator.model.messages import StartWay, Term
from orchestrator.model.profile import Profile
from orchestrator.model.state import Costs

OUTPUT_VALUES = range(64)
_WHY_NOT = {
    "line": "the unit takes no standby while its axes are at rest, or no input was named",
    "clock": "the SHRC-203 has no readable clock to start by",
}
# An interpolated line must be nearer to the plan by so many pulses: the unit goes in whole ones.
_NEARER = 0.5
# A second move is not needed where one alone is so near to the planned duration.
_ONE_S = 0.2e-3


@dataclass(frozen=True, slots=True)
class Wire:
    """What lowering knows of the connection. line_starts: whether axes can wait for an input. line_costs: of steps
    with a wired line. known: of the unit's clock. closed_loop: motors that settle for a while at the end of a move."""

    char_ns: int
    line_starts: bool
    costs: Costs
    line_costs: Costs
    known: KnownClock
    closed_loop: frozenset[int] = frozenset()


@dataclass(frozen=True, slots=True)
class AxisMove:
    """One axis's part. distance: pls, with its sign. shape is None for an axis that stays."""

    name: str
    motor: int
    start_counts: int
    distance: int
    shape: Trapezoid | Pair | Steady | None

    @property
    def pieces(self) -> "tuple[AxisMove, ...]":
        """The moves that the unit makes of it, in their order."""
        if not isinstance(self.shape, Pair):
            return (self,)
        one, two = self.shape.first, self.shape.second
        sign = 1 if self.distance > 0 else -1
        first = replace(self, distance=sign * one.distance, shape=one)
        return first, AxisMove(self.name, self.motor, first.end_counts, sign * two.distance, two)

    @property
    def end_counts(self) -> int:
        return self.start_counts + self.distance


@dataclass(frozen=True, slots=True)
class ShrcLowered(Lowered):
    """What `arm` needs: the moves, the lines that load and start them, and the lines by wire. lead_ns: the end of the
    line that starts, or switches an output, is at the unit so long before T0. firsts: what is loaded by
    `load`; seconds: what `load_second` loads behind it once it runs. straight: the moves are parts of one interpolated
    line."""

    lead_ns: int = 0
    moves: tuple[AxisMove, ...] = ()
    firsts: tuple[AxisMove, ...] = ()
    seconds: tuple[AxisMove, ...] = ()
    load: str = ""
    load_second: str = ""
    start: str = ""
    wait: Wait | None = None
    drive: Drive | None = None
    straight: Straight | None = None

    @property
    def window_ns(self) -> tuple[int, int]:
        """The start about T0, by all terms together."""
        return sum(each.earliest_ns for each in self.terms), sum(each.latest_ns for each in self.terms)


def lower(
    config: Controller,
    options: Options,
    wire: Wire,
    profiles: Mapping[str, Profile],
    how: StartWay,
) -> ShrcLowered:
    """Lower all axes of a step. Raises `CannotDo`."""
    if how.wait is not None and wire.line_starts:
        require_how(how, ("host", "line"), "")
    else:
        require_how(how, ("host",), _WHY_NOT["line" if how.wait is not None or how.by == "line" else "clock"])
    wait = None if how.wait is None else waited_for(config, how.wait)
    drive = None if how.drive is None else driven(config, how.drive)
    moves, straight = _moves(config, options, wire, profiles, how, interpolated=wait is None)
    running = tuple(each for each in moves if each.shape is not None)
    firsts = tuple(each.pieces[0] for each in running)
    seconds = tuple(piece for each in running for piece in each.pieces[1:])
    load = straight.command if straight is not None else load_line(firsts) if running else ""
    load_second = load_line(seconds) if seconds else ""
    go = start_line(running) if running else ""
    rate, lead_ns = wire.known.rate, wire.known.latency.usual_ns
    durations_s = {each.name: each.shape.duration_s / rate.factor if each.shape else 0.0 for each in moves}
    behind_ns = (len(f"O:{max(OUTPUT_VALUES)}") + 2) * wire.char_ns if running and wait is None else 0
    return ShrcLowered(
        start_class="host" if wait is None else "line",
        durations_s=durations_s,
        path_error_counts={each.name: _path_error(profiles[each.name], each, rate.factor) for each in moves},
        terms=terms(options, wire.known.latency) if wait is None else waiting_terms(options, wait),
        tick_ns=0.0,
        clock_ppm=wire.known.clock_ppm(max(durations_s.values(), default=0.0)),
        costs=wire.line_costs if wait is not None or drive is not None else wire.costs,
        commands=(*_shown(running, load, go, wait, drive), *([load_second] if seconds else [])),
        edge=() if drive is None else edge_terms(options, lead_ns, behind_ns),
        sooner=True,
        lead_ns=lead_ns,
        moves=running,
        firsts=firsts,
        seconds=seconds,
        load=load,
        load_second=load_second,
        start=go,
        wait=wait,
        drive=drive,
        straight=straight,
    )


def _moves(
    config: Controller,
    options: Options,
    wire: Wire,
    profiles: Mapping[str, Profile],
    how: StartWay,
    interpolated: bool,
) -> tuple[tuple[AxisMove, ...], Straight | None]:
    """The part of every axis; of a straight line by the unit's interpolation, where that is nearer to the plan than
    moves of single axes, or these can not be so slow.

    What an interpolated line sends at its end is not documented (L4653), so that it must be worth it.
    """
    ways = {name: _way(name, config.axes[name], each) for name, each in profiles.items()}
    running = tuple(each for each in ways.values() if each.distance)
    standing = tuple(each for each in ways.values() if not each.distance)
    factor = wire.known.rate.factor
    line = straight_line(config, options, profiles, [each.name for each in running], factor) if interpolated else None
    try:
        alone = tuple(_alone(config.axes[each.name], options, wire, each, profiles[each.name], how) for each in running)
    except CannotDo as refused:
        if line is None or refused.refusal.code != "too-slow":
            raise
        alone = None
    parts = () if line is None else _parts(line, running)
    if alone is not None and (not parts or _worst(profiles, parts, factor) > _worst(profiles, alone, factor) - _NEARER):
        parts, line = alone, None
    return tuple(sorted((*parts, *standing), key=lambda each: each.motor)), line


def _worst(profiles: Mapping[str, Profile], moves: tuple[AxisMove, ...], factor: float) -> float:
    return max((_path_error(profiles[each.name], each, factor) for each in moves), default=0.0)


def _parts(line: Straight, moves: tuple[AxisMove, ...]) -> tuple[AxisMove, ...]:
    """The axes of an interpolated line."""
    return tuple(replace(each, shape=Steady(abs(each.distance), line.duration_s)) for each in moves)


def _shown(
    running: tuple[AxisMove, ...], load: str, go: str, wait: Wait | None, drive: Drive | None
) -> tuple[str, ...]:
    """What is sent, for people. The other inputs and outputs are as they are found then."""
    switch = () if drive is None else (f"O: with OUT{drive.number} {'on' if drive.active else 'off'}",)
    if not running:
        return switch
    if wait is None:
        return (load, go, *switch)
    pattern = f"WI:{letter(each.motor for each in running)}, with IN{wait.number} {'on' if wait.active else 'off'}"
    return (pattern, go, load, *switch)


def terms(options: Options, start: Latency) -> tuple[Term, ...]:
    """Where the start lies about T0: the starting line is written so that its usual start meets it."""
    jitter_ns = options.wire_jitter_us * NS_PER_US
    first_ns, last_ns = start.earliest_ns - start.usual_ns, start.latest_ns - jitter_ns - start.usual_ns
    return (
        options.host_term(),
        Term(name="wire", earliest_ns=0, latest_ns=jitter_ns),
        Term(name="firmware", earliest_ns=first_ns, latest_ns=last_ns),
    )


def load_line(moves: tuple[AxisMove, ...]) -> str:
    """`MP:A+P10000-P4000,S2F5714R250S5F2285R250` (L3124-L3167); relative, so that it is exact in commanded pulses."""
    where = "".join(f"{'-' if each.distance < 0 else '+'}P{abs(each.distance)}" for each in moves)
    shapes = [each.shape for each in moves if isinstance(each.shape, Trapezoid)]
    speeds = "".join(f"S{shape.s}F{shape.f}R{shape.r}" for shape in shapes)
    return f"MP:{letter(each.motor for each in moves)}{where},{speeds}"


def start_line(moves: tuple[AxisMove, ...]) -> str:
    """One line starts all axes of a unit (L4779-L4822)."""
    return f"G:{letter(each.motor for each in moves)}"


def _way(name: str, axis: Axis, profile: Profile) -> AxisMove:
    """What an axis has to do, without a shape yet."""
    if any(profile.jerks):
        raise CannotDo("jerk", f"axis {name}: the SHRC-203 can not limit jerk", "leave `jerk` out of the axis's limits")
    distance = profile.end_counts - profile.start_counts
    if distance and (abs(distance) > DISTANCE_MAX or abs(profile.end_counts) > DISTANCE_MAX):
        raise CannotDo(
            "too-far",
            f"axis {name}: a move of {distance} pulses to {profile.end_counts} is beyond {DISTANCE_MAX}",
            "make it shorter",
        )
    return AxisMove(name, motor(axis), profile.start_counts, distance, None)


def _alone(axis: Axis, options: Options, wire: Wire, move: AxisMove, profile: Profile, how: StartWay) -> AxisMove:
    """The move of an axis by itself. Raises `CannotDo`."""
    factor, limits, way, name = wire.known.rate.factor, bounds(axis), abs(move.distance), move.name
    wanted_s = profile.duration_s * factor  # of the unit's own
    shape: Trapezoid | Pair | None = fit(way, wanted_s, profile.durations_s[0] * factor, limits)
    if shape is None:
        raise CannotDo(
            "start-rate",
            f"axis {name}: no start speed from {limits.start_min} to {limits.start_max} pls/s is below its speed limit",
            "correct `start_rate`",
        )
    if move.motor not in wire.closed_loop:  # where the end of the first move is known only when the scale has settled
        shape = _nearer(shape, way, profile, limits, options, factor)
    # The unit's slowest is its start speed: what would have to be slower is refused, what needs longer is answered.
    if too_quick(shape.duration_s / factor, profile.duration_s, how):
        raise CannotDo(
            "too-slow",
            f"axis {name}: {way} pulses in {profile.duration_s:.6g} s is slower than the unit can; the longest that it "
            f"can take within ramps of {RAMP_MAX_MS} ms and its start speeds is {shape.duration_s / factor:.6g} s",
            f"plan {shape.duration_s / factor:.6g} s or less, lower `start_rate.min`, or let it end early with "
            "`max_end_skew`",
        )
    return replace(move, shape=shape)


def _nearer(
    one: Trapezoid, way: int, profile: Profile, limits: Bounds, options: Options, factor: float
) -> Trapezoid | Pair:
    """One move, or two where that is off the planned duration; of those that take it, the one that keeps nearest to the
    plan."""
    wanted_s = profile.duration_s * factor

    def off_s(shape: Trapezoid | Pair) -> float:
        return abs(shape.duration_s - wanted_s)

    if off_s(one) <= _ONE_S:
        return one
    found = pairs(way, wanted_s, limits, options.handover_us * 1e-6)
    two = min(found, key=lambda each: path_error_counts(profile, in_host_time(each.legs, factor)), default=None)
    return one if two is None or off_s(two) >= off_s(one) else two


def _path_error(profile: Profile, move: AxisMove, factor: float) -> float:
    return 0.0 if move.shape is None else path_error_counts(profile, in_host_time(move.shape.legs, factor))
