"""Lowering: a light controller executes the ramps and cruises of a profile as they are, in its own time."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil

from adapters.contract import Lowered, require_start_class
from adapters.light.clock import TICK_NS
from adapters.light.wire import AxisPart
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import BudgetTerm, StartOptions
from orchestrator.model.profile import Profile
from orchestrator.model.state import StepCosts

EXCHANGE_NS = NS_PER_MS  # a request and its reply, beside other work of the process
MOST_LEGS = 255


@dataclass(frozen=True, slots=True)
class LightLowered(Lowered):
    """A lowered step with the parts of its axes that move."""

    parts: tuple[AxisPart, ...] = ()


def axis_index(config: Controller, name: str) -> int:
    """The controller's number of an axis, from 0."""
    return int(config.axes[name].motors[0]) - 1


def full_ramp(config: Controller, name: str) -> float:
    """The ramp of an axis at its limit, counts/s²."""
    axis = config.axes[name]
    return axis.limits.acceleration * float(abs(axis.scale))


def homing_speed(config: Controller, name: str) -> float:
    """The speed of the search for the reference of an axis, counts/s."""
    axis = config.axes[name]
    speed = axis.limits.velocity / 10 if axis.homing.speed is None else axis.homing.speed
    return speed * float(abs(axis.scale))


def make_costs(ramp_s: float) -> StepCosts:
    """Upper bounds for arming, disarming and stopping. ramp_s: of the longest stop."""
    return StepCosts(
        arm_ns=2 * EXCHANGE_NS,
        interleaved=True,
        disarm_ns=2 * EXCHANGE_NS,
        stop_ns=ceil(ramp_s * NS_PER_S) + EXCHANGE_NS,
    )


def lower_profiles(
    config: Controller, profiles: Mapping[str, Profile], start: StartOptions, mapping: TickMapping | None
) -> LightLowered:
    """Lower the part of a controller. Raises `Refusal`."""
    require_start_class(start, ("clock",), "a light controller starts by its own clock")
    if start.drive is not None:
        raise Refusal("start-class", "a light controller drives no trigger line", "use an output of another controller")
    if mapping is None:
        raise Refusal("no-clock", "the controller's clock has not been read yet", "try again in a second")
    factor = mapping.tick_ns / TICK_NS  # host seconds per second of the crystal
    parts = tuple(
        _make_part(config, name, profile, factor, start) for name, profile in profiles.items() if not profile.is_still
    )
    bound_ns = mapping.bound_at_ns(mapping.host_at_ns + start.lead_ns)
    half_tick_ns = ceil(mapping.tick_ns / 2)
    stops_s = [profile.peak_velocity / full_ramp(config, name) for name, profile in profiles.items()]
    return LightLowered(
        start_class="clock",
        durations_s={name: 0.0 if p.is_still else p.duration_s for name, p in profiles.items()},
        path_error_counts={name: 0.0 if p.is_still else 1.0 for name, p in profiles.items()},
        terms=(
            BudgetTerm(name="clock", earliest_ns=-bound_ns, latest_ns=bound_ns),
            BudgetTerm(name="quantisation", earliest_ns=-half_tick_ns, latest_ns=half_tick_ns),
        ),
        tick_ns=mapping.tick_ns,
        costs=make_costs(start.brake_s or max(stops_s, default=0.0)),
        commands=tuple(f"L {part.index + 1}: to {part.end_counts} in {len(part.legs)} legs" for part in parts),
        clock_ppm=mapping.drift_ppm,
        can_advance=True,
        parts=parts,
    )


def _make_part(config: Controller, name: str, profile: Profile, factor: float, start: StartOptions) -> AxisPart:
    """The part of one axis. factor: host seconds per second of the crystal."""
    if any(profile.jerks):
        raise Refusal(
            "jerk", f"axis {name}: a light controller cannot limit jerk", "remove `jerk` from the axis's limits"
        )
    legs = tuple(
        (segment.duration_s / factor, segment.acceleration * factor**2)
        for segment in profile.segments
        if segment.duration_s > 0.0
    )
    if len(legs) > MOST_LEGS:
        text = f"axis {name}: a light controller takes {MOST_LEGS} ramps and cruises, the motion has {len(legs)}"
        raise Refusal("too-long", text, "split it")
    ramp = full_ramp(config, name)
    if start.brake_s:
        ramp = min(ramp, profile.peak_velocity / start.brake_s)
    return AxisPart(
        index=axis_index(config, name),
        start_counts=profile.start_counts,
        end_counts=profile.end_counts,
        ramp=ramp,
        legs=legs,
    )
