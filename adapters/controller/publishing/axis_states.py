"""The states of the axes of one controller, made from its readings."""

from collections.abc import Mapping
from fractions import Fraction
from typing import NamedTuple

from adapters.contract import AxisReading, ControllerReading
from adapters.controller.state.status import ControllerStatus
from orchestrator.model.compensation import Play
from orchestrator.model.fleet import Axis
from orchestrator.model.state import AxisState, PairState

_NONE = Fraction(0)


class _AxisFacts(NamedTuple):
    """What the state of an axis is made of."""

    reading: AxisReading
    offset: Fraction
    play: Play | None
    is_homing: bool
    is_enabled: bool
    is_referenced: bool
    fault: str | None


class AxisStates:
    """Makes the states of axes. Of an axis of which nothing has changed it is the same object: most axes rest, and
    half of the time of a poll at rest would be spent on equal states."""

    def __init__(self, axes: Mapping[str, Axis], status: ControllerStatus) -> None:
        self._axes = axes
        self._status = status
        self._made: dict[str, tuple[_AxisFacts, AxisState]] = {}

    def make_state(self, name: str, reading: ControllerReading | None, offset: Fraction | None) -> AxisState:
        """The state of an axis as of a reading. offset: of its user positions."""
        axis, status = self._axes[name], self._status
        offset = _NONE if offset is None else offset
        if reading is None:
            return _make_unseen(axis, offset, may_move=status.may_move)
        axis_reading = reading.axes[name]
        facts = _AxisFacts(
            reading=axis_reading,
            offset=offset,
            play=status.play.find_play(name),
            is_homing=name in status.homing,
            is_enabled=axis_reading.enabled and name not in status.braked,
            is_referenced=status.referenced[name],
            fault=next((fault.code for fault in reading.faults if fault.axis == name), None),
        )
        entry = self._made.get(name)
        if entry is not None and entry[0] == facts:
            return entry[1]
        state = _make_state(axis, facts)
        self._made[name] = facts, state
        return state


def _make_state(axis: Axis, facts: _AxisFacts) -> AxisState:
    axis_reading, play = facts.reading, facts.play
    ahead_counts = 0.0 if play is None else float(play.middle)
    motor = axis.to_unit(axis_reading.actual_counts + ahead_counts)
    shift = float(facts.offset) if facts.offset else 0.0
    return AxisState(
        position=axis.wrap_position(motor + shift),
        commanded=axis.wrap_position(axis.to_unit(axis_reading.commanded_counts + ahead_counts) + shift),
        velocity=axis.to_length(axis_reading.velocity_counts_s),
        motor_position=motor,
        raw_counts=axis_reading.actual_counts,
        commanded_counts=axis_reading.commanded_counts,
        offset=facts.offset,
        unit=axis.unit,
        moving=axis_reading.moving,
        homing=facts.is_homing,
        enabled=facts.is_enabled,
        referenced=facts.is_referenced,
        limit=axis_reading.limit,
        fault=facts.fault,
        play=play,
        pair=_make_pair(axis, axis_reading),
    )


def _make_pair(axis: Axis, axis_reading: AxisReading) -> PairState | None:
    """The state of the two motors of an axis; None for an axis of one motor."""
    if axis_reading.second is None:
        return None
    first, second = axis.to_unit(axis_reading.actual_counts), axis.to_unit(axis_reading.second.actual_counts)
    return PairState(motors=dict(zip(axis.motors, (first, second), strict=True)), deviation=second - first)


def _make_unseen(axis: Axis, offset: Fraction, *, may_move: bool) -> AxisState:
    """The state of an axis of a controller that is not read."""
    return AxisState(
        position=0.0,
        commanded=0.0,
        velocity=0.0,
        motor_position=0.0,
        raw_counts=0.0,
        commanded_counts=0,
        offset=offset,
        unit=axis.unit,
        moving=may_move,
        enabled=False,
        referenced=False,
    )
