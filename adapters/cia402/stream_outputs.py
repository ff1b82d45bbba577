"""The outputs that a stream switches on the way: what they did, and whether they are passive again."""

from collections.abc import Mapping
from contextlib import suppress

from adapters.cia402.canopen import objects as o
from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.canopen.sdo import SdoAborted
from adapters.cia402.options import Cia402Options
from adapters.cia402.shapes.switching import NOTHING_SWITCHED, OutputSchedule
from adapters.cia402.step import DriveStep
from adapters.cia402.sync.starts import SyncScheduler
from adapters.cia402.sync.stream import StreamedMove
from adapters.cia402.triggers import find_edge_times
from adapters.contract import SwitchedOutput
from orchestrator.model.errors import ControllerFault


class StreamOutputs:
    """The outputs of one drive that travel with the positions of its streams."""

    def __init__(self, options: Cia402Options, sync_scheduler: SyncScheduler, node: BusDrive) -> None:
        self._options = options
        self._sync_scheduler = sync_scheduler
        self._node = node
        self._last_move: StreamedMove | None = None
        """The last stream, for what its outputs did."""
        self.switching = NOTHING_SWITCHED
        """What a stream has switched, until it is certain that it is passive again."""

    def begin(self, ride: StreamedMove, schedule: OutputSchedule) -> None:
        """Record a stream that is about to start, and what it switches."""
        self._last_move, self.switching = ride, schedule

    def forget(self) -> None:
        """Forget what the outputs did in the last stream."""
        self._last_move = None

    async def make_passive(self, move: DriveStep) -> None:
        """Make the outputs passive that a stream switches: by SDO, because the drive may not have been stopped, and be
        in another state than is known, in which a controlword could enable it."""
        node = self._node
        if not move.lowered.switched.points:
            return
        self._sync_scheduler.remove_drive(node.number, move.sync_start)
        with suppress(ControllerFault, SdoAborted):
            node.give_position(node.given)
            await node.sdo.write_value(o.OUTPUTS, node.outputs)
            self.switching = NOTHING_SWITCHED

    def read_edges(self, known: Mapping[str, int]) -> dict[str, SwitchedOutput]:
        """Return what the outputs of the present stream have done behind their first edges, whose numbers are in
        `known`."""
        times = find_edge_times(self._options, self._node.bus.bitrate)
        return {} if self._last_move is None else self._last_move.edges.find_new_edges(times, known)

    def take_edges(self) -> dict[str, SwitchedOutput]:
        """Return what the outputs with triggers did in the last step."""
        times = find_edge_times(self._options, self._node.bus.bitrate)
        return {} if self._last_move is None else self._last_move.edges.find_edges(times)
