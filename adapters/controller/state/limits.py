"""Limit checks: no command beyond an axis's limits reaches a link. Profiles are checked against the present state and
the allowed ranges."""

from collections.abc import Mapping

from adapters.controller.state.status import ControllerStatus
from orchestrator.model.errors import NOT_REFERENCED, Refusal
from orchestrator.model.fleet import MAX_COUNTS, Axis
from orchestrator.model.profile import Profile

# Tolerance for the rounding of a plan that uses its limits to the full; lowering itself bounds the quantisation.
LIMIT_TOLERANCE = 1e-6


def check_profiles(status: ControllerStatus, profiles: Mapping[str, Profile], *, drives: bool) -> None:
    """Raise `Refusal` unless every profile starts at the position of its axis, the axis may move, and the profile stays
    inside all limits.

    drives: the controller drives a trigger line, or switches outputs on the way, and so takes part in the step without
    an axis.
    """
    if not profiles and not drives:
        raise Refusal("no-axes", "the step moves no axis of this controller")
    status.require_known(profiles)
    status.require_enabled(profiles)
    reading = status.require_online()
    for name, profile in profiles.items():
        axis, axis_reading = status.config.axes[name], reading.axes[name]
        if not status.referenced[name]:
            raise Refusal(
                NOT_REFERENCED, f"axis {name} is not referenced", f"home it first: a step `do: home` for {name}"
            )
        if axis_reading.moving:
            raise Refusal("moving", f"axis {name} is moving", "wait for its end, or stop it")
        if axis_reading.commanded_counts != profile.start_counts:
            raise Refusal(
                "other-start",
                f"axis {name} is at {axis_reading.commanded_counts} counts; the plan starts at {profile.start_counts}",
                "plan again from the present position",
            )
        check_limits(name, axis, profile)
        # A switch that is only inferred may have been released: it stops the next motion itself, and refuses none.
        if not axis_reading.limit_inferred:
            _check_limit_switch(name, axis_reading.limit, profile)


def check_path_limits(status: ControllerStatus, profiles: Mapping[str, Profile]) -> None:
    """Raise `Refusal` when profiles exceed a limit, wherever their axes are now."""
    status.require_known(profiles)
    for name, profile in profiles.items():
        check_limits(name, status.config.axes[name], profile)


def _check_limit_switch(name: str, active: str, profile: Profile) -> None:
    """Raise `Refusal` when the axis is on a limit switch in the direction of motion."""
    low, high = profile.extent_counts
    forward, reverse = high > profile.start_counts + 0.5, low < profile.start_counts - 0.5
    for side, is_wanted in (("forward", forward), ("reverse", reverse)):
        if is_wanted and active in (side, "both"):
            raise Refusal(
                "limit-switch",
                f"axis {name} is on its {side} limit switch, and the move goes in that direction",
                "move it off the switch in the other direction, or check the switch and its cable",
            )


def check_limits(name: str, axis: Axis, profile: Profile) -> None:
    """Raise `Refusal` when `profile` exceeds the soft limits, velocity or acceleration of `axis`."""
    scale = float(axis.scale)
    counts, counts_s = profile.end_error
    if counts > 1.0 or counts_s > profile.peak_velocity * 1e-3:
        raise Refusal(
            "bad-profile",
            f"axis {name}: the profile ends {counts:g} counts away from its target, at {counts_s:g} counts/s",
        )
    speed, rate = profile.peak_velocity / scale, profile.peak_acceleration / scale
    if speed > axis.limits.velocity * (1 + LIMIT_TOLERANCE):
        raise Refusal(
            "velocity-limit", f"axis {name}: {speed:g} {axis.unit}/s exceeds its limit of {axis.limits.velocity:g}"
        )
    if rate > axis.limits.acceleration * (1 + LIMIT_TOLERANCE):
        raise Refusal(
            "acceleration-limit",
            f"axis {name}: {rate:g} {axis.unit}/s² exceeds its limit of {axis.limits.acceleration:g}",
        )
    if axis.rack is not None and not profile.is_still:
        deviation = axis.rack.at_speed(speed, rate)
        if deviation > axis.rack.most * (1 + LIMIT_TOLERANCE):
            raise Refusal(
                "may-rack",
                f"axis {name}: at {speed:g} {axis.unit}/s its motors may be {deviation:g} {axis.unit} apart "
                f"after a fault; its `may_rack` is {axis.rack.most:g}",
            )
    low, high = profile.extent_counts
    if low < -MAX_COUNTS or high >= MAX_COUNTS:
        raise Refusal(
            "position-range",
            f"axis {name}: the move reaches {low:g} to {high:g} counts; positions are below ±{MAX_COUNTS} counts",
            "move the other way; for a rotary axis home it, which begins to count again",
        )
    limits = axis.motor_limits_counts
    if limits is None:
        return
    # A start outside the limits may only lead back inside; half a count allows for rounding along the path.
    ends_inside = limits[0] - 0.5 <= profile.end_counts <= limits[1] + 0.5
    start_outside = not limits[0] <= profile.start_counts <= limits[1]
    stays_within = (limits[0] - 0.5 <= low and high <= limits[1] + 0.5) or start_outside
    if not (ends_inside and stays_within):
        raise Refusal(
            "soft-limit",
            f"axis {name}: the move reaches {axis.to_unit(low):g} to {axis.to_unit(high):g} {axis.unit}; soft limits "
            f"are {axis.to_unit(limits[0]):g} to {axis.to_unit(limits[1]):g}",
        )
