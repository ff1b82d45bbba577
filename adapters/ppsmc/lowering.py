"""Profiles to speeds and ramps of the SMC: targets in its buffer started by one `tbg`, or one program line."""

from collections.abc import Mapping
from dataclasses import dataclass

from adapters.contract import CannotDo, Lowered, require_how, too_quick
from adapters.ppsmc.costs import costs
from adapters.ppsmc.fleetaxes import bounds, motor
from adapters.ppsmc.lines import Drive, Wait, driven, edge_terms, starting_terms, waited_for, waiting_terms
from adapters.ppsmc.options import Options
from adapters.ppsmc.trapezoid import POSITION_MAX, Trapezoid, fit
from adapters.toolkit.path_error import in_host_time, path_error_counts
from orchestrator.clock.inferred import KnownClock
from orchestrator.model.fleet import Axis, Controller
from orchestrator.model.messages import StartWay
from orchestrator.model.profile import Profile

_WHY_NOT = {
    "line": "the i/o port is an option of the unit, and `options.io_port` is not set; or no input was named",
    "clock": "the SMC has no readable clock to start by",
}
_ALIKE_S = 0.001
_FITS = 24  # so many are looked for beyond the first ones; some milliseconds each


@dataclass(frozen=True, slots=True)
class AxisMove:
    """One axis's part. distance: steps, with its sign. shape is None for an axis that stays."""

    name: str
    motor: int
    start_counts: int
    distance: int
    shape: Trapezoid | None

    @property
    def end_counts(self) -> int:
        return self.start_counts + self.distance


@dataclass(frozen=True, slots=True)
class SmcLowered(Lowered):
    """What `arm` needs: the moves, and the lines by wire. lead_ns: the end of the line that is fired is at the unit so
    long before T0."""

    lead_ns: int = 0
    moves: tuple[AxisMove, ...] = ()
    wait: Wait | None = None
    drive: Drive | None = None

    @property
    def window_ns(self) -> tuple[int, int]:
        """The start about T0, by all terms together."""
        return sum(each.earliest_ns for each in self.terms), sum(each.latest_ns for each in self.terms)

    @property
    def by_program(self) -> bool:
        """Whether a program line moves the axes, and not the target buffer: i/o goes before positioning in it."""
        return bool(self.moves) and (self.wait is not None or self.drive is not None)


def lower(
    config: Controller,
    options: Options,
    char_ns: int,
    installed: int,
    known: KnownClock,
    profiles: Mapping[str, Profile],
    how: StartWay,
) -> SmcLowered:
    """Lower all axes of a step. installed: axes of the unit; known: of its clock. Raises `CannotDo`."""
    if how.wait is not None and options.io_port:
        require_how(how, ("host", "line"), "")
    else:
        require_how(how, ("host",), _WHY_NOT["line" if how.wait is not None or how.by == "line" else "clock"])
    wait = None if how.wait is None else waited_for(config, how.wait)
    drive = None if how.drive is None else driven(config, how.drive)
    rate, start = known.rate.factor, known.latency
    moves = _together(config, rate, profiles, how)
    running = tuple(each for each in moves if each.shape is not None)
    durations_s = {each.name: each.shape.duration_s / rate if each.shape else 0.0 for each in moves}
    ramps_s = max((each.shape.stop_s for each in running if each.shape is not None), default=0.0)
    return SmcLowered(
        start_class="host" if wait is None else "line",
        durations_s=durations_s,
        path_error_counts={each.name: _path_error(profiles[each.name], each, rate) for each in moves},
        terms=starting_terms(options, start, drive is not None) if wait is None else waiting_terms(options, wait),
        tick_ns=0.0,
        clock_ppm=known.clock_ppm(max(durations_s.values(), default=0.0)),
        costs=costs(options, char_ns, installed, ramps_s, wait is not None),
        commands=_shown(running, wait, drive),
        edge=() if drive is None else edge_terms(options, start),
        sooner=True,
        lead_ns=start.usual_ns,
        moves=running,
        wait=wait,
        drive=drive,
    )


