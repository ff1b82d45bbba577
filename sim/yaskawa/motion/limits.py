"""Limits of travel: limit switches, and the software limits FL and BL (L3180, L5279)."""

from sim.core.controller import LimitSwitch
from sim.yaskawa.base import fixed
from sim.yaskawa.base.world import PhysicalEnvironment
from sim.yaskawa.motion.axis import ServoAxis

NO_FORWARD, NO_REVERSE = 2147483647, -2147483648
"""Software limits that are off."""


class TravelLimits:
    """Limits of the axes of one controller. `now` is the present sample."""

    def __init__(self, environment: PhysicalEnvironment) -> None:
        self.environment = environment

    def is_bounded(self, axis: ServoAxis) -> bool:
        """Return whether any limit can stop the axis."""
        return (
            axis.registers["FL"] != fixed.from_integer(NO_FORWARD)
            or axis.registers["BL"] != fixed.from_integer(NO_REVERSE)
            or axis.name in self.environment.travel
            or self.environment.limits.get(axis.name, "none") != "none"
        )

    def limit_active(self, axis: ServoAxis, now: int, *, forward: bool) -> bool:
        """Return whether the limit switch is pressed."""
        if axis.virtual:
            return False
        pressed_switch: LimitSwitch | None = self.environment.limits.get(axis.name)
        if pressed_switch is not None:
            return pressed_switch in ("both", "forward" if forward else "reverse")
        travel = self.environment.travel.get(axis.name)
        if travel is None:
            return False
        position = axis.physical_at(now + 1)
        return position >= travel[1] if forward else position <= travel[0]

    def is_blocked(self, axis: ServoAxis, now: int, *, forward: bool) -> bool:
        """Return whether a limit switch or a software limit forbids motion in that direction."""
        position = axis.reference_at(now)
        limit = fixed.to_integer(axis.registers["FL" if forward else "BL"])
        return self.limit_active(axis, forward=forward, now=now) or (position > limit if forward else position < limit)

    def limit_thresholds(self, axis: ServoAxis, *, forward: bool) -> list[int]:
        """Return the positions at which limits stop a motion in that direction."""
        limit = fixed.to_integer(axis.registers["FL" if forward else "BL"])
        thresholds = [limit + 1 if forward else limit - 1] if limit != (NO_FORWARD if forward else NO_REVERSE) else []
        travel = self.environment.travel.get(axis.name)
        if travel is not None and axis.name not in self.environment.limits:
            thresholds.append(travel[1 if forward else 0] + axis.physical_zero)
        return thresholds
