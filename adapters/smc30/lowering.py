"""Lowering to a program of the SMC30, and to the instant at which it is started.

A program that the host starts (E) contains a delay for the time that the line still needs for the following
controllers: starting commands follow each other in slots of whole hundredths of a second, so that the delays, which are
multiples of hundredths, make all controllers of the line begin together. The last one waits one slot as well, and all
programs are alike up to the motion. A program that waits for a trigger line contains N instead (L2088-L2147). Targets
are absolute: a repeated execution by mistake moves nothing twice.

Where one motor command is all and its target fits into a register, the program takes it from there (L2929-L2931):
between moves of one speed only the register changes.
"""

from dataclasses import dataclass
from math import ceil
from typing import Literal, NamedTuple

from adapters.contract import Lowered, ends_too_early, require_start_class
from adapters.smc30.options import Smc30DriverOptions
from adapters.smc30.ramp import Smc30Shape, fit_shape
from adapters.smc30.unitaxis import POSITION_MAX, START_MAX, START_MIN, axis_bounds, only_axis
from adapters.toolkit.firing import learned_terms
from adapters.toolkit.host_start import find_release_ns, withdrawable_costs
from adapters.toolkit.path_error import legs_in_host_time, path_error_counts
from adapters.toolkit.wired_points import find_driven_output, find_wait_input
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US
from orchestrator.clock.inferred import ClockEstimate
from orchestrator.clock.latency import StartLatency
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import BudgetTerm, StartOptions, TriggerDrive, TriggerWait
from orchestrator.model.profile import Profile
from orchestrator.model.state import StartClass, StepCosts

DELAY_NS = 10 * NS_PER_MS  # D counts hundredths of a second (L2525)
DELAY_MAX = 32_000
LINES_BEFORE = 5  # program lines up to and including the one that begins the motion or the edge: S, T, R, D, G or A
GAP_LINES = 2  # between two motor commands: T, G
TARGET_REGISTER = 509
BY_REGISTER = f"G+(R{TARGET_REGISTER})"
REGISTER_MAX = 65_535  # L2987
_START_CHARACTERS = 4  # of a starting command: address, E, checksum, CR
_ANSWER_CHARACTERS = 3  # Y, checksum, CR


@dataclass(frozen=True, slots=True)
class SlotSchedule:
    """The sequence of starting commands of a bus.

    place: index of this controller, from 0.
    each_ns: length of a slot, a multiple of `DELAY_NS`."""

    place: int
    count: int
    each_ns: int

    @property
    def delay_ns(self) -> int:
        """The delay in this controller's program, with which it begins together with the others."""
        return (self.count - self.place) * self.each_ns


def make_slot_schedule(options: Smc30DriverOptions, char_ns: int, place: int, count: int) -> SlotSchedule:
    """Return the slots. A slot is the time from the end of one starting command to the end of the next; by then the
    first is answered, at its latest.

    The next command is sent while the answer arrives: each direction has a conductor of its own.
    """
    late_us = options.fire_late_us + options.decode_us + options.decode_spread_us
    late_us += 2 * options.wire_jitter_us + options.hold_us
    needed_ns = max(_ANSWER_CHARACTERS * char_ns + late_us * NS_PER_US, _START_CHARACTERS * char_ns)
    return SlotSchedule(place, count, ceil(needed_ns / DELAY_NS) * DELAY_NS)


@dataclass(frozen=True, slots=True)
class StepPoint:
    """An input or output of the controller that a step uses. high: its level when active."""

    name: str
    number: int
    high: bool


@dataclass(frozen=True, slots=True)
class Smc30Lowered(Lowered):
    """A lowered step with what loading it needs.

    lead_ns: the end of the starting command reaches the controller this long before T0.
    program_ns: from there to the motion or the edge, shortest and longest.
    target: None when nothing moves.
    by_register: the program takes the target from `TARGET_REGISTER`."""

    axis: str = ""
    start_counts: int = 0
    target: int | None = None
    shape: Smc30Shape | None = None
    program: tuple[str, ...] = ()
    by_register: bool = False
    lead_ns: int = 0
    program_ns: tuple[int, int] = (0, 0)
    wait: StepPoint | None = None
    drive: StepPoint | None = None


