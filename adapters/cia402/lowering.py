"""Profiles to a set-point of profile position mode or to a course of positions, and when the SYNC starts it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from adapters.cia402.costs import full_frame_ns, stream_ns, sync_ns
from adapters.cia402.course import Course
from adapters.cia402.fleetaxes import POSITION_MAX, bounds, only_axis, streams, units
from adapters.cia402.objects import FOLLOWED, PROFILE_POSITION_MODE, point_bit
from adapters.cia402.options import Options
from adapters.cia402.shape import Trapezoid, fit
from adapters.contract import CannotDo, Lowered, require_how, too_quick
from adapters.toolkit.path_error import path_error_counts
from adapters.toolkit.wired_points import driven
from orchestrator.clock.base import NS_PER_MS, NS_PER_US
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import LineDrive, StartWay, Term
from orchestrator.model.profile import Profile
from orchestrator.model.state import Costs

_MOST_LOAD = 0.6  # of a bus by positions and their answers: what else the drives say must have room


@dataclass(frozen=True, slots=True)
class Drive:
    """An output that is switched by the SYNC. bit: in 60FEh. high: its level when active."""

    name: str
    bit: int
    high: bool
    hold_ns: int

    def switched(self, outputs: int, *, active: bool) -> int:
        """60FEh with this output active or passive."""
        return outputs | self.bit if active == self.high else outputs & ~self.bit


@dataclass(frozen=True, slots=True)
class CiaLowered(Lowered):
    """What `arm` needs. lead_ns: the SYNC is written so long before T0. target: None when nothing moves; else shape or
    course is how. mode: of operation."""

    axis: str = ""
    start_counts: int = 0
    target: int | None = None
    shape: Trapezoid | None = None
    course: Course | None = None
    mode: int = PROFILE_POSITION_MODE
    lead_ns: int = 0
    drive: Drive | None = None

    @property
    def window_ns(self) -> tuple[int, int]:
        """The start about T0, by all terms together."""
        parts = self.terms or self.edge
        return sum(each.earliest_ns for each in parts), sum(each.latest_ns for each in parts)


@dataclass(frozen=True, slots=True)
class BusTimes:
    """What lowering knows of the bus. start_ns: the usual time from SYNC to motion that its drives have agreed on.
    drives: on it."""

    bitrate: int
    start_ns: int
    drives: int


def lower(
    config: Controller,
    options: Options,
    bus: BusTimes,
    costs: Costs,
    profiles: Mapping[str, Profile],
    how: StartWay,
    following: int | None,
) -> CiaLowered:
    """following: the mode in which the drive follows positions; None: it has none. Raises `CannotDo`."""
    if how.wait is not None or how.by == "line":
        raise CannotDo(
            "start-class",
            "no start by line: what a CiA 402 drive does by an input of its own is its maker's",
            "ask for start class sync",
        )
    require_how(how, ("sync",), "a CiA 402 drive starts with the SYNC of its bus, and has no clock to start by")
    name, _ = only_axis(config)
    drive = _driven(config, how.drive)
    profile = profiles.get(name)
    terms = _terms(options, bus)
    done = CiaLowered(
        start_class="sync",
        durations_s={} if profile is None else {name: 0.0},
        path_error_counts={} if profile is None else {name: 0.0},
        terms=terms,
        edge=terms if drive is not None else (),
        tick_ns=0.0,
        costs=costs,
        commands=_commands(drive),
        clock_ppm=options.clock_ppm,
        axis=name,
        start_counts=0 if profile is None else profile.start_counts,
        lead_ns=sync_ns(bus.bitrate) + bus.start_ns,
        drive=drive,
    )
    if profile is None or profile.end_counts == profile.start_counts:
        return done
    _require_range(name, profile)
    # One count is no path.
    if any(profile.jerks) and abs(profile.end_counts - profile.start_counts) > 1:
        return _streamed(done, config, options, bus, profile, following)
    return _set_point(done, config, options, profile, how)


def _commands(drive: Drive | None) -> tuple[str, ...]:
    if drive is None:
        return ()
    return (f"60FEh bit {drive.bit.bit_length() - 1} {'on' if drive.high else 'off'} with SYNC",)


def _set_point(done: CiaLowered, config: Controller, options: Options, profile: Profile, how: StartWay) -> CiaLowered:
    """Executed by the drive's own profile."""
    shape = _shape(config, options, profile, how)
    commands = (
        f"607Ah = {profile.end_counts}, 6081h = {shape.velocity}",
        f"6083h = {shape.acceleration}, 6084h = {shape.deceleration}",
        "6040h = 001Fh with SYNC",
    )
    return replace(
        done,
        durations_s={done.axis: shape.duration_s},
        path_error_counts={done.axis: path_error_counts(profile, shape.legs)},
        commands=commands + done.commands,
        target=profile.end_counts,
        shape=shape,
    )


