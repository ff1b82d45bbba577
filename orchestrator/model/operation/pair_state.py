"""How far the two axes of a pair are apart, at one instant, from readings of two instants."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from pydantic import Field

from orchestrator.model.base import Model
from orchestrator.model.fleet import Fleet
from orchestrator.model.names import split_name
from orchestrator.model.state import ControllerState
from orchestrator.model.virtual_maps import Pair

NS_PER_S = 1_000_000_000


class PairState(Model):
    """How far the axes of a pair are apart now, less `square`, in the pair's unit.

    deviation: the best estimate. low, high: it is between these: the axes are read one after the other, and each has
    moved on meanwhile. known: both are referenced, and none is homing; without that, only its changes mean
    something. max_deviation: of
    the fleet file.
    """

    deviation: float
    low: float
    high: float
    known: bool
    max_deviation: float = Field(gt=0)
    unit: str

    @property
    def is_racked(self) -> bool:
        """Whether the axes are surely farther apart than they may be."""
        return self.known and self.is_beyond(self.max_deviation)

    def is_beyond(self, limit: float, base: float = 0.0) -> bool:
        """Whether the deviation is surely farther than `limit` from `base`."""
        return self.low > base + limit or self.high < base - limit


class AxisReading(NamedTuple):
    """The part of one axis in the deviation of its pair, at its reading. earliest_ns, latest_ns: between which it was
    read. ramp: its acceleration. In the pair's unit and s."""

    position: float
    velocity: float
    earliest_ns: int
    latest_ns: int
    ramp: float


def observe_pair(fleet: Fleet, pair: Pair, states: Mapping[str, ControllerState]) -> PairState | None:
    """The pair by the last states of its controllers; None while one has no reading."""
    virtual_map = fleet.virtual_axes.maps[pair.group]
    readings: list[AxisReading] = []
    is_known = True
    for name, factor in zip(pair.real, virtual_map.find_rows((0.0, 0.0))[1], strict=True):
        controller, axis_name = split_name(name)
        state = states.get(controller)
        if state is None or axis_name not in state.axes or state.read_within is None:
            return None
        axis, ends = state.axes[axis_name], state.read_within
        is_known = is_known and axis.referenced and not axis.homing
        ramp = fleet.axis(name).limits.acceleration * abs(factor)
        readings.append(
            AxisReading(axis.position * factor, axis.velocity * factor, ends.earliest_ns, ends.latest_ns, ramp)
        )
    parts, width = bring_together(readings)
    deviation = parts + virtual_map.observe((0.0, 0.0))[1]
    return PairState(
        deviation=deviation,
        low=deviation - width,
        high=deviation + width,
        known=is_known,
        max_deviation=float(pair.max_deviation),
        unit=pair.unit,
    )


def bring_together(readings: Sequence[AxisReading]) -> tuple[float, float]:
    """The sum of all parts when the last of them was read, and by how much it may be wrong.

    An axis that was read before goes on at its speed v for the time d between both, known to the widths of both
    readings. Its speed may have changed meanwhile: by its ramp a, which is a way of at most a d^2 / 2, and no faster
    than the pair moves, whose axes move alike but for a fault: at most d times the higher speed of all.
    """
    last = max(readings, key=lambda reading: reading.latest_ns)
    fastest = max(abs(reading.velocity) for reading in readings)
    total, error = last.position, 0.0
    for reading in readings:
        if reading is last:
            continue
        shortest_s = (last.earliest_ns - reading.latest_ns) / NS_PER_S
        longest_s = (last.latest_ns - reading.earliest_ns) / NS_PER_S
        total += reading.position + reading.velocity * (shortest_s + longest_s) / 2
        error += fastest * (longest_s - shortest_s) / 2 + min(reading.ramp * longest_s**2 / 2, fastest * longest_s)
    return total, error