@dataclass(frozen=True, slots=True)
class ConnectionTraits:
    """What a lowered step depends on besides the fleet file. known: knowledge about the controller's clock. char_ns:
    one character on the line. program: that in working memory, as far as is known; target_arm_ns: arming behind a step
    with the same one."""

    costs: StepCosts
    schedule: SlotSchedule
    known: ClockEstimate
    char_ns: int
    program: tuple[str, ...] | None
    target_arm_ns: int


def lower_step(
    config: Controller,
    options: Smc30DriverOptions,
    traits: ConnectionTraits,
    profiles: dict[str, Profile],
    start: StartOptions,
) -> Smc30Lowered:
    """Lower a step. Raises `Refusal`."""
    schedule, estimate = traits.schedule, traits.known
    require_start_class(start, ("host", "line"), "the SMC30 has no readable clock to start by")
    wait, drive = _wait_point(config, start.wait), _drive_point(config, start.drive)
    if wait is not None and drive is not None:
        raise Refusal(
            "start-class",
            f"no output {drive.name} at T0 for a controller that waits for input {wait.name}: its program "
            "does one thing at a time",
            "let another controller drive the trigger line",
        )
    if start.wait is None and start.start_class == "line":
        raise Refusal(
            "start-class", "no start by trigger line: no input is named to wait for", "name the input in `wiring`"
        )
    axis, _ = only_axis(config)
    profile = profiles.get(axis)
    shape = None if profile is None else _fit_shape(config, options, profile, estimate.rate.clock_factor, start)
    start_counts = 0 if profile is None else profile.start_counts
    target = None if profile is None or shape is None else profile.end_counts
    lead_ns = estimate.latency.usual_ns + schedule.delay_ns
    hold_ns = 0 if start.drive is None else start.drive.active_ns
    motion = _Motion(shape, start_counts, target)
    program = _build_program(motion, schedule.delay_ns, wait, drive, hold_ns)
    by_register = program[-1:] == (BY_REGISTER,)
    edge = _host_terms(options, schedule, estimate.latency)
    start_class: StartClass = "host"
    if wait is not None and start.wait is not None:
        start_class, terms = "line", _line_terms(options, start.wait)
    elif drive is not None:
        # The motion is the line after the one that switches the output.
        terms = _host_terms(options, schedule, estimate.latency, lines_after=1)
    else:
        terms = edge
    scale = 1 / estimate.rate.clock_factor
    duration_s = 0.0 if shape is None else shape.duration_s * scale
    costs = traits.costs
    if start.follows and wait is None and drive is None:
        costs = _find_costs(costs, traits, program, lead_ns, by_register=by_register)
    return Smc30Lowered(
        start_class=start_class,
        durations_s={} if profile is None else {axis: duration_s},
        path_error_counts={} if profile is None else {axis: _path_error(profile, shape, scale)},
        terms=terms,
        edge=edge if drive is not None else (),
        tick_ns=0.0,
        clock_ppm=estimate.bound_ppm(duration_s),
        can_advance=True,
        costs=costs,
        commands=_list_commands(program, target if by_register else None),
        axis=axis,
        start_counts=start_counts,
        target=target,
        shape=shape,
        program=program,
        by_register=by_register,
        line_members=schedule.count,
        lead_ns=lead_ns,
        program_ns=_program_ns(options, schedule, drive, target),
        release_ns=find_release_ns(lead_ns, _START_CHARACTERS * traits.char_ns, wait, drive),
        wait=wait,
        drive=drive,
    )


