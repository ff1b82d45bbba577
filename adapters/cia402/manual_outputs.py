"""Outputs that are switched manually: with the next controlword, or within a stream with a position."""

from adapters.cia402.canopen import objects as o
from adapters.cia402.canopen import states
from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.canopen.objects import point_bit
from adapters.cia402.moves import Cia402Mover
from adapters.cia402.options import Cia402Options
from adapters.cia402.sync.stream import PERIODS_AHEAD, StreamedMove
from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.errors import ControllerFault, Refusal


class ManualOutputs:
    """The outputs of one drive. A step that switches some, or waits for its SYNC, needs all of them."""

    def __init__(self, options: Cia402Options, node: BusDrive, mover: Cia402Mover) -> None:
        self._options = options
        self._node = node
        self._mover = mover

    async def set_output(self, number: int, *, on: bool) -> None:
        """Switch one output and read it back. Raises `Refusal` while a step needs them, `ControllerFault`."""
        node, mover = self._node, self._mover
        if mover.move is not None and (mover.move.lowered.drive or mover.move.lowered.switched.points):
            raise Refusal(
                "busy",
                "a step switches an output, and all outputs are written together",
                "wait for the end of the step",
            )
        if mover.move is not None and mover.move.waits_for_sync:
            raise Refusal(
                "busy", "a set-point waits for its SYNC, and outputs are written with it", "wait for the start"
            )
        bit = point_bit(number)
        node.outputs = node.outputs | bit if on else node.outputs & ~bit
        ride = None if mover.move is None else mover.move.streamed_move
        if ride is not None and node.switches_with_positions:
            await self._switch_in_stream(ride)
        else:
            node.send_control(node.control if ride is not None else node.control & ~states.NEW_SET_POINT)
        held_outputs = await node.sdo.read_value(o.OUTPUTS)
        if held_outputs != node.outputs:
            raise ControllerFault(
                "not-switched",
                f"{node.name} contains {held_outputs:#010x} in {o.OUTPUTS}, and was given {node.outputs:#010x}",
                "has the drive this output? Is another master on the bus?",
            )

    async def _switch_in_stream(self, ride: StreamedMove) -> None:
        """Switch outputs with a position that is not sent yet, and wait for its SYNC."""
        node, mover = self._node, self._mover
        number = ride.change_outputs(node.outputs)
        latest_ns = node.clock.now_ns() + 2 * PERIODS_AHEAD * self._options.period_ms * NS_PER_MS + node.answer_ns
        await node.wait_until(lambda: ride.edges.written >= number or mover.move is None, latest_ns)
