"""The named positions of a fleet: those of its file, and over them those that were saved, which the journal keeps."""

import asyncio
from collections.abc import Callable
from fractions import Fraction
from math import ceil, log10
from typing import Protocol, TypeVar

from orchestrator.bus.base import BusError
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.journal.store import JournalStore
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import MAX_POSITIONS, Axis
from orchestrator.model.fleet_names import explain_position_name
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.positions.entries import (
    PositionEntry,
    PositionRemoved,
    PositionSaved,
    PositionsListed,
    RemovePosition,
    SavedPosition,
    SavePosition,
)
from orchestrator.model.positions.resolve import PositionResolver, explain_value, list_file_positions
from orchestrator.model.state import AxisState, ControllerState
from orchestrator.model.units import Quantity, format_quantity, parse_quantity
from orchestrator.plan.targets import explain_beyond_limits

T = TypeVar("T", covariant=True)

DAMAGED = "its record in the journal is damaged"


class JournalCalls(Protocol):
    """Runs calls of the journal, for the leader alone."""

    async def __call__(self, function: Callable[..., T], /, *values: object) -> T: ...


class PositionBook:
    """The named positions of the fleet of `access`. on_change: called after one was saved or removed."""

    def __init__(self, access: FleetAccess, journal: JournalStore, execute: JournalCalls) -> None:
        self._access = access
        self._journal = journal
        self._execute = execute
        self._saved: dict[str, SavedPosition] = {}
        self._damaged: list[str] = []
        self.on_change: Callable[[], None] = lambda: None

    async def start(self) -> None:
        """Load the saved positions. Raises `JournalError`."""
        saved_positions, self._damaged = await self._execute(self._journal.list_positions)
        self._saved = {position.name: position for position in saved_positions}
        for name in self._damaged:
            self._access.log.warning(f"position {name}: {DAMAGED}")

    def make_resolver(self) -> PositionResolver:
        """A resolver with the values of this moment."""
        return PositionResolver(self._access.view.fleet, self.list_entries())

    def list_entries(self) -> list[PositionEntry]:
        """All named positions, those of the file first; a saved one stands for one of the file with its name."""
        saved_entries = [
            *(self._make_entry(position) for position in self._saved.values()),
            *map(self._make_damaged, self._damaged),
        ]
        names = {entry.name: None for entry in saved_entries}
        return [
            *list_file_positions(self._access.view.fleet, names),
            *sorted(saved_entries, key=lambda entry: entry.name),
        ]

    async def list_positions(self, _: object) -> PositionsListed:
        return PositionsListed(positions=self.list_entries())

    async def save_position(self, request: SavePosition) -> PositionSaved:
        """Save present or given user positions. Raises `Refusal`, `UnknownName`, `JournalError`."""
        fleet, position_before = self._access.view.fleet, self._saved.get(request.name)
        text = explain_position_name(request.name, fleet.names)
        if text is not None:
            raise Refusal("bad-name", text, "choose another name")
        if position_before is None and len(self._saved) >= MAX_POSITIONS:
            raise Refusal("too-many", f"{MAX_POSITIONS} positions are saved; there cannot be more", "remove some")
        given_values = {axis: self._read_given(axis, value) for axis, value in request.values.items()}
        positions = await self._read_present(
            [axis for axis in fleet.expand_names(request.axes) if axis not in given_values]
        )
        if not request.axes and not given_values:
            positions = await self._read_referenced()
        description = (
            position_before.description
            if request.description is None and position_before
            else request.description or ""
        )
        position = SavedPosition(
            name=request.name,
            axes={
                axis: value
                for axis in fleet.axis_names
                if (value := {**positions, **given_values}.get(axis)) is not None
            },
            description=description,
            actor=request.actor,
            utc=self._access.clock.utc(),
        )
        await self._execute(self._journal.store_position, position)
        replaced_entry = None if position_before is None else self._make_entry(position_before)
        self._saved[position.name] = position
        self._note_change(position.name, f"saved by {request.actor}")
        return PositionSaved(position=self._make_entry(position), replaced=replaced_entry)

    async def remove_position(self, request: RemovePosition) -> PositionRemoved:
        """Remove a saved position. Raises `Refusal`, `JournalError`."""
        name, fleet = request.name, self._access.view.fleet
        if name not in self._saved and name not in self._damaged:
            if name in fleet.positions:
                text = f"position {name} is in the fleet file, and none is saved over it"
                raise Refusal("in-file", text, "remove it there, then `tutti fleet reload FILE`")
            raise self.make_resolver().make_unknown(name)
        await self._execute(self._journal.delete_position, name)
        self._saved.pop(name, None)
        self._note_change(name, f"removed by {request.actor}")
        return PositionRemoved(uncovered=next((entry for entry in self.list_entries() if entry.name == name), None))

    def _note_change(self, name: str, what: str) -> None:
        self._damaged = [damaged_name for damaged_name in self._damaged if damaged_name != name]
        self._access.log.info(f"position {name} {what}")
        self.on_change()

    # Entries

    def _make_entry(self, saved: SavedPosition) -> PositionEntry:
        fleet = self._access.view.fleet
        values = [explain_value(fleet, axis, value) for axis, value in saved.axes.items()]
        return PositionEntry(
            **saved.to_plain(),
            source="saved",
            covers_file=saved.name in fleet.positions,
            problems=[text for text in values if text is not None],
        )

    def _make_damaged(self, name: str) -> PositionEntry:
        covers = name in self._access.view.fleet.positions
        return PositionEntry(name=name, axes={}, source="saved", covers_file=covers, problems=[DAMAGED])

    # Values

    def _read_given(self, axis: str, value: Quantity) -> str:
        """A given user position with its unit. Raises `Refusal`, `UnknownName`."""
        config, state_now = self._access.view.fleet.axis(axis), self._access.view.axis_now(axis)
        text = explain_value(self._access.view.fleet, axis, value)
        if text is not None:
            raise Refusal("bad-unit", text, "correct the unit", controller_of(axis))
        offset = state_now.offset if state_now is not None else Fraction(0)
        # On an axis that wraps, a position exists once in each turn.
        motor = parse_quantity(value, config.unit) - offset
        beyond_limits = None if config.turn_length is not None else explain_beyond_limits(axis, config, motor, offset)
        if beyond_limits is not None:
            raise Refusal("soft-limit", beyond_limits, "give another value", controller_of(axis))
        return format_quantity(value, config.unit)

    async def _read_present(self, axes: list[str]) -> dict[str, str]:
        """The present user positions of axes that stand and are referenced. Raises `Refusal`."""
        states = await self._query_states({controller_of(axis) for axis in axes})
        positions: dict[str, str] = {}
        for axis in axes:
            controller, name = split_name(axis)
            state = states[controller]
            if state is None or state.mode == "offline":
                text = f"the position of {axis} is not known: {controller} is {'offline' if state else 'absent'}"
                raise Refusal("offline", text, "see `tutti status`; or give a value: `--at`", controller)
            positions[axis] = self._read_axis(axis, state.axes[name])
        return positions

    async def _read_referenced(self) -> dict[str, str]:
        """The present user positions of all axes that are referenced. Raises `Refusal`."""
        fleet = self._access.view.fleet
        states: dict[str, AxisState] = {}
        for controller, state in (await self._query_states(set(fleet.controllers))).items():
            axes = state.axes.items() if state is not None and state.mode != "offline" else ()
            states |= {f"{controller}.{name}": state_now for name, state_now in axes if state_now.referenced}
        if not states:
            raise Refusal("not-referenced", "no axis of the fleet is referenced", "home them before: `tutti axis home`")
        return {axis: self._read_axis(axis, state_now) for axis, state_now in states.items()}

    def _read_axis(self, axis: str, now: AxisState) -> str:
        controller = controller_of(axis)
        if now.moving or now.homing:
            raise Refusal("moving", f"axis {axis} moves", "save it when the axis is at rest", controller)
        if not now.referenced:
            remedy = f"home it before: `tutti axis home {axis}`; or give a value: `--at`"
            raise Refusal("not-referenced", f"axis {axis} is not referenced", remedy, controller)
        return format_position(self._access.view.fleet.axis(axis), now.position)

    async def _query_states(self, controllers: set[str]) -> dict[str, ControllerState | None]:
        """The states of controllers now; None for one that does not answer."""

        async def query_state(controller: str) -> ControllerState | None:
            try:
                return await self._access.view.query_state(controller)
            except BusError:
                return None

        names = [name for name in self._access.view.fleet.controllers if name in controllers]
        return dict(zip(names, await asyncio.gather(*map(query_state, names)), strict=True))


def format_position(axis: Axis, position: float) -> str:
    """A position with its unit, to a hundredth of a count."""
    digits = max(0, ceil(log10(abs(axis.counts_per_unit))) + 2)
    text = f"{position:.{digits}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return f"{'0' if text == '-0' else text} {axis.unit}"
