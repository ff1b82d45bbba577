"""Positions and events of the fleet, once or as they come."""

import asyncio
import math
from collections.abc import AsyncGenerator, Iterable, Mapping, Sequence
from contextlib import suppress

from pydantic import ValidationError

from orchestrator.bus.base import BusDeclaration, BusSample
from orchestrator.client.fleet import FleetRequests
from orchestrator.client.states import StateReading, StateStream
from orchestrator.model.base import UnknownName
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import group_by_controller
from orchestrator.model.fleet_names import DefinedNames
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.operation.axis_info import AxisInfo, describe_axis
from orchestrator.model.operation.virtual_state import VirtualState
from orchestrator.model.state import AxisState, ControllerEvent, ControllerState

MAX_WAITING_EVENTS = 10_000  # of a reader that is too slow; the oldest are dropped


class ReadingRequests(FleetRequests):
    """Read axes, and follow them."""

    async def axes(self) -> dict[str, AxisState]:
        """The state of every axis, by `controller.axis`; those of controllers that are offline are old."""
        states = await self.status()
        return {f"{name}.{axis}": axis_now for name, state in states.items() for axis, axis_now in state.axes.items()}

    async def axis(self, name: str) -> AxisInfo:
        """What does not change about `controller.axis` while a program runs: unit, resolution, limits, make. Raises
        `Refusal`: codes `unknown-axis`, and `absent` while its offset is not known."""
        fleet = await self.load_fleet()
        try:
            config = fleet.axis(name)
        except UnknownName as error:
            raise Refusal("unknown-axis", str(error), "see `tutti axis ls`") from None
        axis_now = (await self.axes()).get(name)
        controller = controller_of(name)
        if axis_now is None:
            text = f"{controller}: its adapter does not answer, so that the offset of {name} is not known"
            raise Refusal("absent", text, "is its adapter host running?", controller)
        return describe_axis(name, config, axis_now, await self.controller_info(controller))

    async def position(self, axis: str) -> float:
        """The present position of `controller.axis`, or of a virtual axis, in its unit. Raises `Refusal`: codes
        `unknown-axis`, `offline`."""
        controller, name = split_name(axis)
        states = await self.status()
        if not states:
            raise await self.find_absence()
        if controller not in states and (group := (await self._find_virtual([axis])).get(controller)) is not None:
            if not group.axes:
                raise Refusal("offline", f"{axis}: {group.obstacle}", "check its power and cable")
            return group.axes[name].position
        if controller not in states or name not in states[controller].axes:
            raise _unknown_axis(axis, states)
        if states[controller].mode == "offline":
            raise Refusal("offline", f"{controller} is offline", "check its power and cable", controller)
        return states[controller].axes[name].position

    async def positions(self, axes: Sequence[str] | None = None, hz: float = 10.0) -> AsyncGenerator[dict[str, float]]:
        """The positions of axes (None: of all real ones), in their units, `hz` times a second, until the loop is left.

        For a display: where the axes are now, by the last state of each. What was where at an event is in the report of
        its move (`positions`), in the points of a scan, and in `states`, which have instants. An axis whose controller
        is offline has the position NaN. A position is as old as its poll: the fleet file's `state` says how often.
        Raises `Refusal`: code `unknown-axis`.
        """
        if not 0 < hz <= 1000:
            raise Refusal("bad-rate", f"{hz:g} Hz is not a rate", "choose 0.001 to 1000 Hz")
        states: dict[str, ControllerState] = dict(await self.status())
        wanted_axes = (
            [f"{name}.{axis}" for name, state in states.items() for axis in state.axes] if axes is None else axes
        )
        virtual = await self._find_virtual([axis for axis in wanted_axes if split_name(axis)[0] not in states])
        for axis in wanted_axes:
            controller, name = split_name(axis)
            if controller not in virtual and (controller not in states or name not in states[controller].axes):
                raise _unknown_axis(axis, states)
        subscriptions = await self._follow_states(wanted_axes, states, virtual)
        try:
            while True:
                yield {axis: _find_position(states, virtual, axis) for axis in wanted_axes}
                await asyncio.sleep(1 / hz)
        finally:
            for declaration in subscriptions:
                await declaration.undeclare()

    async def _follow_states(
        self, axes: Sequence[str], states: dict[str, ControllerState], virtual: dict[str, VirtualState]
    ) -> list[BusDeclaration]:
        """Keep the states of the controllers, and of the groups of virtual axes, that `axes` name."""

        def receive_state(sample: BusSample) -> None:
            with suppress(ValidationError):  # not of an adapter
                state = ControllerState.read_message(sample.payload)
                states[state.controller] = state

        def receive_group(sample: BusSample) -> None:
            with suppress(ValidationError):  # not of a coordinator
                group = VirtualState.read_message(sample.payload)
                virtual[group.group] = group

        return [
            await self.bus.subscribe(self.keys.virtual(name), receive_group)
            if name in virtual
            else await self.bus.subscribe(self.keys.state(name), receive_state)
            for name in group_by_controller(axes)
        ]

    async def _find_virtual(self, axes: Sequence[str]) -> dict[str, VirtualState]:
        """The groups of virtual axes that `axes` name, by name. Raises `Refusal` for an axis that a group has not."""
        if not axes:
            return {}
        known_groups = await self.virtual_states()
        groups: dict[str, VirtualState] = {}
        for axis in axes:
            group_name, name = split_name(axis)
            group = known_groups.get(group_name)
            if group is None:
                continue
            if group.axes and name not in group.axes:
                raise _refuse_name(axis, [f"{group_name}.{axis_name}" for axis_name in group.axes])
            groups[group_name] = group
        return groups

    async def states(self, axes: Sequence[str] | None = None) -> AsyncGenerator[StateReading]:
        """Every state of the controllers of axes (None: of all) once, as they come, until the loop is left.

        Each has the interval of fleet time in which its positions were sampled, and UTC; the first ones are those of
        now. A consumer that is 100 states of a controller behind goes on with the newest, which counts what was missed;
        it delays no other. While a controller or the router is away its states pause, and go on by themselves. Raises
        `Refusal`: codes `unknown-axis`, `no-axes`, and `closed` when the connection is closed meanwhile.
        """
        stream = StateStream(_require_axes(axes, (await self.list_names()).axes))
        subscriptions: list[BusDeclaration] = []
        self._close_listeners.add(stream.close)
        try:
            for controller in stream.controllers:
                subscriptions.append(await self.bus.subscribe(self.keys.state(controller), stream.receive_state))
            for state in (await self.status()).values():
                stream.add_state(state)
            while True:
                yield await stream.take_next()
        finally:
            self._close_listeners.discard(stream.close)
            for declaration in subscriptions:
                await declaration.undeclare()

    async def events(self, controller: str | None = None) -> AsyncGenerator[ControllerEvent]:
        """The events of the fleet, or of one controller, as they come: starts, ends, faults, limits, e-stops."""
        async with self.subscribe_samples(self.keys.event(controller)) as samples:
            while True:
                sample = await samples.get()
                while samples.qsize() > MAX_WAITING_EVENTS:
                    sample = samples.get_nowait()
                try:
                    event = ControllerEvent.read_message(sample.payload)
                except ValidationError:
                    continue
                yield event


