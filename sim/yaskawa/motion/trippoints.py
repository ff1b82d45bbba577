"""Trippoints: what a program line waits for (L2379-L3063, L7381-L7677, L11712-L11837)."""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, inf
from typing import TYPE_CHECKING

from sim.yaskawa.motion.axis import Axis
from sim.yaskawa.motion.profile import first_sample

if TYPE_CHECKING:
    from sim.yaskawa.machine import Machine
    from sim.yaskawa.motion.sequence import System

Check = Callable[["Machine", int], bool]


@dataclass(slots=True)
class Trip:
    """A condition that holds a thread or a port.

    passed(machine, sample): whether it is fulfilled. due(machine, sample): the sample at which to look again,
    infinite when only an event can change it.
    """

    passed: Check
    due: Callable[["Machine", int], float] = lambda machine, now: inf


def at_sample(sample: int) -> Trip:
    """WT and AT: a sample is reached."""
    return Trip(lambda machine, now: now >= sample, lambda machine, now: sample)


def when(passed: Check) -> Trip:
    """A condition that changes only with events of motion, inputs or programs."""
    return Trip(passed)


def place_reached(axis: Axis, place: float, upward: bool, *, commanded: bool) -> Trip:
    """AP, AD, AR, MF, MR: the position passes `place`; or the profile is done, or moves away (L2379)."""
    delay = 0 if commanded else axis.lag

    def passed(machine: "Machine", now: int) -> bool:
        here = axis.reference(now) if commanded else axis.actual(now)
        if here >= place if upward else here <= place:
            return True
        if not commanded:
            return False
        if not axis.moving and not (axis.gear.engaged or axis.mode == "cam"):
            return True
        velocity = axis.command_velocity(now)
        return velocity < 0 if upward else velocity > 0

    def due(machine: "Machine", now: int) -> float:
        profile = axis.profile
        if profile is None or axis.gear.on:
            return now + 1 if machine.motion.active() else inf
        if axis.frozen is not None and not commanded:
            return inf
        return max(first_sample(profile, now - delay, place, upward) + delay, now + 1)

    return Trip(passed, due)


def at_speed(axes: list[Axis], systems: "list[System]") -> Trip:
    """AS: the profile has come to its speed, or stopped (L2838)."""

    def steady(axis: Axis, now: int) -> bool:
        if not axis.moving or axis.profile is None:
            return not axis.moving
        return axis.profile.steady(now)

    def passed(machine: "Machine", now: int) -> bool:
        return all(steady(axis, now) for axis in axes) and all(
            not system.running or system.profile is None or system.profile.steady(now) for system in systems
        )

    def due(machine: "Machine", now: int) -> float:
        profiles = [axis.profile for axis in axes if axis.moving and axis.profile is not None]
        profiles += [system.profile for system in systems if system.running and system.profile is not None]
        times = [ceil(time) for profile in profiles for time in profile.breaks(now)[:1] if time != inf]
        return max(min(times), now + 1) if times else inf

    return Trip(passed, due)


def path_reached(system: "System", distance: float) -> Trip:
    """AV: path distance (L3010)."""

    def passed(machine: "Machine", now: int) -> bool:
        if not system.running or system.travelled(now) >= distance - 1e-6:
            system.mark = distance
            return True
        return False

    def due(machine: "Machine", now: int) -> float:
        if system.profile is None:
            return inf
        return max(first_sample(system.profile, now, distance + 0.5, True), now + 1)

    return Trip(passed, due)


def motion_complete(axes: list[Axis], started: int) -> Trip:
    """MC: profile done and encoder there (a stepper: all pulses out), or the TW timeout with stop code 99 (L7381)."""

    def done(axis: Axis) -> int:
        """When the last pulse of a stepper is out (L14131)."""
        profile = axis.profile
        return int(profile.last_sample()) + axis.pulse_delay if profile is not None and profile.end != inf else 0

    def waiting(axis: Axis, now: int) -> bool:
        if axis.moving:
            return True
        if axis.stepper:
            return now < done(axis)
        if axis.actual(now) == axis.reference(now):
            return False
        limit = axis.registers["TW"] >> 16
        ended = max(started, int(axis.profile.last_sample()) if axis.profile is not None else started)
        return limit < 0 or now < ended + limit

    def passed(machine: "Machine", now: int) -> bool:
        if any(waiting(axis, now) for axis in axes):
            return False
        late = [axis for axis in axes if axis.actual(now) != axis.reference(now)]
        for axis in late:
            axis.stop_code = 99
        if late:
            machine.interpreter.raise_event("MCTIME")
        return True

    def due(machine: "Machine", now: int) -> float:
        if any(axis.moving for axis in axes):
            return inf
        pulses = [done(axis) for axis in axes if axis.stepper and done(axis) > now]
        if pulses:
            return max(pulses)
        ends = [
            max(started, int(axis.profile.last_sample()) if axis.profile is not None else started)
            + (axis.registers["TW"] >> 16)
            for axis in axes
            if axis.actual(now) != axis.reference(now) and axis.registers["TW"] >= 0
        ]
        return (
            min(max(min(ends), now + 1), now + 1 if any(axis.frozen is None for axis in axes) else inf) if ends else inf
        )

    return Trip(passed, due)
