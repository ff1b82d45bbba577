"""Lowering: profiles compiled to what the controller executes, and the guarantees for it.

The same rule applies to all axes of a step, because one begin command starts them: independent moves (PA, SP, AC, DC)
when the registers reproduce the duration of every trapezoid to a fifth of a sample, or a little longer where a limit
restricts it (the plan is stretched to that), and stay near its path; otherwise a contour. If no contour can hold a step
of trapezoids either, the registers execute it all the same, and its durations state the deviation.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

from adapters.contract import PathChunk, require_start_class
from adapters.toolkit.host_start import WITHDRAW_NS
from adapters.yaskawa.common import arrays, lines
from adapters.yaskawa.common.gate import AT_ONCE_LATEST_NS, AT_ONCE_TICKS, GateTiming
from adapters.yaskawa.common.loads import (
    ContourLoad,
    CourseLoad,
    MoveLoad,
    RegisterLoad,
    YaskawaAxisMove,
    YaskawaLowered,
)
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.program import LOOP_COMMANDS, TAIL_LENGTH
from adapters.yaskawa.common.registers import exact_ramp
from adapters.yaskawa.shapes.contour import (
    Contour,
    ContourLimits,
    fit_contour,
    least_interval,
    require_record_range,
    require_speed_range,
)
from adapters.yaskawa.shapes.course_records import (
    RecordMaker,
    find_chunk_s,
    find_room,
)
from adapters.yaskawa.shapes.model import SMC4000, ModelTraits
from adapters.yaskawa.shapes.trapezoid import RegisterTrapezoid, SampleAlignment, YaskawaBounds, fit_registers
from orchestrator.clock.base import NS_PER_MS, NS_PER_US
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import BudgetTerm, ChunkOptions, StartOptions
from orchestrator.model.profile import Profile
from orchestrator.model.state import StartClass, StepCosts

START_CLASSES: tuple[StartClass, ...] = ("clock", "line")
ADVANCE_COMMANDS = 4  # XFT, XFARM, the watchdog's extension, XFGO
RELEASE_SPARE_TICKS = 2  # of a start at once: from the choice of its T0 to the release
AT_ONCE_TERM = BudgetTerm(name="at-once", earliest_ns=0, latest_ns=AT_ONCE_LATEST_NS)
STOP_EXCHANGES = 3  # a stop of motion is three commands
DURATION_TOLERANCE_SAMPLES = 0.2  # allowed deviation of an independent move's duration from the plan
STRETCH = 1e-3  # or longer by this fraction, where a limit restricts it: the plan is stretched to it
SKEW_SAMPLES = 10.0  # allowed path deviation, at its peak speed,
NEAR_COUNTS = 2.0  # or this number of counts
SHORTEST_COURSE = 8  # records
LATER_TICKS = 4.0  # largest delay of a common end of all participants after the plan's end
OPENING_NS = 6 * NS_PER_MS  # less than the shortest time for the answer to a release
WITHDRAW_EXCHANGES = 2  # the one under way, and the stop
HOST_COMMANDS = 2  # of the host, that may interrupt one round of the contour's loop: one before each of its lines
LOOP_SPREAD = 2.0  # factor of a command's duration: the manual does not state what expressions add (L1626)


@dataclass(frozen=True, slots=True)
class LoweringContext:
    """The controller for which steps are lowered. motors: index of each axis. packets: how arrays are loaded. gate:
    the timing of its program; None for one that cannot hold a following step. axes: of the controller.
    begins_at_once: that program can begin a following step as soon as the one before has ended.
    release_ns: how long a release or a withdrawal of a following step takes. geared: axes of two motors, which move by
    registers alone, and with no step beside: its program compares the counts of all motors. beside_commands,
    beside_elements: what triggers take from a contour."""

    config: Controller
    motors: Mapping[str, int]
    options: YaskawaOptions
    costs: StepCosts
    model: ModelTraits = SMC4000
    packets: arrays.ArrayTransfer = arrays.DEFAULT_TRANSFER
    gate: GateTiming | None = None
    axes: int = 0
    begins_at_once: bool = False
    release_ns: int = 0
    geared: frozenset[str] = frozenset()
    beside_commands: float = 0.0
    beside_elements: int = 0


def lower_moves(
    context: LoweringContext, profiles: Mapping[str, Profile], start: StartOptions, mapping: TickMapping | None
) -> YaskawaLowered:
    """Lower the profiles of a step. Pure. Raises `Refusal` that names the axis and what would fit.

    Where uploads are slow, the registers execute trapezoids, whatever their deviation.
    """
    require_start_class(start, START_CLASSES, "its own clock is never less accurate than a command from the host")
    if start.start_class == "line" and start.wait is None:
        raise Refusal("start-class", "no trigger line is wired that could start it", "add `wiring` to the fleet file")
    if mapping is None:
        raise Refusal("no-clock", "the controller's clock is not known yet", "wait a second")
    tick_ns, config, motors, model = mapping.tick_ns, context.config, context.motors, context.model
    bounds = {
        axis: YaskawaBounds(config.axes[axis].limits.velocity * scale, config.axes[axis].limits.acceleration * scale)
        for axis in profiles
        for scale in [float(config.axes[axis].scale)]
    }
    if profiles and start.chunk is not None and start.wait is None:
        course = _lower_to_course(context, profiles, bounds, tick_ns, start.chunk)
        if course is not None:
            return _make_lowered(context, course, profiles, start, mapping)
    way = {axis: profile for axis, profile in profiles.items() if not profile.is_still}
    places = _sample_alignments(way, mapping, start)
    shapes, refusal_text = _lower_to_registers(way, bounds, tick_ns, model, places)
    load: MoveLoad
    note: tuple[str, ...] = ()
    if shapes is not None and (_must_be_registers(context, way) or not refusal_text):
        load = _build_registers(shapes, way, motors)
        note = (f"({refusal_text})",) if refusal_text else ()
    else:
        try:
            load = _lower_to_contour(context, way, bounds, tick_ns, start.brake_s)
            note = (f"({refusal_text})",) if refusal_text else ()
        except Refusal as refusal:
            if shapes is None:
                raise
            load = _build_registers(shapes, way, motors)
            note = (f"({refusal_text}; no contour: {refusal})",)
    lowered_move = _make_lowered(context, load, profiles, start, mapping)
    return replace(lowered_move, commands=(*lowered_move.commands, *note))


def _lower_to_registers(
    way: Mapping[str, Profile],
    bounds: Mapping[str, YaskawaBounds],
    tick_ns: float,
    model: ModelTraits,
    places: Mapping[str, SampleAlignment],
) -> tuple[dict[str, RegisterTrapezoid] | None, str]:
    """Return the trapezoids, None where an axis's profile is not one; and why a contour is preferable, or an empty
    text.

    places: the intended alignment of axes to the samples; where the registers cannot reach it, the nearest to the plan.
    """
    try:
        shapes = fit_registers(way, bounds, tick_ns, model, places) if places else {}
        # Where the intended sample cannot be reached, choose as if no alignment were given.
        other_profiles = {
            axis: profile
            for axis, profile in way.items()
            if axis not in shapes
            or shapes[axis].whole_samples != places[axis].last
            or not stays_near_plan(shapes[axis], profile, tick_ns)
        }
        shapes |= fit_registers(other_profiles, bounds, tick_ns, model) if other_profiles else {}
    except Refusal as refusal:
        if refusal.code != "shape":
            raise
        return None, ""
    for axis, profile in other_profiles.items():
        shape = shapes[axis]
        if not _registers_suffice(shape, profile, tick_ns):
            return shapes, (
                f"with its registers {axis} ends {shape.off * tick_ns * 1e-6:+.2f} ms off and deviates "
                f"from its plan by up to {shape.path_error_counts:.0f} counts"
            )
    return shapes, ""


def _sample_alignments(
    way: Mapping[str, Profile], mapping: TickMapping, start: StartOptions
) -> dict[str, SampleAlignment]:
    """Return each axis's alignment: the samples next to the common begin and end. None, where it begins at a trigger
    line, and where nothing else depends on its samples."""
    if not start.exact or start.wait is not None or start.at_once:
        return {}
    at = mapping.to_ticks(mapping.host_at_ns + start.lead_ns)
    phase = round(at) - at
    places: dict[str, SampleAlignment] = {}
    for axis, profile in way.items():
        ends_ns = profile.duration_s * 1e9
        # An axis that ends before the others has an end of its own.
        ends_ns = start.end_ns if 0.0 <= start.end_ns - ends_ns <= LATER_TICKS * mapping.tick_ns else ends_ns
        places[axis] = SampleAlignment(phase, round(ends_ns / mapping.tick_ns - phase))
    return places


def _registers_suffice(shape: RegisterTrapezoid, profile: Profile, tick_ns: float) -> bool:
    in_time = abs(shape.off) <= DURATION_TOLERANCE_SAMPLES
    is_limited = shape.at_limit and 0.0 < shape.off <= STRETCH * shape.length
    return (in_time or is_limited) and stays_near_plan(shape, profile, tick_ns)


def stays_near_plan(shape: RegisterTrapezoid, profile: Profile, tick_ns: float) -> bool:
    """Return whether the move stays near its plan."""
    peak = profile.peak_velocity * tick_ns * 1e-9
    return shape.path_error_counts <= max(NEAR_COUNTS, SKEW_SAMPLES * peak)


def _build_registers(
    shapes: Mapping[str, RegisterTrapezoid], way: Mapping[str, Profile], motors: Mapping[str, int]
) -> RegisterLoad:
    ends = {motors[axis]: profile.end_counts for axis, profile in way.items()}
    return RegisterLoad(ends, {motors[axis]: shape for axis, shape in shapes.items()})


def _must_be_registers(context: LoweringContext, way: Mapping[str, Profile]) -> bool:
    """Whether registers execute trapezoids, whatever their deviation: where uploads are slow, and of axes that contours
    do not move."""
    return bool(context.geared & way.keys()) or isinstance(context.packets, arrays.SlowArrayTransfer)


def takes_chunks(context: LoweringContext) -> bool:
    """Whether a path can be loaded in chunks while it is executed: not where uploads are slow."""
    by_registers = bool(context.geared) or isinstance(context.packets, arrays.SlowArrayTransfer)
    return context.model.contours and not by_registers


def find_interval(context: LoweringContext, tick_ns: float) -> int:
    """The exponent of the shortest records that the program keeps up with."""
    options, model = context.options, context.model
    commands = LOOP_COMMANDS + HOST_COMMANDS + model.interleaved_commands + context.beside_commands
    loop_ns = commands * LOOP_SPREAD * options.decode_us * NS_PER_US
    return max(least_interval(loop_ns, tick_ns, model), model.intervals[0])


def find_chunk_times(context: LoweringContext, tick_ns: float) -> tuple[float, float]:
    """The longest chunk of a path of all its axes, s, and how long loading it takes while it moves; (0, 0) if there is
    no room for one."""
    record_s = tick_ns * 1e-9 * (1 << find_interval(context, tick_ns))
    try:
        room = find_room(_count_elements(context), len(context.motors), record_s)
    except Refusal:
        return 0.0, 0.0
    chunk_s = find_chunk_s(room, record_s)
    elements = len(context.motors) * (chunk_s / record_s + room.tail)
    # An element is assigned by one command, and its part in a command that reads it back and in the loop takes as long.
    return chunk_s, elements * 2 * context.options.decode_us * 1e-6


def _count_elements(context: LoweringContext) -> int:
    """The elements of all increments of a contour."""
    return context.options.array_elements - TAIL_LENGTH - context.beside_elements


def _lower_to_course(
    context: LoweringContext,
    profiles: Mapping[str, Profile],
    bounds: Mapping[str, YaskawaBounds],
    tick_ns: float,
    part: ChunkOptions,
) -> CourseLoad | None:
    """The first chunk of a path; None where paths are loaded as a whole, and for one of a few records, which needs no
    second one. Raises `Refusal`."""
    if not takes_chunks(context):
        return None
    model, interval = context.model, find_interval(context, tick_ns)
    tick_s = tick_ns * 1e-9
    record_s = tick_s * (1 << interval)
    if part.last and part.end_s < SHORTEST_COURSE * record_s:
        return None
    require_speed_range(profiles, tick_s, model)
    require_record_range(profiles, tick_s, interval, model)
    room = find_room(_count_elements(context), len(profiles), record_s)
    maker = RecordMaker({axis: context.motors[axis] for axis in profiles}, interval, room, model)
    chunk = PathChunk(0, 0.0, part.end_s, part.last, profiles)
    records = maker.make_first(chunk, 0.0, tick_ns)
    samples = records.samples(interval)
    peaks = {axis: max(p.peak_acceleration, part.peak_accelerations.get(axis, 0.0)) for axis, p in profiles.items()}
    sag_counts = {axis: peak * record_s**2 / 8 for axis, peak in peaks.items()}
    contour = Contour(interval, records.end + records.full, records.short, dict.fromkeys(profiles, samples), sag_counts)
    return CourseLoad(
        contour,
        {context.motors[axis]: profile for axis, profile in profiles.items()},
        {context.motors[axis]: samples for axis in profiles},
        {context.motors[axis]: exact_ramp(axis, bounds[axis].acceleration, tick_s) for axis in profiles},
        chunk=chunk,
        maker=maker,
        records=records,
    )


def _lower_to_contour(
    context: LoweringContext,
    way: Mapping[str, Profile],
    bounds: Mapping[str, YaskawaBounds],
    tick_ns: float,
    brake_s: float,
) -> ContourLoad:
    motors, options, model, packets = context.motors, context.options, context.model, context.packets
    geared_axes = sorted(context.geared & way.keys())
    if geared_axes:
        text = f"axis {geared_axes[0]} has two motors: it moves from rest to rest, by trapezoids, and not along a path"
        raise Refusal("no-contour", text, "move it by a step of its own")
    if not model.contours:
        raise Refusal(
            "order",
            f"axis {next(iter(way))}: the profile is not a trapezoid; contours are not supported for this "
            "number of axes",
            "remove `jerk` from its limits, and move it from standstill to standstill",
        )
    room = ContourLimits(
        _count_elements(context),
        find_interval(context, tick_ns),
        options.contour_sag_counts,
    )

    def build_records(within: ContourLimits) -> ContourLoad:
        contour = fit_contour(way, tick_ns, within, model)
        return ContourLoad(
            contour,
            {motors[axis]: profile for axis, profile in way.items()},
            {motors[axis]: contour.ends[axis] for axis in way},
            {
                motors[axis]: exact_ramp(
                    axis, _common_deceleration(bounds[axis].acceleration, profile, brake_s), tick_ns * 1e-9
                )
                for axis, profile in way.items()
            },
            packets,
        )

    load = build_records(room)
    if isinstance(packets, arrays.SlowArrayTransfer):
        load_s = _UploadTime(packets, tick_ns)
        return _limit_upload(load, build_records, room, load_s, model.intervals[1])
    return load


def _common_deceleration(most: float, profile: Profile, brake_s: float) -> float:
    """Return the deceleration of an axis that keeps all axes of the step on their common path when they are stopped
    together."""
    return min(most, profile.peak_velocity / brake_s) if brake_s else most


@dataclass(frozen=True, slots=True)
class _UploadTime:
    """Time that loading a contour takes over a slow line."""

    upload: arrays.SlowArrayTransfer
    tick_ns: float

    def duration_s(self, load: ContourLoad) -> float:
        return self.upload.load_duration_ns(load.array_contents(0.0, self.tick_ns)) * 1e-9


def _limit_upload(
    shortest: ContourLoad,
    records: Callable[[ContourLimits], ContourLoad],
    room: ContourLimits,
    time: _UploadTime,
    longest_interval: int,
) -> ContourLoad:
    """Return the shortest records whose upload is within its time limit, as long as they stay near enough to the
    plan."""
    load, remedy, upload = shortest, "", time.upload
    takes_s = shortest_s = time.duration_s(shortest)
    while takes_s > upload.most_s and load.contour.interval < longest_interval:
        try:
            load = records(replace(room, least_interval=load.contour.interval + 1))
        except Refusal:
            # Longer records cannot represent its speed.
            break
        takes_s = time.duration_s(load)
    sag_counts = max(load.contour.sag_counts.values())
    if takes_s <= upload.most_s:
        if load is shortest or sag_counts <= room.sag_counts:
            return load
        remedy = (
            f"records of {1 << load.contour.interval} samples would take {takes_s:.0f} s and deviate from "
            f"the plan by {sag_counts:.1f} counts between them: raise contour_sag_counts to that; or "
        )
    most_s = upload.most_s / shortest_s * max(profile.duration_s for profile in shortest.profiles.values())
    raise Refusal(
        "upload-too-long",
        f"the {shortest.contour.record_count} records of each of {len(shortest.profiles)} axes would take "
        f"{shortest_s:.0f} s to load over this line, allowed are {upload.most_s:g} s",
        f"{remedy}at most {most_s:.1f} s of motion, or fewer axes, or raise contour_upload_s",
    )


def _make_lowered(
    context: LoweringContext,
    load: MoveLoad,
    profiles: Mapping[str, Profile],
    start: StartOptions,
    mapping: TickMapping,
) -> YaskawaLowered:
    config, motors, options, costs = context.config, context.motors, context.options, context.costs
    tick_ns = mapping.tick_ns
    timings = {axis: load.timing(axis, motors[axis], profile, tick_ns) for axis, profile in profiles.items()}
    loading_ns = load.loading_ns(options, tick_ns)
    moves = tuple(
        YaskawaAxisMove(axis, motors[axis], profile.start_counts, profile.end_counts, timings[axis].samples)
        for axis, profile in profiles.items()
    )
    # An axis at rest is not started; its duration has no meaning.
    mask = sum(1 << move.index for move in moves if move.samples)
    bound_ns = mapping.bound_at_ns(mapping.host_at_ns + start.lead_ns)
    waits = None if start.wait is None else lines.resolve_wait_input(config, start.wait)
    drives = None if start.drive is None else lines.resolve_driven_output(config, start.drive, tick_ns)
    beside_step = _find_behind(context, load, start, tick_ns)
    disarm_ns = _find_disarm_ns(context, start, tick_ns) if beside_step is None else beside_step.disarm_ns
    if waits is None or start.wait is None:
        drives_line = drives is not None or bool(start.triggers)
        terms = lines.clock_terms(bound_ns, options, mapping, start, drives_line=drives_line)
    else:
        terms = lines.wait_terms(start.wait, waits, options, tick_ns)
    begins_at_once = beside_step is not None and beside_step.begins_at_once
    return YaskawaLowered(
        start_class="clock" if waits is None else "line",
        durations_s={axis: timing.length * tick_ns * 1e-9 for axis, timing in timings.items()},
        path_error_counts={axis: timing.error_counts for axis, timing in timings.items()},
        terms=(*terms, AT_ONCE_TERM) if begins_at_once else terms,
        edge=() if drives is None else lines.edge_terms(bound_ns, options, mapping, start, drives),
        tick_ns=tick_ns,
        clock_ppm=mapping.drift_ppm,
        # On a line with slow uploads, sending another T0 takes longer than the advance is worth.
        can_advance=not isinstance(context.packets, arrays.SlowArrayTransfer),
        gap_ns=None if beside_step is None else beside_step.gap_ns,
        release_ns=_find_release_ns(context, start, tick_ns, beside_step),
        costs=costs.model_copy(
            update={
                "arm_ns": costs.arm_ns + loading_ns,
                # Uploads of controllers on one line add up.
                "interleaved": costs.interleaved and not loading_ns,
                "disarm_ns": disarm_ns,
                "stop_ns": math.ceil(max((timing.brake_ns for timing in timings.values()), default=0.0))
                + STOP_EXCHANGES * options.exchange_ns,
            }
        ),
        commands=(
            *load.display,
            *([] if drives is None else [f"XQ #EDGE,3  (waits for T0, then OB{drives.number},{drives.level})"]),
            f"XQ {load.label(mask)},0  "
            f"(waits for {'T0' if waits is None else f'AI {waits.number}'}, then {load.begin_words(mask)})",
        ),
        moves=moves,
        mask=mask,
        load=load,
        waits=waits,
        drives=drives,
        at_once=begins_at_once,
    )


class _Behind(NamedTuple):
    """A step beside the present one: how long after that it begins at the latest, and how long withdrawing takes, ns.
    begins_at_once: it begins at the earliest then, at no sample of its own."""

    gap_ns: int
    disarm_ns: int
    begins_at_once: bool


def _find_behind(context: LoweringContext, load: MoveLoad, start: StartOptions, tick_ns: float) -> _Behind | None:
    """None: the controller cannot hold the step beside the present one."""
    gate = context.gate
    if not start.follows or gate is None or context.geared:
        return None
    if not load.fits_beside or start.wait is not None or start.drive is not None:
        return None
    disarm_ns = math.ceil(gate.follow_before * tick_ns) + context.release_ns
    if context.begins_at_once and start.at_once:
        return _Behind(math.floor(AT_ONCE_TICKS * tick_ns), disarm_ns, begins_at_once=True)
    # T0 of both steps is rounded to a sample.
    gap_ns = math.ceil((gate.gap_ticks(len(context.motors), context.axes, tick_ns) + 1) * tick_ns)
    return _Behind(gap_ns, disarm_ns, begins_at_once=False)


def _find_disarm_ns(context: LoweringContext, start: StartOptions, tick_ns: float) -> int:
    """How long before T0 a step at rest can last be withdrawn. Of one that waits armed: by a stop, which halts a
    program that has passed the gate; verifying that all is unloaded takes longer, and does not matter. The gate
    must be opened before, in the time that the coordinator allows for its answer."""
    gate, options, disarm_ns = context.gate, context.options, context.costs.disarm_ns
    if gate is None or not start.waits_armed or start.wait is not None or start.drive is not None:
        return disarm_ns
    stop_ns = WITHDRAW_EXCHANGES * options.exchange_ns + WITHDRAW_NS
    return min(disarm_ns, max(math.ceil(gate.release_before * tick_ns) - OPENING_NS, stop_ns))


def _find_release_ns(
    context: LoweringContext, start: StartOptions, tick_ns: float, beside_step: _Behind | None
) -> int | None:
    """How long before T0 the gate must be opened; None where a trigger line or outputs depend on T0, or an earlier T0
    takes longer than it is worth. Behind the present step the program is not looked at as often."""
    gate = context.gate
    if beside_step is not None and beside_step.begins_at_once:
        return 0
    if isinstance(context.packets, arrays.SlowArrayTransfer):
        return None
    if gate is None or start.wait is not None or start.drive is not None or start.triggers:
        return None
    spare_ns = RELEASE_SPARE_TICKS * tick_ns
    if beside_step is not None:
        # An earlier T0 is sent before.
        return (
            math.ceil(gate.follow_before * tick_ns + ADVANCE_COMMANDS * gate.command_ns + spare_ns) + context.release_ns
        )
    return math.ceil(gate.release_before * tick_ns + spare_ns)
