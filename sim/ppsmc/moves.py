"""Motions of one axis: positioning with its closed loop, jogging, oscillation."""

from dataclasses import dataclass, replace

from orchestrator.clock.base import NS_PER_S
from sim.ppsmc.axis import POSITIONING_ERROR, StepperAxis
from sim.ppsmc.legs import MotionLeg, PauseStep, Steps
from sim.ppsmc.machine import StepperHardware
from sim.ppsmc.path import SpeedProfile, constant_path, jog_path, trapezoid_path
from sim.ppsmc.sensors import TravelSwitch, UntilSwitch

_SYSCLK_STEPS = 100
_FIXED_RAMP_S = 0.1


@dataclass(frozen=True, slots=True)
class PositioningStart:
    """Speeds and start of a positioning."""

    profile: SpeedProfile
    at_ns: int | None = None
    """Device time of the start; None: now."""
    ramps: bool = True
    """Without ramps the whole distance is run at the start-stop speed (L3284)."""


def positioning_steps(
    machine: StepperHardware,
    axis: StepperAxis,
    target: int,
    start: PositioningStart,
) -> Steps:
    """Move to `target` steps; then, in closed loop, correct by the encoder (L476-L507, L1058-L1174).

    Before each correction the counter takes the encoder's position, so that a correction appears as motion to the
    target.
    """
    distance, profile = target - axis.steps, start.profile
    path = trapezoid_path(distance, profile) if start.ramps else constant_path(distance, profile.start)
    yield MotionLeg(path, profile, at_ns=start.at_ns)
    settings = axis.settings
    if not settings.ecl or axis.encoder is None:
        return
    wanted_steps = axis.steps_to_distance(target)
    for attempt in range(1, settings.mpr + 1):
        deviation = wanted_steps - machine.measured_position(axis)
        if abs(deviation) <= settings.edev:
            axis.oscillation_error = False
            return
        if attempt == settings.mpr or abs(deviation) > settings.prt:
            break
        yield PauseStep(round(settings.prst * NS_PER_S))
        axis.set_counter(axis.count_steps(machine.measured_position(axis)))
        yield MotionLeg(trapezoid_path(target - axis.steps, profile), profile)
    axis.oscillation_error = True
    axis.error = POSITIONING_ERROR


def jogging_steps(sign: int, profile: SpeedProfile) -> Steps:
    """Move until a stop ends it (L1887, L2706, L2854)."""
    yield MotionLeg(jog_path(sign, profile), profile)


def single_step(axis: StepperAxis, sign: int) -> Steps:
    """One motor step at start-stop speed (L2887)."""
    profile = axis.settings.speed_profile
    yield MotionLeg(constant_path(sign, profile.ramp_speed), profile)


def oscillation_steps(machine: StepperHardware, axis: StepperAxis, amplitude: int) -> Steps:
    """Oscillate about the present position, `amplitude` steps to either side (L2364)."""
    profile = axis.settings.speed_profile
    centre, side = axis.steps, amplitude
    while True:
        yield MotionLeg(trapezoid_path(centre + side - axis.steps, profile), profile)
        if axis.settings.ecl and axis.encoder is not None:
            deviation = abs(axis.steps_to_distance(axis.steps) - machine.measured_position(axis))
            axis.oscillation_error = deviation > axis.settings.edev
        side = -side


def full_step(machine: StepperHardware, axis: StepperAxis, sign: int) -> Steps:
    """Move to the next full-step position (L4865)."""
    pitch = machine.options.full_step_steps
    position = axis.steps - axis.origin
    distance = pitch - position % pitch if sign > 0 else -(position % pitch or pitch)
    profile = axis.settings.speed_profile
    yield MotionLeg(constant_path(distance, profile.ramp_speed), profile)


def clock_check(axis: StepperAxis) -> Steps:
    """Make the small motion that checks the clock (L4896): forth and back."""
    profile = axis.settings.speed_profile
    yield MotionLeg(trapezoid_path(_SYSCLK_STEPS, profile), profile)
    yield MotionLeg(trapezoid_path(-_SYSCLK_STEPS, profile), profile)


def reference_steps(axis: StepperAxis, sign: int, switch: TravelSwitch) -> Steps:
    """ref, org and eref: find the switch at slew speed, return slowly to its edge, take rofs (L1856, L2333, L2572).

    ref and org leave the ORG switch again, then take out the backlash; eref stops where the index reappears.
    """
    settings = axis.settings
    fast = search_profile(axis, settings.speed_profile)
    slow = replace(settings.speed_profile, slew=settings.speed_profile.ramp_speed)
    yield MotionLeg(jog_path(sign, fast), fast, until=UntilSwitch(switch, on=True), soft=True)
    yield MotionLeg(jog_path(-sign, slow), slow, until=UntilSwitch(switch, on=True))
    if switch is TravelSwitch.ORG:
        yield MotionLeg(jog_path(-sign, slow), slow, until=UntilSwitch(switch, on=False))
    axis.set_counter(axis.count_steps(settings.rofs))
    axis.referenced = axis.homed = True
    if switch is TravelSwitch.INDEX:
        axis.index_found = True
        return
    loop = axis.count_steps(settings.blp if sign > 0 else settings.bln)
    yield MotionLeg(trapezoid_path(sign * loop, settings.speed_profile), settings.speed_profile)
    yield MotionLeg(trapezoid_path(-sign * loop, settings.speed_profile), settings.speed_profile)


def search_profile(axis: StepperAxis, profile: SpeedProfile) -> SpeedProfile:
    """Return the profile of a search: with hsdm 0 it ends in a fixed ramp that follows from the slew speed (L937)."""
    if axis.settings.hsdm:
        return profile
    return replace(profile, deceleration=max(profile.slew - profile.ramp_speed, 1.0) / _FIXED_RAMP_S)
