"""Motions of one axis: positioning with its closed loop, jogging, oscillation."""

from dataclasses import replace

from orchestrator.clock.base import NS_PER_S
from sim.ppsmc.axis import POSITIONING_ERROR, Axis
from sim.ppsmc.machine import Machine
from sim.ppsmc.path import Profile, constant, jog, trapezoid
from sim.ppsmc.sensors import Switch, Until
from sim.ppsmc.task import Leg, Pause, Steps

_SYSCLK_STEPS = 100
_FIXED_RAMP_S = 0.1


def positioning(
    machine: Machine, axis: Axis, target: int, profile: Profile, ramps: bool = True, at_ns: int | None = None
) -> Steps:
    """Move to `target` steps; then, in closed loop, correct by the encoder (L476-L507, L1058-L1174).

    Without `ramps` the whole distance is run at the start-stop speed (L3284). Before each correction the counter
    takes the encoder's position, so that a correction shows as motion to the target.
    """
    distance = target - axis.steps
    path = trapezoid(distance, profile) if ramps else constant(distance, profile.start)
    yield Leg(path, profile, at_ns=at_ns)
    settings = axis.settings
    if not settings.ecl or axis.encoder is None:
        return
    wanted = axis.distance(target)
    for attempt in range(1, settings.mpr + 1):
        deviation = wanted - machine.measured(axis)
        if abs(deviation) <= settings.edev:
            axis.oscillation_error = False
            return
        if attempt == settings.mpr or abs(deviation) > settings.prt:
            break
        yield Pause(round(settings.prst * NS_PER_S))
        axis.set_counter(axis.count(machine.measured(axis)))
        yield Leg(trapezoid(target - axis.steps, profile), profile)
    axis.oscillation_error = True
    axis.error = POSITIONING_ERROR


def jogging(sign: int, profile: Profile) -> Steps:
    """Move until something stops it (L1887, L2706, L2854)."""
    yield Leg(jog(sign, profile), profile)


def single_step(axis: Axis, sign: int) -> Steps:
    """One motor step at start-stop speed (L2887)."""
    profile = axis.settings.profile
    yield Leg(constant(sign, profile.low), profile)


def oscillating(machine: Machine, axis: Axis, amplitude: int) -> Steps:
    """To and fro about the present position, `amplitude` steps to either side (L2364)."""
    profile = axis.settings.profile
    centre, side = axis.steps, amplitude
    while True:
        yield Leg(trapezoid(centre + side - axis.steps, profile), profile)
        if axis.settings.ecl and axis.encoder is not None:
            deviation = abs(axis.distance(axis.steps) - machine.measured(axis))
            axis.oscillation_error = deviation > axis.settings.edev
        side = -side


def full_step(machine: Machine, axis: Axis, sign: int) -> Steps:
    """To the next full-step position (L4865)."""
    pitch = machine.options.full_step_steps
    place = axis.steps - axis.origin
    distance = pitch - place % pitch if sign > 0 else -(place % pitch or pitch)
    profile = axis.settings.profile
    yield Leg(constant(distance, profile.low), profile)


def clock_check(axis: Axis) -> Steps:
    """The small motion that the clock is checked with (L4896): forth and back."""
    profile = axis.settings.profile
    yield Leg(trapezoid(_SYSCLK_STEPS, profile), profile)
    yield Leg(trapezoid(-_SYSCLK_STEPS, profile), profile)


def reference(axis: Axis, sign: int, switch: Switch) -> Steps:
    """ref, org and eref: find the switch at slew speed, go back slowly to its edge, take rofs (L1856, L2333, L2572).

    ref and org leave the ORG switch again, then take out the backlash; eref stops where the index reappears.
    """
    settings = axis.settings
    fast = slowing(axis, settings.profile)
    slow = replace(settings.profile, slew=settings.profile.low)
    yield Leg(jog(sign, fast), fast, until=Until(switch, True), soft=True)
    yield Leg(jog(-sign, slow), slow, until=Until(switch, True))
    if switch is Switch.ORG:
        yield Leg(jog(-sign, slow), slow, until=Until(switch, False))
    axis.set_counter(axis.count(settings.rofs))
    axis.referenced = axis.homed = True
    if switch is Switch.INDEX:
        axis.index_found = True
        return
    loop = axis.count(settings.blp if sign > 0 else settings.bln)
    yield Leg(trapezoid(sign * loop, settings.profile), settings.profile)
    yield Leg(trapezoid(-sign * loop, settings.profile), settings.profile)


def slowing(axis: Axis, profile: Profile) -> Profile:
    """The profile of a search: with hsdm 0 it ends in a fixed ramp that follows from the slew speed (L937)."""
    if axis.settings.hsdm:
        return profile
    return replace(profile, deceleration=max(profile.slew - profile.low, 1.0) / _FIXED_RAMP_S)