def _streamed(
    done: CiaLowered, config: Controller, options: Options, bus: BusTimes, profile: Profile, following: int | None
) -> CiaLowered:
    """Executed as positions that come with SYNC."""
    if not streams(config):
        raise CannotDo(
            "jerk",
            f"axis {done.axis}: its drive is not set up to follow positions, because its limits name no `jerk`",
            "give the axis a limit of `jerk`, or plan a trapezoid",
        )
    if following is None:
        raise CannotDo(
            "jerk",
            f"axis {done.axis}: the drive has neither cyclic synchronous position mode nor interpolated position mode "
            "(6502h), and its own profiles are trapezoids",
            "leave `jerk` out of the axis's limits",
        )
    course = Course(profile, options.period_ms * NS_PER_MS)
    share = stream_ns(bus.bitrate, bus.drives) / course.period_ns
    if share > _MOST_LOAD:
        raise CannotDo(
            "bus-load",
            f"positions for {bus.drives} drives every {options.period_ms} ms would take {100 * share:.0f} % of a bus "
            f"of {bus.bitrate} bit/s; allowed are {100 * _MOST_LOAD:.0f} %",
            "give a longer `period_ms` or a higher `bitrate`, or spread the drives over more buses",
        )
    followed = FOLLOWED[following]
    return replace(
        done,
        durations_s={done.axis: course.duration_s},
        path_error_counts={done.axis: course.path_error_counts},
        # This computer's clock has it in time; the drive's crystal only in the last period.
        clock_ppm=options.clock_ppm / course.count,
        commands=(
            f"6060h = {following}, 60C2h = {options.period_ms} ms",
            f"{followed} to {profile.end_counts} in {course.count} positions, one with each SYNC",
            *done.commands,
        ),
        target=profile.end_counts,
        course=course,
        mode=following,
    )


def _require_range(name: str, profile: Profile) -> None:
    if max(abs(profile.end_counts), abs(profile.start_counts)) > POSITION_MAX:
        raise CannotDo(
            "too-far",
            f"axis {name}: a move to {profile.end_counts} counts is beyond {POSITION_MAX}",
            "home the axis, or make the move shorter",
        )


def _terms(options: Options, bus: BusTimes) -> tuple[Term, ...]:
    """The SYNC is written so that without any delay it is over, and has had its usual effect, at T0.

    On the bus it wins against everything that waits, but not against a frame that is under way.
    """
    off_ns = options.start_us * NS_PER_US - bus.start_ns
    early_ns = min(options.start_spread_us, options.start_us) * NS_PER_US
    shortest_ns = sync_ns(bus.bitrate) // 2  # it may have no stuff bits
    return (
        options.host_term(),
        Term(
            name="wire",
            earliest_ns=-shortest_ns,
            latest_ns=options.wire_jitter_us * NS_PER_US + full_frame_ns(bus.bitrate),
        ),
        Term(name="tick", earliest_ns=0, latest_ns=options.cycle_us * NS_PER_US),
        Term(
            name="firmware",
            earliest_ns=off_ns - early_ns,
            latest_ns=off_ns + options.start_spread_us * NS_PER_US,
        ),
    )


def _driven(config: Controller, drive: LineDrive | None) -> Drive | None:
    if drive is None:
        return None
    point = driven(config, drive)
    return Drive(drive.output, point_bit(point.number), point.active == "high", drive.hold_ns)


def _shape(config: Controller, options: Options, profile: Profile, how: StartWay) -> Trapezoid:
    name, axis = only_axis(config)
    way = abs(profile.end_counts - profile.start_counts)
    wanted_s, limits = profile.duration_s, bounds(axis)
    shape = fit(way, wanted_s, profile.peak_velocity, limits, units(options))
    if shape is None:
        raise CannotDo(
            "limits",
            f"axis {name}: no whole numbers of the drive's units are within {limits.velocity:g} counts/s and "
            f"{limits.acceleration:g} counts/s²",
            "correct `velocity_units` and `acceleration_units`",
        )
    if too_quick(shape.duration_s, wanted_s, how):
        raise CannotDo(
            "too-slow",
            f"axis {name}: {way} counts in {wanted_s:.6g} s is slower than the drive can in whole units; the longest "
            f"that it can take is {shape.duration_s:.6g} s",
            f"plan {shape.duration_s:.6g} s or less, or let it end early with `max_end_skew`",
        )
    return shape
