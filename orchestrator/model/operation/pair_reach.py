"""How far apart one fault may leave two axes that carry one beam."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

from orchestrator.model.fleet import Fleet
from orchestrator.model.names import controller_of
from orchestrator.model.units import Unit, convert_units
from orchestrator.model.virtual_maps import Pair

DETECTION_S = 1.0
"""After any fault every member that can be reached has begun to decelerate within this time (invariant 3)."""


@dataclass(frozen=True, slots=True)
class FaultReach:
    """How far the axes of a pair may come apart by one fault, in the pair's unit.

    Before the fault both are within `max_deviation` of square: farther apart they are stopped, whatever the cause is
    (start skew, end skew, path errors, an axis that lags). Let both move at v when the fault occurs. The axis that it
    concerns stops at once in the worst case, without a ramp (its power is lost, its brake closes), and its way is 0
    from then on. The other one goes on at v for a time T, and then by its ramp a, which takes it
    v T + v² / (2 a) farther. So both come apart by at most that, in either direction, and by no more than the rest of
    the way, behind which an axis stands anyhow.

    T is what invariant 3 allows from the fault to the beginning of the ramp, polls, messages and the request to stop
    included (`DETECTION_S`): a drive or its power, a host, the coordinator, an e-stop. A controller whose link is lost
    cannot be stopped, and goes on until its own watchdog stops it (`alone_s`); without one (None), to the end of its
    way. With both, T is the longer one.

    ramp: the smaller acceleration of both axes, unit/s².
    """

    ramp: float
    alone_s: float | None

    def find_growth(self, speed: float, way: float = math.inf) -> float:
        """How far both come apart at `speed` (unit/s), with `way` left."""
        if self.alone_s is None:
            return way if speed else 0.0
        return min(way, speed * max(DETECTION_S, self.alone_s) + speed**2 / (2 * self.ramp))

    def find_speed(self, growth: float) -> float:
        """The highest speed at which both come apart by no more than `growth`, however long the way is."""
        if self.alone_s is None:
            return 0.0
        wait_s = max(DETECTION_S, self.alone_s)
        return self.ramp * (math.sqrt(wait_s**2 + 2 * growth / self.ramp) - wait_s)


def make_fault_reach(fleet: Fleet, pair: Pair, alone: Mapping[str, float | None]) -> FaultReach:
    """The reach of a fault of a pair. alone: for how long controllers go on without their adapters, s; those that are
    not in it have not answered, and count as stopped by then."""
    ramps = [fleet.axis(axis).limits.acceleration * find_size(fleet, axis, pair.unit) for axis in pair.real]
    times_s = [alone.get(controller_of(axis), DETECTION_S) for axis in pair.real]
    known_s = [time_s for time_s in times_s if time_s is not None]
    return FaultReach(min(ramps), max(known_s) if len(known_s) == len(times_s) else None)


def floor_speed(speed: float) -> float:
    """A speed to show: three digits, rounded down so that it still fits."""
    if not speed:
        return 0.0
    digit = 10.0 ** (math.floor(math.log10(speed)) - 2)
    return math.floor(speed * (1 + 1e-12) / digit) * digit


def find_size(fleet: Fleet, axis: str, unit: Unit) -> float:
    """The size of the unit of an axis in `unit`."""
    return float(convert_units(Fraction(1), fleet.axis(axis).unit, unit, axis))
