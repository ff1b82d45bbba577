"""Profiles turned into what the controller executes, and what is promised about it.

The rule, for all axes of a step together, because one begin starts them: independent moves (PA, SP, AC, DC) when the
registers make every trapezoid last as planned to a fifth of a sample, or a little longer where a limit holds it (the
plan follows that), and keep near its path; else a contour. A step of trapezoids that no contour can hold either is
made by the registers all the same, and its durations say how far they are off.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from adapters.contract import CannotDo, Lowered, require_how
from adapters.yaskawa.common import arrays, lines
from adapters.yaskawa.common.contour import Contour, Room, fit_contour, increments, least_interval
from adapters.yaskawa.common.model import RAMP_UNIT, SMC4000, SPEED_UNIT, Model
from adapters.yaskawa.common.options import Options
from adapters.yaskawa.common.program import LOOP_COMMANDS, TAIL, TAIL_LENGTH, array, entry, letters
from adapters.yaskawa.common.registers import exact_ramp
from adapters.yaskawa.common.trapezoid import Bounds, Place, Trapezoid, fit
from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartWay
from orchestrator.model.profile import Profile
from orchestrator.model.state import Costs, StartClass

CLASSES: tuple[StartClass, ...] = ("clock", "line")
STOP_EXCHANGES = 3  # a stop of motion is three commands
CONTOUR_EXCHANGES = 8  # DC, XN, XM, XDT, their reading back and the short array, beyond an independent move's
OFF_SAMPLES = 0.2  # an independent move may last so much longer or shorter than planned
STRETCH = 1e-3  # or longer by this part of it, where a limit holds it: the plan is stretched to it
SKEW_SAMPLES = 10.0  # and be so far from its plan on the way, at its peak speed,
NEAR_COUNTS = 2.0  # or so many counts
LATER_TICKS = 4.0  # an end that all members have in common is later than the plan's by no more
HOST_COMMANDS = 2  # of the host, that may come into one round of the contour's loop: one before each of its lines
LOOP_SPREAD = 2.0  # how much longer a command may take: what expressions add is not stated (L1626)


@dataclass(frozen=True, slots=True)
class AxisMove:
    """One axis's move. index: 0 is X. start, end: absolute commanded positions, counts. samples: from the begin to
    the last commanded position, 0 for an axis that stands still."""

    axis: str
    index: int
    start: int
    end: int
    samples: int


@dataclass(frozen=True, slots=True)
class LoweredMoves(Lowered):
    """What arming needs beyond the contract."""

    moves: tuple[AxisMove, ...]
    mask: int
    load: "Registers | Records"
    waits: lines.Wait | None = None
    drives: lines.Drive | None = None

    @property
    def way(self) -> tuple[AxisMove, ...]:
        """The axes that move."""
        return tuple(move for move in self.moves if move.samples)


@dataclass(frozen=True, slots=True)
class Registers:
    """Independent moves. ends, shapes: by index of the axis."""

    ends: Mapping[int, int]
    shapes: Mapping[int, Trapezoid]

    @property
    def held(self) -> dict[str, dict[int, int]]:
        """By command the values of axes, for reading back."""
        shapes = self.shapes.items()
        return {
            "SP": {index: shape.speed for index, shape in shapes},
            "AC": {index: shape.up for index, shape in shapes},
            "DC": {index: shape.down for index, shape in shapes},
        }

    @property
    def commands(self) -> tuple[str, ...]:
        """What loads them; axes without a way are not touched."""
        if not self.ends:
            return ()
        return tuple(f"{command} {fields(values)}" for command, values in {"PA": self.ends, **self.held}.items())


@dataclass(frozen=True, slots=True)
class Records:
    """A contour. profiles: by index of the axis. brakes: its DC, for a stop. packets: how it is loaded."""

    contour: Contour
    profiles: Mapping[int, Profile]
    ends: Mapping[int, int]
    brakes: Mapping[int, int]
    packets: arrays.Packets = arrays.PACKETS

    @property
    def held(self) -> dict[str, dict[int, int]]:
        """By command the values of axes, for reading back."""
        return {"DC": dict(self.brakes)}

    def arrays(self, phase: float, tick_ns: float) -> dict[str, list[int]]:
        """The arrays' contents for a start `phase` samples after T0, with samples of `tick_ns`."""
        filled = {
            array(index): increments(profile, self.ends[index], self.contour, phase, tick_ns)
            for index, profile in self.profiles.items()
        }
        return filled | ({TAIL: list(self.contour.tail)} if self.contour.tail else {})

    @property
    def variables(self) -> dict[str, int]:
        return {"XN": self.contour.records, "XM": self.contour.count, "XDT": self.contour.interval}

    @property
    def commands(self) -> tuple[str, ...]:
        names = ", ".join(array(index) for index in self.profiles)
        tail = f", then one each of {', '.join(str(1 << n) for n in self.contour.tail)}" if self.contour.tail else ""
        return (
            f"contour: {self.contour.records} records of {1 << self.contour.interval} samples{tail}",
            f"DC {fields(self.brakes)}",
            f"QD {names}: {self.contour.count} increments each",
        )