def _find_position(states: Mapping[str, ControllerState], virtual: Mapping[str, VirtualState], axis: str) -> float:
    controller, name = split_name(axis)
    if controller in virtual:
        group = virtual[controller]
        return group.axes[name].position if name in group.axes else math.nan
    state = states[controller]
    return math.nan if state.mode == "offline" else state.axes[name].position


def _unknown_axis(axis: str, states: dict[str, ControllerState]) -> Refusal:
    return _refuse_name(axis, [f"{name}.{axis_name}" for name, state in states.items() for axis_name in state.axes])


def _refuse_name(axis: str, known_axes: Iterable[str]) -> Refusal:
    text = DefinedNames(axes=list(known_axes)).explain_unknown(axis, "axis")
    return Refusal("unknown-axis", text or f"the fleet has no axis {axis[:80]!r}", "see `tutti axis ls`")


def _require_axes(axes: Sequence[str] | None, known_axes: Iterable[str]) -> list[str]:
    """The axes that are meant, each once. Raises `Refusal`."""
    fleet_axes = list(known_axes)
    axis_names = fleet_axes if axes is None else [axes] if isinstance(axes, str) else list(dict.fromkeys(axes))
    if not axis_names:
        raise Refusal("no-axes", "no axis is named", "name some, or leave `axes` out for all of the fleet")
    for axis in axis_names:
        if axis not in fleet_axes:
            raise _refuse_name(axis, fleet_axes)
    return axis_names
