"""States of virtual axes, computed from those of their real axes."""

from collections.abc import Callable, Mapping, Sequence
from typing import Literal

from pydantic import Field

from orchestrator.model.base import Id, Int53, Model
from orchestrator.model.fleet import Fleet
from orchestrator.model.linear_map import CorrectedMap, MapError, Rows
from orchestrator.model.messages import Reply
from orchestrator.model.names import split_name
from orchestrator.model.operation.pair_jog import find_pair_jogs
from orchestrator.model.operation.pair_state import PairState, observe_pair
from orchestrator.model.operation.virtual_jog import TAKE_S, RealJog, VirtualJog, find_jogs
from orchestrator.model.state import AxisState, ControllerState
from orchestrator.model.virtual_maps import VirtualMap

NS_PER_S = 1_000_000_000


class VirtualAxisState(Model):
    """A virtual axis now, in its unit, user positions.

    position: by the last readings of its real axes. low, high: where it was at one instant, when the last of them was
    read: the axes that were read before it may have moved on at their speed. target: where it would be at the commanded
    positions.
    """

    position: float
    low: float
    high: float
    target: float
    velocity: float
    unit: str


class VirtualState(Model):
    """The state of a group of virtual axes: published by the coordinator with each state of its real axes.

    jogs: how its axes are jogged now; without those that cannot be. referenced, enabled: of all its real axes.
    obstacle: why it cannot be moved, with the real axis that is the cause; empty: it can. pair: of a pair, how far its
    axes are apart. Without a state of every
    controller, and outside the domain of its map, it has no axes.
    """

    schema_: Literal["tutti.virtual/1"] = Field(default="tutti.virtual/1", alias="schema")
    group: Id
    of: list[str]
    axes: dict[str, VirtualAxisState]
    jogs: dict[str, VirtualJog] = Field(default={})
    moving: bool
    enabled: bool
    referenced: bool
    obstacle: str
    fleet_ns: Int53 | None
    pair: PairState | None = Field(default=None, exclude_if=lambda pair: pair is None)


class VirtualStates(Reply):
    """The states of all groups of virtual axes, in the order of the fleet file."""

    groups: list[VirtualState] = Field(default=[])


FindRoom = Callable[[str], tuple[float, float] | None]
"""Finds between which motor positions zones allow a real axis to be jogged; None: everywhere."""


def observe_group(
    group: str, fleet: Fleet, states: Mapping[str, ControllerState], find_room: FindRoom = lambda axis: None
) -> VirtualState:
    """The state of a group of virtual axes. states: by controller."""
    virtual_map = fleet.virtual_axes.maps[group]
    units = [fleet.unit_of(name) for name in virtual_map.virtual]
    axes: dict[str, tuple[ControllerState, AxisState]] = {}
    absent_controllers: list[str] = []
    for name in virtual_map.real:
        controller, axis = split_name(name)
        state = states.get(controller)
        if state is None or state.mode == "offline" or axis not in state.axes:
            absent_controllers.append(controller)
        else:
            axes[name] = state, state.axes[axis]
    jogs, pair_state = dict[str, VirtualJog](), None
    observed_axes, obstacle = dict[str, VirtualAxisState](), f"{', '.join(absent_controllers[:1])} is offline"
    if not absent_controllers:
        observed_axes, reason = _observe_inside(virtual_map, units, list(axes.values()))
        obstacle = _find_obstacle(axes) or reason
        jogs = _observe_jogs(group, fleet, axes, find_room)
        pair_state = _observe_pair(group, fleet, states)
    instants = [state.fleet_ns for state, _ in axes.values() if state.fleet_ns is not None]
    return VirtualState(
        group=group,
        of=list(virtual_map.real),
        axes=observed_axes,
        jogs=jogs,
        moving=any(axis.moving for _, axis in axes.values()),
        enabled=not absent_controllers and all(axis.enabled for _, axis in axes.values()),
        referenced=not absent_controllers and all(axis.referenced for _, axis in axes.values()),
        obstacle=_describe_rack(group, fleet, pair_state, obstacle),
        fleet_ns=max(instants, default=None),
        pair=pair_state,
    )


def _observe_pair(group: str, fleet: Fleet, states: Mapping[str, ControllerState]) -> PairState | None:
    """How far the axes of a group are apart, if it is a pair."""
    pair = fleet.virtual_axes.pairs.get(group)
    return None if pair is None else observe_pair(fleet, pair, states)


def _describe_rack(group: str, fleet: Fleet, pair_state: PairState | None, obstacle: str) -> str:
    """That a pair is racked, and what to do, unless there is another obstacle; empty: there is none."""
    if obstacle or pair_state is None or not pair_state.is_racked:
        return obstacle
    pair = fleet.virtual_axes.pairs[group]
    return f"{pair.describe_rack(pair_state.deviation)}; {pair.square_remedy}"


