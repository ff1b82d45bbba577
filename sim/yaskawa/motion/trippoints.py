"""Trippoints: the conditions that a program line waits for (L2379-L3063, L7381-L7677, L11712-L11837)."""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, inf
from typing import Protocol

from sim.yaskawa.base.world import PhysicalEnvironment
from sim.yaskawa.motion.axis import ServoAxis
from sim.yaskawa.motion.control import MotionControl
from sim.yaskawa.motion.profile import first_sample
from sim.yaskawa.motion.sequence import CoordinateSystem


class EventRaiser(Protocol):
    """Starts automatic routines."""

    def raise_event(self, name: str) -> bool:
        """Jump thread 0 to an automatic routine; return False when there is none, or it cannot run."""
        ...


class TripMachine(Protocol):
    """The machine as a trippoint sees it."""

    @property
    def motion(self) -> MotionControl: ...

    @property
    def environment(self) -> PhysicalEnvironment: ...

    @property
    def programs(self) -> EventRaiser: ...


Check = Callable[[TripMachine, int], bool]


@dataclass(slots=True)
class TripPoint:
    """A condition that blocks a thread or a port.

    passed(machine, sample): whether it is fulfilled.
    due(machine, sample): the sample of the next check, infinite when only an event can change it.
    """

    passed: Check
    due: Callable[[TripMachine, int], float] = lambda machine, sample: inf


def at_sample(sample: int) -> TripPoint:
    """WT and AT: a sample is reached."""
    return TripPoint(lambda machine, at: at >= sample, lambda machine, at: sample)


def when_passed(passed: Check) -> TripPoint:
    """A condition that changes only with events of motion, inputs or programs."""
    return TripPoint(passed)


def place_reached(axis: ServoAxis, place: float, *, upward: bool, commanded: bool) -> TripPoint:
    """AP, AD, AR, MF, MR: the position passes `place`; or the profile is done, or moves away (L2379)."""
    delay = 0 if commanded else axis.lag

    def has_passed(machine: TripMachine, now: int) -> bool:
        reference_here = axis.reference_at(now) if commanded else axis.actual_at(now)
        if reference_here >= place if upward else reference_here <= place:
            return True
        if not commanded:
            return False
        if not axis.is_moving and not (axis.gear.is_engaged or axis.mode == "cam"):
            return True
        velocity = axis.command_velocity(now)
        return velocity < 0 if upward else velocity > 0

    def next_check(machine: TripMachine, now: int) -> float:
        profile = axis.profile
        if profile is None or axis.gear.on:
            return now + 1 if machine.motion.is_active() else inf
        if axis.frozen is not None and not commanded:
            return inf
        return max(first_sample(profile, now - delay, place, upward=upward) + delay, now + 1)

    return TripPoint(has_passed, next_check)


def at_speed(axes: list[ServoAxis], systems: list[CoordinateSystem]) -> TripPoint:
    """AS: the profile has reached its speed, or stopped (L2838)."""

    def is_steady(axis: ServoAxis, now: int) -> bool:
        if not axis.is_moving or axis.profile is None:
            return not axis.is_moving
        return axis.profile.is_steady(now)

    def has_passed(machine: TripMachine, now: int) -> bool:
        return all(is_steady(axis, now) for axis in axes) and all(
            not system.running or system.profile is None or system.profile.is_steady(now) for system in systems
        )

    def next_check(machine: TripMachine, now: int) -> float:
        profiles = [axis.profile for axis in axes if axis.is_moving and axis.profile is not None]
        profiles += [system.profile for system in systems if system.running and system.profile is not None]
        times = [ceil(time) for profile in profiles for time in profile.break_times(now)[:1] if time != inf]
        return max(min(times), now + 1) if times else inf

    return TripPoint(has_passed, next_check)


def path_reached(system: CoordinateSystem, distance: float) -> TripPoint:
    """AV: path distance (L3010)."""

    def has_passed(machine: TripMachine, now: int) -> bool:
        if not system.running or system.travelled_distance(now) >= distance - 1e-6:
            system.mark = distance
            return True
        return False

    def next_check(machine: TripMachine, now: int) -> float:
        if system.profile is None:
            return inf
        return max(first_sample(system.profile, now, distance + 0.5, upward=True), now + 1)

    return TripPoint(has_passed, next_check)


def _pulses_done(axis: ServoAxis) -> int:
    """Return when the last pulse of a stepper is output (L14131)."""
    profile = axis.profile
    return int(profile.last_sample()) + axis.pulse_delay if profile is not None and profile.end != inf else 0


def _profile_end(axis: ServoAxis, started: int) -> int:
    """Return the end of the profile, not before the wait began."""
    return max(started, int(axis.profile.last_sample()) if axis.profile is not None else started)


def _is_completing(axis: ServoAxis, started: int, now: int) -> bool:
    """Return whether MC still waits for an axis."""
    if axis.is_moving:
        return True
    if axis.is_stepper:
        return now < _pulses_done(axis)
    if axis.actual_at(now) == axis.reference_at(now):
        return False
    limit = axis.registers["TW"] >> 16
    return limit < 0 or now < _profile_end(axis, started) + limit


def motion_complete(axes: list[ServoAxis], started: int) -> TripPoint:
    """MC: profile done and encoder in position (a stepper: all pulses output), or the TW timeout with stop code 99
    (L7381)."""

    def has_passed(machine: TripMachine, now: int) -> bool:
        if any(_is_completing(axis, started, now) for axis in axes):
            return False
        late = [axis for axis in axes if axis.actual_at(now) != axis.reference_at(now)]
        for axis in late:
            axis.stop_code = 99
        if late:
            machine.programs.raise_event("MCTIME")
        return True

    def next_check(machine: TripMachine, now: int) -> float:
        if any(axis.is_moving for axis in axes):
            return inf
        pulses = [_pulses_done(axis) for axis in axes if axis.is_stepper and _pulses_done(axis) > now]
        if pulses:
            return max(pulses)
        ends = [
            _profile_end(axis, started) + (axis.registers["TW"] >> 16)
            for axis in axes
            if axis.actual_at(now) != axis.reference_at(now) and axis.registers["TW"] >= 0
        ]
        if not ends:
            return inf
        return min(max(min(ends), now + 1), now + 1 if any(axis.frozen is None for axis in axes) else inf)

    return TripPoint(has_passed, next_check)