def _shown(running: tuple[AxisMove, ...], wait: Wait | None, drive: Drive | None) -> tuple[str, ...]:
    """What is sent, for people; targets in steps."""
    if not running:
        return () if drive is None else (f"dout with bit {drive.bit} {'on' if drive.active else 'off'}",)
    shapes = [(each, each.shape) for each in running if each.shape is not None]
    if wait is None and drive is None:
        profile = [f"frun{e.motor}:{s.s} ffast{e.motor}:{s.f} acc{e.motor}:{s.a} dec{e.motor}:{s.d}" for e, s in shapes]
        return (*profile, "tbc", *(f"tbs{e.motor}:a ({e.end_counts} steps)" for e, _ in shapes), "tbg")
    first = wait.command if wait is not None else drive.command if drive is not None else ""
    moving = [f"{e.motor}:a ({e.end_counts} steps) s{s.s}r{s.f}a{s.a}d{s.d}" for e, s in shapes]
    return (first, *moving, "nl", "end", "start:")


def _together(config: Controller, rate: float, profiles: Mapping[str, Profile], how: StartWay) -> list[AxisMove]:
    """The moves, by axis number. Slow axes of one unit have only some durations, each its own: where that of one is
    longer, the others are asked for it as well, so that the unit answers with one that all its axes have, if there
    is one near. rate: seconds of the unit's crystal in one of the host's."""

    def stretched(factor: float) -> list[AxisMove]:
        moves = [_move(name, config.axes[name], each, rate, factor, how) for name, each in profiles.items()]
        return sorted(moves, key=lambda each: each.motor)

    first = moves = stretched(1.0)
    planned_s = [each.duration_s for each in profiles.values() if each.start_counts != each.end_counts]
    if len(planned_s) < 2 or max(planned_s) - min(planned_s) > _ALIKE_S:
        return first
    wanted_s, asked = planned_s[0] * rate, 1.0
    for _ in range(_FITS // len(planned_s)):
        durations_s = [each.shape.duration_s for each in moves if each.shape is not None]
        if max(durations_s) - min(durations_s) <= _ALIKE_S:
            return moves
        factor = max(durations_s) / wanted_s
        if factor == asked:  # one can not be so slow
            return first
        try:
            moves, asked = stretched(factor), factor
        except CannotDo:  # beyond what a slower one of them can make: the first answer says how far they are apart
            return first
    return first


def _move(name: str, axis: Axis, profile: Profile, rate: float, factor: float, how: StartWay) -> AxisMove:
    """One axis's part, in `factor` times the planned duration. Raises `CannotDo`."""
    if any(profile.jerks):
        raise CannotDo("jerk", f"axis {name}: the SMC can not limit jerk", "leave `jerk` out of the axis's limits")
    distance = profile.end_counts - profile.start_counts
    if distance == 0:
        return AxisMove(name, motor(axis), profile.start_counts, 0, None)
    if max(abs(profile.end_counts), abs(profile.start_counts)) > POSITION_MAX:
        raise CannotDo(
            "too-far",
            f"axis {name}: a move to {profile.end_counts} steps is beyond the counter's {POSITION_MAX}",
            "move less far, or give the place another coordinate at the unit",
        )
    limits, wanted_s = bounds(axis), profile.duration_s * rate * factor
    shape = fit(abs(distance), wanted_s, profile.peak_acceleration / factor**2, limits)
    if shape is None:
        raise CannotDo(
            "start-rate",
            f"axis {name}: no start speed from {limits.start_min} to {limits.start_max} Hz is below its speed limit",
            "correct `start_rate`",
        )
    # The unit's slowest is its lowest start speed: what would have to be slower is refused, what needs longer answered.
    if too_quick(shape.duration_s, wanted_s, how):
        raise CannotDo(
            "too-slow",
            f"axis {name}: {abs(distance)} steps in {wanted_s:.6g} s is slower than the unit can; the longest that it "
            f"can take with its start speeds is {shape.duration_s:.6g} s",
            f"plan {shape.duration_s:.6g} s or less, lower `start_rate.min`, or let it end early with `max_end_skew`",
        )
    return AxisMove(name, motor(axis), profile.start_counts, distance, shape)


def _path_error(profile: Profile, move: AxisMove, rate: float) -> float:
    """rate: of the unit's crystal against the host's."""
    return 0.0 if move.shape is None else path_error_counts(profile, in_host_time(move.shape.legs, rate))