def _find_obstacle(axes: Mapping[str, tuple[ControllerState, AxisState]]) -> str:
    """Why a group cannot be moved, by the first of its real axes that keeps it from it."""
    for name, (state, axis) in axes.items():
        if state.estop is not None:
            return f"{state.controller}: e-stop"
        if state.faults:
            return f"{state.controller}: {state.faults[0].text}"
        if axis.fault is not None:
            return f"{name}: {axis.fault}"
    for name, (_, axis) in axes.items():
        if not axis.referenced:
            return f"{name} is not referenced"
        if not axis.enabled:
            return f"{name} is not enabled"
    return ""


def _find_offset(virtual_map: VirtualMap, axes: Sequence[tuple[ControllerState, AxisState]]) -> str:
    """That a real axis of a corrected group has a user offset, so that its errors are not known there."""
    if not isinstance(virtual_map, CorrectedMap):
        return ""
    pairs = zip(virtual_map.real, axes, strict=True)
    return next(filter(None, (virtual_map.explain_offset(name, axis.offset) for name, (_, axis) in pairs)), "")


def _observe_jogs(
    group: str, fleet: Fleet, axes: Mapping[str, tuple[ControllerState, AxisState]], find_room: FindRoom
) -> dict[str, VirtualJog]:
    """How the virtual axes are jogged; none where the map has no answer."""
    polls_ns = [
        state.read_within.latest_ns - state.read_within.earliest_ns
        for state, _ in axes.values()
        if state.read_within is not None
    ]
    reals = [RealJog(name, fleet.axis(name), axis, find_room(name)) for name, (_, axis) in axes.items()]
    apart_s = TAKE_S + max(polls_ns, default=0) / NS_PER_S
    pair = fleet.virtual_axes.pairs.get(group)
    try:
        if pair is not None:
            return find_pair_jogs(fleet, pair, reals, apart_s)
        return find_jogs(fleet.virtual_axes.maps[group], fleet.virtual[group].axes, reals, apart_s)
    except MapError:
        return {}


def _observe_inside(
    virtual_map: VirtualMap, units: Sequence[str], axes: Sequence[tuple[ControllerState, AxisState]]
) -> tuple[dict[str, VirtualAxisState], str]:
    """The virtual axes, and why they are not known: where the map has no answer, they are left out."""
    try:
        return _observe_axes(virtual_map, units, axes), _find_offset(virtual_map, axes)
    except MapError as error:
        return {}, str(error)


def _observe_axes(
    virtual_map: VirtualMap, units: Sequence[str], axes: Sequence[tuple[ControllerState, AxisState]]
) -> dict[str, VirtualAxisState]:
    """The virtual axes, by their name in the group."""
    positions_read = [axis.position for _, axis in axes]
    targets_read = [axis.commanded for _, axis in axes]
    travels = _find_travels(axes)
    positions, targets = virtual_map.observe(positions_read), virtual_map.observe(targets_read)
    rows = virtual_map.find_rows(positions_read)
    # Where a map is curved, its rows on the way are between the present ones and those where the axes may be by now.
    far_positions = [value + low + high for value, (low, high) in zip(positions_read, travels, strict=True)]
    far_rows = virtual_map.find_rows(far_positions)
    observed_axes: dict[str, VirtualAxisState] = {}
    for number, name in enumerate(virtual_map.virtual):
        low, high = _find_reach((rows[number], far_rows[number]), travels)
        observed_axes[split_name(name)[1]] = VirtualAxisState(
            position=positions[number],
            low=positions[number] + low,
            high=positions[number] + high,
            target=targets[number],
            velocity=sum(factor * axis.velocity for factor, (_, axis) in zip(rows[number], axes, strict=True)),
            unit=units[number],
        )
    return observed_axes


def _find_reach(rows: Rows, travels: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """How far a virtual axis may have moved, lowest and highest. rows: its row at both ends of the travels."""
    low = high = 0.0
    for factors, span in zip(zip(*rows, strict=True), travels, strict=True):
        reaches = [factor * travel for factor in factors for travel in (0.0, *span)]
        low, high = low + min(reaches), high + max(reaches)
    return low, high


def _find_travels(axes: Sequence[tuple[ControllerState, AxisState]]) -> list[tuple[float, float]]:
    """How far each axis may have gone on from its reading until the last one ended, in its unit, (lowest, highest)."""
    intervals = [state.read_within for state, _ in axes]
    ends = [interval.latest_ns for interval in intervals if interval is not None]
    travels: list[tuple[float, float]] = []
    for interval, (_, axis) in zip(intervals, axes, strict=True):
        spread_s = (max(ends) - interval.earliest_ns) / NS_PER_S if interval is not None else 0.0
        travel = axis.velocity * max(spread_s, 0.0)
        travels.append((min(travel, 0.0), max(travel, 0.0)))
    return travels