def move_lines(shape: Smc30Shape, start_counts: int, target: int) -> tuple[list[str], list[str]]:
    """Return the parameters of the first motor command, and that command with everything that follows it."""
    sign = 1 if target > start_counts else -1
    first, *later_parts = shape.parts
    at = start_counts + sign * first.steps
    moves = [f"G{at:+d}"]
    for part in later_parts:
        at += sign * part.steps
        moves += [f"T{part.t}", f"G{at:+d}"]
    # T below S is a constant rate (L2286).
    s = max(min(START_MAX, part.t + 1) if part.is_constant else part.s for part in shape.parts)
    return [f"S{s}", f"T{first.t}", f"R{first.r}"], moves


class _Motion(NamedTuple):
    """The motion of a program; without a target it has none."""

    shape: Smc30Shape | None
    start_counts: int
    target: int | None

    @property
    def fits_register(self) -> bool:
        """Whether one motor command is all, and its target fits into a register."""
        is_one = self.shape is not None and len(self.shape.parts) == 1
        return is_one and self.target is not None and 0 <= self.target <= REGISTER_MAX


def _list_commands(program: tuple[str, ...], register_target: int | None) -> tuple[str, ...]:
    if not program:
        return ()
    loads_target = () if register_target is None else (f"R{TARGET_REGISTER}={register_target}",)
    return ("PO", *program, "PX", "Q", *loads_target, "E")


def _find_costs(
    costs: StepCosts, traits: ConnectionTraits, program: tuple[str, ...], lead_ns: int, *, by_register: bool
) -> StepCosts:
    """The costs of a step that the host starts behind another one."""
    costs = withdrawable_costs(costs, lead_ns, traits.schedule.each_ns)
    if not by_register or traits.program != program:
        return costs
    return costs.model_copy(update={"arm_ns": traits.target_arm_ns})


def _build_program(
    motion: _Motion,
    delay_ns: int,
    wait: StepPoint | None,
    drive: StepPoint | None,
    hold_ns: int,
) -> tuple[str, ...]:
    shape, start_counts, target = motion
    if shape is None or target is None:
        # Without motion, the parameters make all programs take the same time up to the edge.
        parameters, moves = [f"S{START_MIN}", f"T{START_MIN}", "R1"], list[str]()
    else:
        parameters, moves = move_lines(shape, start_counts, target)
    if wait is not None:
        return (*parameters, f"N{wait.number}{wait.number}.{int(wait.high)}9", *moves) if moves else ()
    delay = f"D{delay_ns // DELAY_NS}"
    if drive is None:
        moves = [BY_REGISTER] if motion.fits_register else moves
        return (*parameters, delay, *moves) if moves else ()
    left_ns = hold_ns - (0 if shape is None else round(shape.duration_s * NS_PER_S))
    hold = [f"D{min(DELAY_MAX, ceil(left_ns / DELAY_NS))}"] if left_ns > 0 else []
    on, off = ("A", "C") if drive.high else ("C", "A")
    return (*parameters, delay, f"{on}{drive.number}", *moves, *hold, f"{off}{drive.number}")


def _program_ns(
    options: Smc30DriverOptions, schedule: SlotSchedule, drive: StepPoint | None, target: int | None
) -> tuple[int, int]:
    """Return the time from the answer to E to the motion, or to the edge of a controller that does not move."""
    lines = LINES_BEFORE + (drive is not None and target is not None)
    line_ns, spread_ns = options.line_us * NS_PER_US, options.line_spread_us * NS_PER_US
    slow_ns = ceil(schedule.delay_ns * options.clock_ppm * 1e-6)
    middle_ns = lines * line_ns + schedule.delay_ns
    return middle_ns - lines * spread_ns - slow_ns, middle_ns + lines * spread_ns + slow_ns


