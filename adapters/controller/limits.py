"""No command beyond an axis's limits reaches a wire: the checks of profiles against what is and what may be."""

from collections.abc import Mapping

from adapters.contract import CannotDo
from adapters.controller.status import Condition
from orchestrator.model.fleet import Axis
from orchestrator.model.profile import Profile

# Room for the rounding of a plan that uses its limits to the full: quantisation is bounded by lowering itself.
ROOM = 1e-6


def check_profiles(condition: Condition, profiles: Mapping[str, Profile], drives: bool) -> None:
    """Raises `CannotDo` unless every profile starts where its axis stands, may move, and stays inside all limits.

    drives: the controller has a line to drive, and so a part in the step without an axis.
    """
    if not profiles and not drives:
        raise CannotDo("no-axes", "the step moves no axis of this controller")
    condition.require_known(profiles)
    condition.require_enabled(profiles)
    reading = condition.online()
    for name, profile in profiles.items():
        axis, now = condition.config.axes[name], reading.axes[name]
        if not condition.referenced[name]:
            raise CannotDo(
                "not-referenced", f"axis {name} is not referenced", f"home it first: a step `do: home` for {name}"
            )
        if now.moving:
            raise CannotDo("moving", f"axis {name} is moving", "wait, or stop it")
        if now.commanded_counts != profile.start_counts:
            raise CannotDo(
                "other-start",
                f"axis {name} stands at {now.commanded_counts} counts; the plan starts at {profile.start_counts}",
                "plan again from where it stands",
            )
        check_limits(name, axis, profile)


def check_limits(name: str, axis: Axis, profile: Profile) -> None:
    """Raises `CannotDo` when `profile` goes beyond soft limits, velocity or acceleration of `axis`."""
    scale = float(axis.scale)
    counts, counts_s = profile.gap
    if counts > 1.0 or counts_s > profile.peak_velocity * 1e-3:
        raise CannotDo(
            "bad-profile", f"axis {name}: the profile ends {counts:g} counts off its end, at {counts_s:g} /s"
        )
    speed, rate = profile.peak_velocity / scale, profile.peak_acceleration / scale
    if speed > axis.limits.velocity * (1 + ROOM):
        raise CannotDo("velocity-limit", f"axis {name}: {speed:g} {axis.unit}/s is above its {axis.limits.velocity:g}")
    if rate > axis.limits.acceleration * (1 + ROOM):
        raise CannotDo(
            "acceleration-limit", f"axis {name}: {rate:g} {axis.unit}/s² is above its {axis.limits.acceleration:g}"
        )
    limits = axis.soft_limits_counts
    if limits is None:
        return
    low, high = profile.extent_counts
    # A start outside may only lead back inside; half a count is the rounding of the way.
    inside = limits[0] - 0.5 <= profile.end_counts <= limits[1] + 0.5
    start_outside = not limits[0] <= profile.start_counts <= limits[1]
    within = (limits[0] - 0.5 <= low and high <= limits[1] + 0.5) or start_outside
    if not (inside and within):
        raise CannotDo(
            "soft-limit",
            f"axis {name}: the move reaches {axis.to_unit(low):g} to {axis.to_unit(high):g} {axis.unit}; soft limits "
            f"are {axis.to_unit(limits[0]):g} to {axis.to_unit(limits[1]):g}",
        )
