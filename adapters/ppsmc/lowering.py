"""Lowering to speeds and ramps of the SMC: targets in its buffer started by one `tbg`, or one program line."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from adapters.contract import Lowered, ends_too_early, require_start_class
from adapters.ppsmc.costs import step_costs
from adapters.ppsmc.fleetaxes import axis_bounds, axis_number
from adapters.ppsmc.lines import LOWEST_POINT, edge_terms, starting_terms, switch_text, wait_text
from adapters.ppsmc.options import PpSmcOptions
from adapters.ppsmc.trapezoid import POSITION_MAX, PpSmcTrapezoid, fit_trapezoid
from adapters.toolkit.host_start import find_release_ns, withdrawable_costs
from adapters.toolkit.path_error import legs_in_host_time, path_error_counts
from adapters.toolkit.wired_points import (
    WiredInput,
    WiredOutput,
    resolve_driven_output,
    resolve_wait_input,
    waiting_terms,
)
from orchestrator.clock.inferred import ClockEstimate
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Controller
from orchestrator.model.messages import BudgetTerm, StartOptions
from orchestrator.model.profile import Profile

_POLL_LINES = 5  # of a poll that is under way when a step is released
_START_CLASS_REASONS = {
    "line": "the i/o port is an option of the controller, and `options.io_port` is not set; or no input was named",
    "clock": "the SMC has no readable clock to start by",
}
_START_CHARACTERS = len("tbg") + 2  # with its end of line
_ALIKE_S = 0.001
_MOST_SEARCHES = 24  # number of searches beyond the first ones; some milliseconds each


@dataclass(frozen=True, slots=True)
class PpSmcAxisMove:
    """One axis's part. distance: steps, signed. shape is None for an axis that stays at rest."""

    name: str
    motor: int
    start_counts: int
    distance: int
    shape: PpSmcTrapezoid | None

    @property
    def running_shape(self) -> PpSmcTrapezoid:
        """The shape of an axis that moves. Raises `ValueError` for one that stays at rest."""
        if self.shape is None:
            raise ValueError(f"axis {self.name} stays at rest")
        return self.shape

    @property
    def end_counts(self) -> int:
        return self.start_counts + self.distance


@dataclass(frozen=True, slots=True)
class PpSmcLowered(Lowered):
    """A lowered step with what loading it needs: the moves, and the trigger lines. lead_ns: the end of the timed
    command
    reaches the controller this long before T0."""

    lead_ns: int = 0
    moves: tuple[PpSmcAxisMove, ...] = ()
    wait: WiredInput | None = None
    drive: WiredOutput | None = None

    @property
    def by_program(self) -> bool:
        """Whether a program line moves the axes, and not the target buffer: i/o precedes positioning in it."""
        return bool(self.moves) and (self.wait is not None or self.drive is not None)


@dataclass(frozen=True, slots=True)
class ConnectionTraits:
    """What a lowered step depends on besides the fleet file.

    char_ns: one character on the slowest part of the connection, 0 for TCP.
    installed: number of axes of the controller.
    known: knowledge about its clock."""

    char_ns: int
    installed: int
    known: ClockEstimate


def lower_step(
    config: Controller,
    options: PpSmcOptions,
    traits: ConnectionTraits,
    profiles: Mapping[str, Profile],
    start_options: StartOptions,
) -> PpSmcLowered:
    """Lower all axes of a step. Raises `Refusal`."""
    estimate = traits.known
    if start_options.wait is not None and options.io_port:
        require_start_class(start_options, ("host", "line"), "")
    else:
        require_start_class(
            start_options,
            ("host",),
            _START_CLASS_REASONS[
                "line" if start_options.wait is not None or start_options.start_class == "line" else "clock"
            ],
        )
    wait = None if start_options.wait is None else resolve_wait_input(config, start_options.wait, LOWEST_POINT)
    drive = None if start_options.drive is None else resolve_driven_output(config, start_options.drive, LOWEST_POINT)
    rate, start = estimate.rate.clock_factor, estimate.latency
    moves = _make_common_moves(config, rate, profiles, start_options)
    real_moves = tuple(move for move in moves if move.shape is not None)
    durations_s = {move.name: move.shape.duration_s / rate if move.shape else 0.0 for move in moves}
    ramps_s = max((move.shape.stop_s for move in real_moves if move.shape is not None), default=0.0)
    costs = step_costs(options, traits.char_ns, traits.installed, ramps_s, waits=wait is not None)
    if start_options.starts_soon and wait is None and drive is None:
        costs = withdrawable_costs(costs, start.usual_ns, _POLL_LINES * options.decode_ns[1])
    return PpSmcLowered(
        start_class="host" if wait is None else "line",
        durations_s=durations_s,
        path_error_counts={move.name: _path_error(profiles[move.name], move, rate) for move in moves},
        terms=starting_terms(options, start, program=drive is not None)
        if wait is None
        else _line_start_terms(options, wait),
        tick_ns=0.0,
        clock_ppm=estimate.bound_ppm(max(durations_s.values(), default=0.0)),
        costs=costs,
        commands=_display_commands(real_moves, wait, drive),
        edge=() if drive is None else edge_terms(options, start),
        can_advance=True,
        lead_ns=start.usual_ns,
        release_ns=find_release_ns(start.usual_ns, _START_CHARACTERS * traits.char_ns, wait, drive),
        moves=real_moves,
        wait=wait,
        drive=drive,
    )


