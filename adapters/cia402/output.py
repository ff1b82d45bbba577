"""The trigger line that a step drives: active from its SYNC, passive when its time is over or the step ends."""

from contextlib import suppress

from adapters.cia402.canopen import states
from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.interruption import is_interrupted
from adapters.cia402.power import PowerStage
from adapters.cia402.step import DriveStep
from orchestrator.link.base import LinkClosed


class DrivenLine:
    """The trigger line of one drive."""

    def __init__(self, node: BusDrive, power: PowerStage) -> None:
        self._node = node
        self._power = power

    def prepare_edge(self, move: DriveStep) -> int:
        """Return the outputs that the SYNC switches; a stop makes the driven one passive from now on."""
        outputs = self._node.outputs
        if move.driven is not None:
            outputs = move.driven.outputs_with(outputs, active=True)
            self._power.set_driving(driving=True, passive=move.driven.outputs_with(outputs, active=False))
        return outputs

    def keep_active(self, move: DriveStep) -> None:
        """Make the output passive again when its time is over; the SYNC has made it active."""
        drive, node = move.driven, self._node
        assert drive is not None
        node.outputs = drive.outputs_with(node.outputs, active=True)

        def end_active_time() -> None:
            if not move.dropped:
                with suppress(LinkClosed):
                    self.make_passive(move)
                node.wake_waiting()

        move.release = node.clock.call_at_ns(move.t0_ns + move.lowered.window_ns[1] + drive.active_ns, end_active_time)

    def make_passive(self, move: DriveStep) -> None:
        """Make the driven output passive, now and when its time is over."""
        if move.release is not None:
            move.release.cancel()
            move.release = None
        drive, node = move.driven, self._node
        if drive is not None:
            self._power.set_driving(driving=False, passive=0)
            node.outputs = drive.outputs_with(node.outputs, active=False)
            if move.released and node.mapped:
                node.send_control(node.control & ~states.NEW_SET_POINT)

    async def wait_until_passive(self, move: DriveStep) -> None:
        """Wait until the driven trigger line is passive again."""
        node = self._node
        if move.release is not None:
            await node.wait_until(
                lambda: move.release is None or is_interrupted(node, move), node.clock.now_ns() + 2**62
            )