def fields(values: Mapping[int, int]) -> str:
    """Values by axis index, as the fields of a command: `100,,-5`."""
    return ",".join(str(values[index]) if index in values else "" for index in range(max(values) + 1))


def lower_moves(
    config: Controller,
    motors: Mapping[str, int],
    options: Options,
    costs: Costs,
    profiles: Mapping[str, Profile],
    how: StartWay,
    mapping: TickMapping | None,
    model: Model = SMC4000,
    packets: arrays.Packets = arrays.PACKETS,
) -> LoweredMoves:
    """Pure. motors: index of each axis. Raises `CannotDo` naming the axis and what would fit.

    Where uploads are slow, trapezoids are made by the registers, however far they are off.
    """
    require_how(how, CLASSES, "its own clock is never worse than a command from the host")
    if how.by == "line" and how.wait is None:
        raise CannotDo("start-class", "no line is wired to start it by", "say `wiring` in the fleet file")
    if mapping is None:
        raise CannotDo("no-clock", "the controller's clock is not known yet", "wait a second")
    tick_ns = mapping.tick_ns
    bounds = {
        axis: Bounds(config.axes[axis].limits.velocity * scale, config.axes[axis].limits.acceleration * scale)
        for axis in profiles
        for scale in [float(config.axes[axis].scale)]
    }
    way = {axis: profile for axis, profile in profiles.items() if profile.end_counts != profile.start_counts}
    places = _places(way, mapping, how) if how.exact and how.wait is None else {}
    shapes, why = _by_registers(way, bounds, tick_ns, model, places)
    load: Registers | Records
    note: tuple[str, ...] = ()
    slow = isinstance(packets, arrays.SlowUpload)
    if shapes is not None and (slow or not why):
        load = _registers(shapes, way, motors)
        note = (f"({why})",) if why else ()
    else:
        try:
            load = _by_contour(way, motors, bounds, options, tick_ns, model, packets, how.brake_s)
            note = (f"({why})",) if why else ()
        except CannotDo as refusal:
            if shapes is None:
                raise
            load = _registers(shapes, way, motors)
            note = (f"({why}; no contour: {refusal})",)
    return _promise(config, load, note, profiles, motors, options, costs, how, mapping, packets)


def _by_registers(
    way: Mapping[str, Profile],
    bounds: Mapping[str, Bounds],
    tick_ns: float,
    model: Model,
    places: Mapping[str, Place],
) -> tuple[dict[str, Trapezoid] | None, str]:
    """The trapezoids, None where an axis's profile is none; and why they should rather be a contour, or nothing.

    places: where axes should lie on the samples; where the registers can not do that, as near to the plan as they can.
    """
    try:
        shapes = fit(way, bounds, tick_ns, model, places) if places else {}
        # Where they can not end in their place, as near to the plan as if there were none.
        others = {
            axis: profile
            for axis, profile in way.items()
            if axis not in shapes
            or shapes[axis].samples != places[axis].last
            or not _near(shapes[axis], profile, tick_ns)
        }
        shapes |= fit(others, bounds, tick_ns, model) if others else {}
    except CannotDo as refusal:
        if refusal.refusal.code != "shape":
            raise
        return None, ""
    for axis, profile in others.items():
        shape = shapes[axis]
        if not _suffices(shape, profile, tick_ns):
            return shapes, (
                f"by its registers {axis} ends {shape.off * tick_ns * 1e-6:+.2f} ms off and goes up to "
                f"{shape.path_error_counts:.0f} counts beside its plan"
            )
    return shapes, ""


def _places(way: Mapping[str, Profile], mapping: TickMapping, how: StartWay) -> dict[str, Place]:
    """Each axis at the samples next to where all should begin and end."""
    at = mapping.ticks(mapping.host_at_ns + how.lead_ns)
    phase = round(at) - at
    places: dict[str, Place] = {}
    for axis, profile in way.items():
        ends_ns = profile.duration_s * 1e9
        # An axis that ends before the others has an end of its own.
        ends_ns = how.end_ns if 0.0 <= how.end_ns - ends_ns <= LATER_TICKS * mapping.tick_ns else ends_ns
        places[axis] = Place(phase, round(ends_ns / mapping.tick_ns - phase))
    return places