def _host_terms(
    options: Smc30DriverOptions, schedule: SlotSchedule, start: StartLatency, lines_after: int = 0
) -> tuple[BudgetTerm, ...]:
    """Return the host's terms. The delay is counted by the crystal, for which only the assumed error is used here."""
    after_us, spread_us = lines_after * options.line_us, lines_after * options.line_spread_us
    slow_ns = ceil(schedule.delay_ns * options.clock_ppm * 1e-6)
    first_ns = start.earliest_ns - start.usual_ns + (after_us - spread_us) * NS_PER_US
    last_ns = start.latest_ns - start.usual_ns + (after_us + spread_us - options.wire_jitter_us) * NS_PER_US
    first_ns, last_ns = first_ns + start.learned_early_ns, last_ns - start.learned_late_ns
    return (
        options.host_term(),
        _make_term("wire", 0, options.wire_jitter_us),
        BudgetTerm(name="firmware", earliest_ns=first_ns - slow_ns, latest_ns=last_ns + slow_ns),
        *learned_terms(start),
    )


def _line_terms(options: Smc30DriverOptions, wait: TriggerWait) -> tuple[BudgetTerm, ...]:
    least_us = max(0, options.start_us - options.start_spread_us)
    return (
        BudgetTerm(name="line", earliest_ns=wait.earliest_ns, latest_ns=wait.latest_ns),
        _make_term("input", 0, options.input_filter_us + options.input_poll_us),
        _make_term("firmware", -least_us, options.start_us + options.start_spread_us),
    )


def _make_term(name: Literal["wire", "firmware", "input"], early_us: int, late_us: int) -> BudgetTerm:
    return BudgetTerm(name=name, earliest_ns=-early_us * NS_PER_US, latest_ns=late_us * NS_PER_US)


def _wait_point(config: Controller, wait: TriggerWait | None) -> StepPoint | None:
    if wait is None:
        return None
    point = find_wait_input(config, wait)
    return StepPoint(wait.input, point.number, point.active == "high")


def _drive_point(config: Controller, drive: TriggerDrive | None) -> StepPoint | None:
    if drive is None:
        return None
    point = find_driven_output(config, drive)
    return StepPoint(drive.output, point.number, point.active == "high")


def _fit_shape(
    config: Controller, options: Smc30DriverOptions, profile: Profile, correction: float, start: StartOptions
) -> Smc30Shape | None:
    """Return the shape of the move. correction: seconds of the controller's crystal per host second."""
    name, axis = only_axis(config)
    if any(profile.jerks):
        raise Refusal("jerk", f"axis {name}: the SMC30 cannot limit jerk", "remove `jerk` from the axis's limits")
    steps = abs(profile.end_counts - profile.start_counts)
    if steps == 0:
        return None
    if max(abs(profile.end_counts), abs(profile.start_counts)) > POSITION_MAX:
        raise Refusal(
            "too-far",
            f"axis {name}: a move to {profile.end_counts} steps exceeds the counter's {POSITION_MAX}",
            "home the axis, or make the move shorter",
        )
    limits, wanted_s = axis_bounds(axis), profile.duration_s
    gap_s = GAP_LINES * options.line_us * 1e-6
    shape = fit_shape(steps, wanted_s * correction, profile.durations_s[0] * correction, limits, gap_s)
    if shape is None:
        raise Refusal(
            "limits",
            f"axis {name}: no rates of {START_MIN} to {limits.top} steps/s with a start rate of "
            f"{limits.start_min} to {limits.start_max} steps/s respect its acceleration over {steps} steps",
            "correct `start_rate`, or allow more acceleration",
        )
    if ends_too_early(shape.duration_s / correction, wanted_s, start):
        raise Refusal(
            "too-slow",
            f"axis {name}: {steps} steps in {wanted_s:.6g} s is too slow for the controller; its longest "
            f"duration is {shape.duration_s / correction:.6g} s",
            f"plan {shape.duration_s / correction:.6g} s or less, lower `start_rate.min`, or let it end early with "
            "`max_end_skew`",
        )
    return shape


def _path_error(profile: Profile, shape: Smc30Shape | None, scale: float) -> float:
    """Return the path error. scale: host seconds per second of the controller."""
    if shape is None:
        return 0.0
    return path_error_counts(profile, legs_in_host_time(shape.motion_legs, 1 / scale))
