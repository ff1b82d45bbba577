"""Lowering to a set-point of profile position mode or to a set-point trajectory, and to the instant of the SYNC that
starts it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import ceil

from adapters.cia402.canopen.objects import FOLLOWED, PROFILE_POSITION_MODE, point_bit
from adapters.cia402.costs import full_frame_ns, stream_ns, sync_ns
from adapters.cia402.fleetaxes import POSITION_MAX, axis_bounds, drive_units, needs_stream, only_axis
from adapters.cia402.options import Cia402Options
from adapters.cia402.shapes.course import SetpointTrajectory
from adapters.cia402.shapes.switching import NOTHING_SWITCHED, EdgeGrid, OutputSchedule, SwitchedPoint, SyncPoint
from adapters.cia402.shapes.trapezoid import DriveBounds, DriveTrapezoid, DriveUnits, fit_trapezoid
from adapters.contract import Lowered, ends_too_early, require_start_class
from adapters.toolkit.host_start import ORDER_NS
from adapters.toolkit.path_error import path_error_counts
from adapters.toolkit.wired_points import find_driven_output
from orchestrator.clock.base import NS_PER_MS, NS_PER_US
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import BudgetTerm, ChunkOptions, StartOptions, TriggerDrive, sum_terms
from orchestrator.model.profile import Profile
from orchestrator.model.state import StepCosts

_MOST_LOAD = 0.6  # share of a bus for positions and their answers: the drives' other messages need the rest


@dataclass(frozen=True, slots=True)
class SyncOutput(SyncPoint):
    """An output that is made active by the SYNC of the start, for `active_ns`."""

    active_ns: int


@dataclass(frozen=True, slots=True)
class Cia402Lowered(Lowered):
    """A lowered step with what loading it needs.

    lead_ns: the SYNC is written this long before T0.
    target: None when nothing moves; otherwise shape or trajectory describes the motion.
    chunk: the trajectory is the first chunk of a path.
    mode: of operation.
    switched: outputs that are switched with the positions of the trajectory; among them `drive`, if there is one. grid:
    of triggers."""

    axis: str = ""
    start_counts: int = 0
    target: int | None = None
    shape: DriveTrapezoid | None = None
    trajectory: SetpointTrajectory | None = None
    chunk: ChunkOptions | None = None
    mode: int = PROFILE_POSITION_MODE
    lead_ns: int = 0
    drive: SyncOutput | None = None
    switched: OutputSchedule = NOTHING_SWITCHED
    grid: EdgeGrid = field(default=EdgeGrid())

    @property
    def position_count(self) -> int:
        """Return the number of positions of its stream; the last ones are at rest where outputs are switched later."""
        return 0 if self.trajectory is None else max(self.trajectory.point_count, self.switched.last)

    @property
    def window_ns(self) -> tuple[int, int]:
        """The interval of the start relative to T0, or of the edge where nothing moves."""
        return sum_terms(self.terms or self.edge)


@dataclass(frozen=True, slots=True)
class BusTimes:
    """Properties of the bus that lowering uses.

    start_ns: the common time from SYNC to motion of its drives.
    drives: number of drives on it.
    switching: number of those whose outputs travel with their positions."""

    bitrate: int
    start_ns: int
    drives: int
    switching: int = 0


@dataclass(frozen=True, slots=True)
class ConnectionTraits:
    """Bus and drive of a step. following: the mode in which the drive follows positions; None: it has none.
    equal_ramps: it has one ramp for both."""

    bus: BusTimes
    costs: StepCosts
    following: int | None
    equal_ramps: bool = False


def lower_step(
    config: Controller,
    options: Cia402Options,
    traits: ConnectionTraits,
    profiles: Mapping[str, Profile],
    start: StartOptions,
) -> Cia402Lowered:
    """Lower a step. Raises `Refusal`."""
    bus = traits.bus
    if start.wait is not None or start.start_class == "line":
        raise Refusal(
            "start-class",
            "no start by trigger line: the reaction of a CiA 402 drive to its own inputs is manufacturer-specific",
            "request start class sync",
        )
    require_start_class(
        start, ("sync",), "a CiA 402 drive starts with the SYNC of its bus, and has no clock to start by"
    )
    name, axis = only_axis(config)
    drive = _find_output(config, start.drive)
    profile = profiles.get(name)
    terms = _sync_terms(options, bus)
    resting_step = Cia402Lowered(
        start_class="sync",
        durations_s={} if profile is None else {name: 0.0},
        path_error_counts={} if profile is None else {name: 0.0},
        terms=terms,
        edge=terms if drive is not None else (),
        tick_ns=0.0,
        costs=traits.costs,
        commands=_output_commands(drive),
        clock_ppm=options.clock_ppm,
        axis=name,
        start_counts=0 if profile is None else profile.start_counts,
        lead_ns=sync_ns(bus.bitrate) + bus.start_ns,
        drive=drive,
    )
    if profile is None or (profile.is_still and start.chunk is None):
        return resting_step
    _require_range(name, profile)
    low, high = profile.extent_counts
    # A single count has no path.
    if start.chunk is not None or (any(profile.jerks) and high - low > 1.5):
        return _lower_stream(replace(resting_step, chunk=start.chunk), config, options, traits, profile)
    bounds = replace(axis_bounds(axis), equal_ramps=traits.equal_ramps)
    return _free_start(_lower_set_point(resting_step, bounds, drive_units(options), profile, start), start, bus)


def _free_start(lowered: Cia402Lowered, start: StartOptions, bus: BusTimes) -> Cia402Lowered:
    """A SYNC at another instant is reserved anew; a driven line, and triggers, have theirs from the beginning."""
    if lowered.drive is not None or start.triggers:
        return lowered
    release_ns = lowered.lead_ns + ORDER_NS + full_frame_ns(bus.bitrate)
    return replace(lowered, release_ns=release_ns, can_advance=start.at_once)


def _output_commands(drive: SyncOutput | None) -> tuple[str, ...]:
    if drive is None:
        return ()
    return (f"60FEh bit {drive.bit.bit_length() - 1} {'on' if drive.high else 'off'} with SYNC",)


def _lower_set_point(
    done: Cia402Lowered, bounds: DriveBounds, units: DriveUnits, profile: Profile, start: StartOptions
) -> Cia402Lowered:
    """Lower to a motion by the drive's own profile."""
    shape = _fit_shape(done.axis, bounds, units, profile, start)
    commands = (
        f"607Ah = {profile.end_counts}, 6081h = {shape.velocity}",
        f"6083h = {shape.acceleration}" + ("" if bounds.equal_ramps else f", 6084h = {shape.deceleration}"),
        "6040h = 001Fh with SYNC",
    )
    return replace(
        done,
        durations_s={done.axis: shape.duration_s},
        path_error_counts={done.axis: path_error_counts(profile, shape.motion_legs)},
        commands=commands + done.commands,
        target=profile.end_counts,
        shape=shape,
    )