def _suffices(shape: Trapezoid, profile: Profile, tick_ns: float) -> bool:
    in_time = abs(shape.off) <= OFF_SAMPLES
    held = shape.at_limit and 0.0 < shape.off <= STRETCH * shape.length
    return (in_time or held) and _near(shape, profile, tick_ns)


def _near(shape: Trapezoid, profile: Profile, tick_ns: float) -> bool:
    """Whether it keeps near its plan on the way."""
    peak = profile.peak_velocity * tick_ns * 1e-9
    return shape.path_error_counts <= max(NEAR_COUNTS, SKEW_SAMPLES * peak)


def _registers(shapes: Mapping[str, Trapezoid], way: Mapping[str, Profile], motors: Mapping[str, int]) -> Registers:
    ends = {motors[axis]: profile.end_counts for axis, profile in way.items()}
    return Registers(ends, {motors[axis]: shape for axis, shape in shapes.items()})


def _by_contour(
    way: Mapping[str, Profile],
    motors: Mapping[str, int],
    bounds: Mapping[str, Bounds],
    options: Options,
    tick_ns: float,
    model: Model,
    packets: arrays.Packets,
    brake_s: float,
) -> Records:
    if not model.contours:
        raise CannotDo(
            "order",
            f"axis {next(iter(way))}: the profile is no trapezoid; contours are not played on so many axes",
            "leave `jerk` out of its limits, and move it from standstill to standstill",
        )
    loop_ns = (LOOP_COMMANDS + HOST_COMMANDS + model.turns) * LOOP_SPREAD * options.decode_us * NS_PER_US
    room = Room(
        options.array_elements - TAIL_LENGTH, least_interval(loop_ns, tick_ns, model), options.contour_sag_counts
    )

    def records(within: Room) -> Records:
        contour = fit_contour(way, tick_ns, within, model)
        return Records(
            contour,
            {motors[axis]: profile for axis, profile in way.items()},
            {motors[axis]: contour.ends[axis] for axis in way},
            {
                motors[axis]: exact_ramp(axis, _brake(bounds[axis].acceleration, profile, brake_s), tick_ns * 1e-9)
                for axis, profile in way.items()
            },
            packets,
        )

    load = records(room)
    if isinstance(packets, arrays.SlowUpload):
        return _soon_enough(load, records, room, tick_ns, model, packets)
    return load


def _brake(most: float, profile: Profile, brake_s: float) -> float:
    """The deceleration of an axis with which all axes of the step, stopped together, stay on their common path."""
    return min(most, profile.peak_velocity / brake_s) if brake_s else most


def _soon_enough(
    shortest: Records,
    records: Callable[[Room], Records],
    room: Room,
    tick_ns: float,
    model: Model,
    upload: arrays.SlowUpload,
) -> Records:
    """The shortest records whose upload takes no longer than it may, as far as they keep near enough to the plan."""
    load, remedy = shortest, ""
    takes_s = shortest_s = upload.takes_ns(shortest.arrays(0.0, tick_ns)) * 1e-9
    while takes_s > upload.most_s and load.contour.interval < model.intervals[1]:
        try:
            load = records(replace(room, least_interval=load.contour.interval + 1))
        except CannotDo:
            # Longer records can not hold its speed.
            break
        takes_s = upload.takes_ns(load.arrays(0.0, tick_ns)) * 1e-9
    sag_counts = max(load.contour.sag_counts.values())
    if takes_s <= upload.most_s:
        if load is shortest or sag_counts <= room.sag_counts:
            return load
        remedy = (
            f"records of {1 << load.contour.interval} samples would take {takes_s:.0f} s and leave the plan by "
            f"{sag_counts:.1f} counts between them: raise contour_sag_counts to that; or "
        )
    most_s = upload.most_s / shortest_s * max(profile.duration_s for profile in shortest.profiles.values())
    raise CannotDo(
        "upload-too-long",
        f"the {shortest.contour.count} records of each of {len(shortest.profiles)} axes would take {shortest_s:.0f} s "
        f"to load over this line, allowed are {upload.most_s:g} s",
        f"{remedy}at most {most_s:.1f} s of motion, or fewer axes, or raise contour_upload_s",
    )


