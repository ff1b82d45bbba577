"""An object for each axis, with its values as they were read."""

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from typing import Any

from integrations.opcua.reasons import find_axis_reason
from integrations.opcua.types import make_unit, ua
from tutti import StateReading, Tutti, running

SILENT_S = 5.0
"""States are published at least once a second; without one for this long the adapter or the router is away."""
KINDS = {
    **dict.fromkeys(("Position", "Velocity"), ua.VariantType.Double),
    **dict.fromkeys(("Referenced", "Moving"), ua.VariantType.Boolean),
    "Reason": ua.VariantType.String,
}
VALUES = {"Position": 0.0, "Velocity": 0.0, "Referenced": False, "Moving": False, "Reason": ""}


class FinalValue(ua.DataValue):
    """A value that nothing changes. The library makes a deep copy of each value for each subscription, which is most of
    its work; here it keeps the value itself."""

    __slots__ = ()

    def __deepcopy__(self, _: Any) -> "FinalValue":
        return self


class AxisNodes:
    """The objects of all axes, below one folder."""

    def __init__(self, server: Any, own: int) -> None:
        self._server = server
        self._own = own
        self._nodes: dict[str, dict[str, Any]] = {}
        self._written: dict[Any, object] = {}
        self._read_s: dict[str, float] = {}

    async def build(self, parent: Any, units: dict[str, str]) -> None:
        """Add the axes, each with its unit. A value is bad until it is read."""
        folder = await parent.add_folder(self._own, "Axes")
        for axis, unit in units.items():
            node = await folder.add_object(self._own, axis)
            variables = {name: await node.add_variable(self._own, name, value) for name, value in VALUES.items()}
            for name, per in (("Position", ""), ("Velocity", "/s")):
                await variables[name].add_property(0, "EngineeringUnits", make_unit(f"{unit}{per}"))
            self._nodes[axis] = {name: variable.nodeid for name, variable in variables.items()}
            await self._write_absent(axis, "it was not read yet")

    async def show(self, reading: StateReading) -> None:
        """Write a reading; its instant is the source time stamp."""
        now_s = asyncio.get_running_loop().time()
        instant = datetime.fromisoformat(reading.utc)
        for axis, state in reading.axes.items():
            if axis not in self._nodes:
                continue
            self._read_s[axis] = now_s
            if reading.mode == "offline":
                await self._write_absent(axis, find_axis_reason(reading.mode, state))
                continue
            for name, value in (("Position", state.position), ("Velocity", state.velocity)):
                await self._write(axis, name, value, instant)
            await self._write_changed(axis, "Referenced", state.referenced, instant)
            await self._write_changed(axis, "Moving", state.moving, instant)
            await self._write_changed(axis, "Reason", find_axis_reason(reading.mode, state), instant)

    async def drop_silent(self) -> None:
        """Mark the axes of which nothing was read for `SILENT_S`."""
        oldest_s = asyncio.get_running_loop().time() - SILENT_S
        for axis in [axis for axis, read_s in self._read_s.items() if read_s < oldest_s]:
            del self._read_s[axis]
            await self._write_absent(axis, "no state of its controller arrives")

    async def _write_absent(self, axis: str, reason: str) -> None:
        bad = ua.StatusCodes.BadNoCommunication
        for name in VALUES:
            node = self._nodes[axis][name]
            self._written.pop(node, None)
            value = reason if name == "Reason" else VALUES[name]
            status = ua.StatusCodes.Good if name == "Reason" else bad
            data = ua.DataValue(ua.Variant(value), ua.StatusCode(status), datetime.now(UTC))
            await self._server.write_attribute_value(node, data)

    async def _write_changed(self, axis: str, name: str, value: Any, when: datetime) -> None:
        node = self._nodes[axis][name]
        if node not in self._written or self._written[node] != value:
            self._written[node] = value
            await self._write(axis, name, value, when)

    async def _write(self, axis: str, name: str, value: Any, when: datetime) -> None:
        data = FinalValue(ua.Variant(value, KINDS[name]), SourceTimestamp=when)
        await self._server.write_attribute_value(self._nodes[axis][name], data)


@asynccontextmanager
async def follow_axes(tutti: Tutti, nodes: AxisNodes) -> AsyncGenerator[None]:
    """Show the readings of a fleet while the context lasts."""

    async def follow() -> None:
        async for reading in tutti.states():
            await nodes.show(reading)

    async def watch() -> None:
        while True:
            await asyncio.sleep(1.0)
            await nodes.drop_silent()

    async with running(follow()), running(watch()):
        yield