def _lower_stream(
    done: Cia402Lowered,
    config: Controller,
    options: Cia402Options,
    traits: ConnectionTraits,
    profile: Profile,
) -> Cia402Lowered:
    """Lower to positions that come with SYNC."""
    bus, following = traits.bus, traits.following
    if not needs_stream(config):
        raise Refusal(
            "jerk",
            f"axis {done.axis}: its drive is not set up to follow positions, because its limits contain no `jerk`",
            "add a `jerk` limit to the axis, or plan a trapezoid",
        )
    if following is None:
        raise Refusal(
            "jerk",
            f"axis {done.axis}: the drive has neither cyclic synchronous position mode nor interpolated "
            "position mode (6502h), and its own profiles are trapezoids",
            "remove `jerk` from the axis's limits",
        )
    course = SetpointTrajectory(profile, options.period_ms * NS_PER_MS)
    if done.chunk is not None:
        peaks = done.chunk.peak_accelerations.get(done.axis, 0.0), done.chunk.peak_jerks.get(done.axis, 0.0)
        course = replace(course, is_chunk=True, peak_acceleration=peaks[0], peak_jerk=peaks[1])
    share = stream_ns(bus.bitrate, bus.drives, bus.switching) / course.period_ns
    if share > _MOST_LOAD:
        raise Refusal(
            "bus-load",
            f"positions for {bus.drives} drives every {options.period_ms} ms would take {100 * share:.0f} % of a bus "
            f"of {bus.bitrate} bit/s; allowed are {100 * _MOST_LOAD:.0f} %",
            "set a longer `period_ms` or a higher `bitrate`, or distribute the drives over more buses",
        )
    followed_object = FOLLOWED[following]
    return replace(
        done,
        durations_s={done.axis: course.duration_s},
        path_error_counts={done.axis: course.path_error_counts},
        # This computer's clock sets the timing; the drive's crystal affects only the last period.
        clock_ppm=options.clock_ppm / course.point_count,
        commands=(
            f"6060h = {following}, 60C2h = {options.period_ms} ms",
            f"{followed_object} to {profile.end_counts} in {course.point_count} positions, one with each SYNC",
            *done.commands,
        ),
        target=profile.end_counts,
        trajectory=course,
        mode=following,
        switched=_schedule_line(done, course.period_ns),
    )