def _display_commands(
    running: tuple[PpSmcAxisMove, ...], wait: WiredInput | None, drive: WiredOutput | None
) -> tuple[str, ...]:
    """Return the commands for display; targets in steps."""
    if not running:
        return () if drive is None else (f"dout with bit {drive.bit} {'on' if drive.active else 'off'}",)
    shapes = [(move, move.shape) for move in running if move.shape is not None]
    if wait is None and drive is None:
        profile = [f"frun{e.motor}:{s.s} ffast{e.motor}:{s.f} acc{e.motor}:{s.a} dec{e.motor}:{s.d}" for e, s in shapes]
        return (*profile, "tbc", *(f"tbs{e.motor}:a ({e.end_counts} steps)" for e, _ in shapes), "tbg")
    first = wait_text(wait) if wait is not None else switch_text(drive) if drive is not None else ""
    move_lines = [f"{e.motor}:a ({e.end_counts} steps) s{s.s}r{s.f}a{s.a}d{s.d}" for e, s in shapes]
    return (first, *move_lines, "nl", "end", "start:")


def _make_common_moves(
    config: Controller, rate: float, profiles: Mapping[str, Profile], start_options: StartOptions
) -> list[PpSmcAxisMove]:
    """Return the moves, by axis number.

    Slow axes of one controller can have only certain durations, each its own: where that of one is longer, the others
    are searched for it as well, so that the controller reports one duration that all its axes can have, if there is one
    near. rate: seconds of the controller's crystal per host second."""

    def make_stretched(factor: float) -> list[PpSmcAxisMove]:
        moves = [
            _make_move(name, config.axes[name], profile, _TimeScale(rate, factor), start_options)
            for name, profile in profiles.items()
        ]
        return sorted(moves, key=lambda move: move.motor)

    first = moves = make_stretched(1.0)
    planned_s = [profile.duration_s for profile in profiles.values() if profile.start_counts != profile.end_counts]
    if len(planned_s) < 2 or max(planned_s) - min(planned_s) > _ALIKE_S:
        return first
    wanted_s, last_factor = planned_s[0] * rate, 1.0
    for _ in range(_MOST_SEARCHES // len(planned_s)):
        durations_s = [move.shape.duration_s for move in moves if move.shape is not None]
        if max(durations_s) - min(durations_s) <= _ALIKE_S:
            return moves
        factor = max(durations_s) / wanted_s
        if factor == last_factor:  # one axis cannot be so slow
            return first
        try:
            moves, last_factor = make_stretched(factor), factor
        except Refusal:  # beyond the slowest axis's longest duration: the first result shows the differences
            return first
    return first


class _TimeScale(NamedTuple):
    """Relation of a move's duration to its plan. rate: of the controller's crystal relative to the host's. factor: by
    which the move is slower than planned."""

    rate: float
    factor: float


def _make_move(
    name: str, axis: Axis, profile: Profile, scale: _TimeScale, start_options: StartOptions
) -> PpSmcAxisMove:
    """Return one axis's part. Raises `Refusal`."""
    rate, factor = scale
    if any(profile.jerks):
        raise Refusal("jerk", f"axis {name}: the SMC cannot limit jerk", "remove `jerk` from the axis's limits")
    distance = profile.end_counts - profile.start_counts
    if distance == 0:
        return PpSmcAxisMove(name, axis_number(axis), profile.start_counts, 0, None)
    if max(abs(profile.end_counts), abs(profile.start_counts)) > POSITION_MAX:
        raise Refusal(
            "too-far",
            f"axis {name}: a move to {profile.end_counts} steps exceeds the counter's {POSITION_MAX}",
            "move less far, or set another coordinate for this position at the controller",
        )
    limits, wanted_s = axis_bounds(axis), profile.duration_s * rate * factor
    shape = fit_trapezoid(abs(distance), wanted_s, profile.peak_acceleration / factor**2, limits)
    if shape is None:
        raise Refusal(
            "start-rate",
            f"axis {name}: no start speed from {limits.start_min} to {limits.start_max} Hz is below its speed limit",
            "correct `start_rate`",
        )
    # The controller's lowest speed is its lowest start speed: a slower move is refused, a longer duration is reported.
    if ends_too_early(shape.duration_s, wanted_s, start_options):
        raise Refusal(
            "too-slow",
            f"axis {name}: {abs(distance)} steps in {wanted_s:.6g} s is too slow for the controller; its "
            f"longest duration with its start speeds is {shape.duration_s:.6g} s",
            f"plan {shape.duration_s:.6g} s or less, lower `start_rate.min`, or let it end early with `max_end_skew`",
        )
    return PpSmcAxisMove(name, axis_number(axis), profile.start_counts, distance, shape)


def _path_error(profile: Profile, move: PpSmcAxisMove, rate: float) -> float:
    """Return the path error. rate: of the controller's crystal relative to the host's."""
    return 0.0 if move.shape is None else path_error_counts(profile, legs_in_host_time(move.shape.motion_legs, rate))


def _line_start_terms(options: PpSmcOptions, wait: WiredInput) -> tuple[BudgetTerm, ...]:
    """Return the terms of a start by trigger line relative to T0."""
    return waiting_terms(wait, options.input_scan_us, options.clock_ppm, options.line_start_us + options.start_skew_us)
