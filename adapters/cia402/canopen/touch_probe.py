"""The touch probes of a drive: inputs that capture its position in hardware (CiA 402-2, objects 60B8h to 60BDh)."""

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass

from adapters.cia402.canopen import objects as o
from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.canopen.objects import DictionaryObject, point_bit
from adapters.cia402.canopen.sdo import SdoAborted, bus_off_fault
from adapters.cia402.canopen.words import NOT_THERE
from adapters.contract import HostInterval, LatchedPosition
from orchestrator.clock.base import NS_PER_MS
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import DigitalInput
from orchestrator.model.numbers import format_ns

LOOK_NS = 20 * NS_PER_MS
_BYTE = 0xFF
_ON = 0x01
_POSITIVE_EDGE, _NEGATIVE_EDGE = 0x10, 0x20
_POSITIVE_STORED, _NEGATIVE_STORED = 0x02, 0x04


@dataclass(frozen=True, slots=True)
class ProbeEdge:
    """An edge at one of the two touch probes. asked: its function in 60B8h, on, first edge only, by the input; stored:
    its bit of 60B9h; mask: the bits of this probe in both."""

    number: int
    asked: int
    stored: int
    position: DictionaryObject

    @property
    def mask(self) -> int:
        return _BYTE << self._shift

    @property
    def on(self) -> int:
        """The bit of 60B9h that the probe is switched on."""
        return _ON << self._shift

    @property
    def _shift(self) -> int:
        return 8 * (self.number - 1)


def find_edge(point: DigitalInput, inputs: tuple[int, ...]) -> ProbeEdge:
    """The edge at which an input becomes active. inputs: the numbers of those that are touch probe 1 and 2. Raises
    `Refusal`."""
    if point.number not in inputs:
        known_inputs = " and ".join(f"input {number}" for number in inputs) or "none"
        raise Refusal(
            "latch-input",
            f"input {point.number} is no touch probe of this drive: {known_inputs}",
            "connect the signal to one of these, or correct `options.probe_inputs` by the drive's manual",
        )
    number = inputs.index(point.number) + 1
    rises, shift = point.active == "high", 8 * (number - 1)
    order_bits = (_ON | (_POSITIVE_EDGE if rises else _NEGATIVE_EDGE)) << shift
    stored_bits = (_POSITIVE_STORED if rises else _NEGATIVE_STORED) << shift
    return ProbeEdge(number, order_bits, stored_bits, o.PROBE_POSITIONS[number - 1][0 if rises else 1])


class TouchProbe:
    """One edge of one touch probe, taken once. axis: its name in the fleet file."""

    def __init__(self, node: BusDrive, axis: str, edge: ProbeEdge) -> None:
        self._node = node
        self._axis = axis
        self._edge = edge

    async def take(self, point: DigitalInput, within_ns: int) -> LatchedPosition:
        """Switch the probe on, wait until it has captured a position, and switch it off. Raises `Refusal`,
        `ControllerFault`."""
        node, stops = self._node, self._node.stops
        await self.require_passive(point)
        until_ns = node.clock.now_ns() + within_ns
        async with self.switched_on():
            return await self._wait(node.clock.now_ns(), until_ns, within_ns, stops)

    async def require_passive(self, point: DigitalInput) -> None:
        """Raise `Refusal` if the input has the level of its edge already."""
        if bool(await self._node.sdo.read_value(o.INPUTS) & point_bit(point.number)) == (point.active == "high"):
            raise Refusal("line-level", f"input {point.number} is active already", "make it passive before the step")

    @asynccontextmanager
    async def switched_on(self) -> AsyncGenerator[None]:
        """Switch the probe on, with nothing stored, and off at the end. Raises `Refusal`."""
        try:
            await self._switch(0)  # what was stored before goes with that
            await self._switch(self._edge.asked)
            yield
        except SdoAborted as error:
            if error.abort in NOT_THERE:
                text = f"axis {self._axis}: the drive has no touch probe (60B8h)"
                raise Refusal("no-latch", text, "use an axis of another drive") from None
            raise Refusal(
                "latch-input", f"touch probe {self._edge.number}: {error}", "see the drive's manual"
            ) from None
        finally:
            with suppress(ControllerFault, LinkClosed):
                await self._switch(0)

    async def read(self) -> int | None:
        """The position that it has captured; None: none yet. Raises `Refusal` (code `latch-lost`) if it is off."""
        node, edge = self._node, self._edge
        status = await node.sdo.read_value(o.PROBE_STATUS)
        if not status & edge.on:
            raise Refusal(
                "latch-lost",
                f"touch probe {edge.number} of {node.name} is off: the drive has restarted, or another client has "
                "switched it off",
                "see the log; is another master on the bus?",
            )
        return await node.sdo.read_value(edge.position) if status & edge.stored else None

    async def _switch(self, asked: int) -> None:
        """Write the function of this probe; that of the other one stays."""
        word = await self._node.sdo.read_value(o.PROBE_FUNCTION)
        await self._node.sdo.write_value(o.PROBE_FUNCTION, word & ~self._edge.mask | asked)

    async def _wait(self, armed_ns: int, until_ns: int, within_ns: int, stops: int) -> LatchedPosition:
        node, edge = self._node, self._edge
        while True:
            asked_ns = node.clock.now_ns()
            counts = await self.read()
            read_ns = node.clock.now_ns()
            if counts is not None:
                return LatchedPosition(counts, HostInterval(armed_ns, read_ns))
            armed_ns = asked_ns
            if node.stops != stops:
                raise Refusal("stopped", f"a stop came while touch probe {edge.number} was on", "")
            if node.bus.is_off:
                raise bus_off_fault(node.name)
            if read_ns >= until_ns:
                text = f"touch probe {edge.number} has captured nothing within {format_ns(within_ns)}"
                raise Refusal("latch-timeout", text, "check the signal and its wire, or allow more with `timeout`")
            await node.wait_until(lambda: node.stops != stops, min(read_ns + LOOK_NS, until_ns))