def _schedule_line(done: Cia402Lowered, period_ns: int) -> OutputSchedule:
    """Return when the driven trigger line, if there is one, is switched with the positions."""
    drive = done.drive
    if drive is None:
        return NOTHING_SWITCHED
    end = max(1, ceil((done.window_ns[1] + drive.active_ns) / period_ns))
    return OutputSchedule((SwitchedPoint(drive.name, drive.bit, drive.high, (0, end)),))


def _require_range(name: str, profile: Profile) -> None:
    if max(abs(profile.end_counts), abs(profile.start_counts)) > POSITION_MAX:
        raise Refusal(
            "too-far",
            f"axis {name}: a move to {profile.end_counts} counts exceeds {POSITION_MAX}",
            "home the axis, or make the move shorter",
        )


def _sync_terms(options: Cia402Options, bus: BusTimes) -> tuple[BudgetTerm, ...]:
    """Return the terms of the SYNC, which is written so that without any delay it is complete, and has had its usual
    effect, at T0.

    On the bus it has priority over all waiting frames, but not over a frame that is under way.
    """
    off_ns = options.start_us * NS_PER_US - bus.start_ns
    early_ns = min(options.start_spread_us, options.start_us) * NS_PER_US
    shortest_ns = sync_ns(bus.bitrate) // 2  # it may have no stuff bits
    return (
        options.host_term(),
        BudgetTerm(
            name="wire",
            earliest_ns=-shortest_ns,
            latest_ns=options.wire_jitter_us * NS_PER_US + full_frame_ns(bus.bitrate),
        ),
        BudgetTerm(name="tick", earliest_ns=0, latest_ns=options.cycle_us * NS_PER_US),
        BudgetTerm(
            name="firmware",
            earliest_ns=off_ns - early_ns,
            latest_ns=off_ns + options.start_spread_us * NS_PER_US,
        ),
    )


def _find_output(config: Controller, drive: TriggerDrive | None) -> SyncOutput | None:
    if drive is None:
        return None
    point = find_driven_output(config, drive)
    return SyncOutput(drive.output, point_bit(point.number), point.active == "high", drive.active_ns)


def _fit_shape(
    name: str, limits: DriveBounds, units: DriveUnits, profile: Profile, start: StartOptions
) -> DriveTrapezoid:
    way = abs(profile.end_counts - profile.start_counts)
    wanted_s = profile.duration_s
    shape = fit_trapezoid(way, wanted_s, profile.peak_velocity, limits, units)
    if shape is None:
        raise Refusal(
            "limits",
            f"axis {name}: no whole numbers of the drive's units are within {limits.velocity:g} counts/s "
            f"and {limits.acceleration:g} counts/s²",
            "correct `velocity_units` and `acceleration_units`",
        )
    if ends_too_early(shape.duration_s, wanted_s, start):
        raise Refusal(
            "too-slow",
            f"axis {name}: {way} counts in {wanted_s:.6g} s is too slow for the drive in whole units; its "
            f"longest duration is {shape.duration_s:.6g} s",
            f"plan {shape.duration_s:.6g} s or less, or let it end early with `max_end_skew`",
        )
    return shape