def _promise(
    config: Controller,
    load: Registers | Records,
    note: tuple[str, ...],
    profiles: Mapping[str, Profile],
    motors: Mapping[str, int],
    options: Options,
    costs: Costs,
    how: StartWay,
    mapping: TickMapping,
    packets: arrays.Packets,
) -> LoweredMoves:
    tick_ns = mapping.tick_ns
    lengths: dict[str, float] = {}
    samples: dict[str, int] = {}
    errors: dict[str, float] = {}
    brakes_ns = [0.0]
    loading_ns = 0
    for axis, profile in profiles.items():
        index = motors[axis]
        lengths[axis], samples[axis], errors[axis] = 0.0, 0, 0.0
        if isinstance(load, Registers) and index in load.shapes:
            shape = load.shapes[index]
            lengths[axis], samples[axis], errors[axis] = shape.length, shape.samples, shape.path_error_counts
            # A stop brakes with the move's own DC, which a gentle move has set lower than the axis's limit.
            brakes_ns.append(shape.speed / shape.down * RAMP_UNIT / SPEED_UNIT * tick_ns)
        elif isinstance(load, Records) and index in load.ends:
            planned = profile.duration_s * 1e9 / tick_ns
            samples[axis] = load.ends[index]
            # The path is the plan's own; only its last count waits for a record to end.
            lengths[axis] = planned if abs(samples[axis] - planned) <= 1.0 else samples[axis]
            errors[axis] = 1.0 + load.contour.sag_counts[axis]
            brakes_ns.append(profile.peak_velocity * tick_ns / load.brakes[index] * RAMP_UNIT * tick_ns * 1e-9)
    if isinstance(load, Records):
        loading_ns = _loading_ns(load, options, tick_ns)
    moves = tuple(
        AxisMove(axis, motors[axis], profile.start_counts, profile.end_counts, samples[axis])
        for axis, profile in profiles.items()
    )
    # An axis that stands still is not begun; the time it is given has no meaning.
    mask = sum(1 << move.index for move in moves if move.samples)
    bound_ns = mapping.bound_at_ns(mapping.host_at_ns + how.lead_ns)
    waits = None if how.wait is None else lines.wait(config, how.wait)
    drives = None if how.drive is None else lines.drive(config, how.drive, tick_ns)
    contour = isinstance(load, Records)
    begin = f"CD of {letters(mask)}" if contour else f"BG{letters(mask)}"
    return LoweredMoves(
        start_class="clock" if waits is None else "line",
        durations_s={axis: length * tick_ns * 1e-9 for axis, length in lengths.items()},
        path_error_counts=errors,
        terms=lines.clock_terms(bound_ns, options, mapping, how, drives is not None)
        if waits is None or how.wait is None
        else lines.wait_terms(how.wait, waits, options, tick_ns),
        edge=() if drives is None else lines.edge_terms(bound_ns, options, mapping, how),
        tick_ns=tick_ns,
        clock_ppm=mapping.drift_ppm,
        # On a line where uploads are slow, another T0 takes longer to tell than it is sooner.
        sooner=not isinstance(packets, arrays.SlowUpload),
        costs=costs.model_copy(
            update={
                "arm_ns": costs.arm_ns + loading_ns,
                # Uploads add up on their line.
                "by_turns": costs.by_turns and not loading_ns,
                "stop_ns": math.ceil(max(brakes_ns)) + STOP_EXCHANGES * options.exchange_ns,
            }
        ),
        commands=(
            *load.commands,
            *([] if drives is None else [f"XQ #EDGE,3  (waits for T0, then OB{drives.number},{drives.level})"]),
            f"XQ {entry(mask, contour)},0  (waits for {'T0' if waits is None else f'AI {waits.number}'}, then {begin})",
            *note,
        ),
        moves=moves,
        mask=mask,
        load=load,
        waits=waits,
        drives=drives,
    )


def _loading_ns(load: Records, options: Options, tick_ns: float) -> int:
    """How long arming takes beyond an independent move's."""
    if isinstance(load.packets, arrays.SlowUpload):
        return load.packets.takes_ns(load.arrays(0.0, tick_ns)) + CONTOUR_EXCHANGES * load.packets.exchange_ns
    longest_s = tick_ns * 1e-9 * (1 << load.contour.interval)
    digits = [len(str(round(profile.peak_velocity * longest_s) + 2)) for profile in load.profiles.values()]
    return (arrays.exchanges(load.contour.count, digits) + CONTOUR_EXCHANGES) * options.exchange_ns
