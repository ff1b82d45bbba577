"""Switching of the power stage by the state machine of CiA 402, and stops, by ramp and as fast as possible.

A halt brakes with the profile's own deceleration, but the drive would continue to its target when the halt ends. So a
stop is completed: at rest a quick stop follows, which cancels the set-point, and the drive is enabled again.
"""

import asyncio
from contextlib import suppress

from adapters.cia402.canopen import states
from adapters.cia402.canopen.bus import SDO_REQUEST
from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.canopen.objects import CONTROLWORD, FOLLOWED, PROFILE_POSITION_MODE
from adapters.cia402.canopen.sdo import download_request
from adapters.cia402.canopen.setpoint import rest_here
from adapters.cia402.canopen.states import NEXT, DriveState
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.link.base import LinkClosed
from orchestrator.link.can import CanFrame
from orchestrator.model.errors import ControllerFault, Refusal

_SEEN_NS = 10 * NS_PER_MS  # within this time a drive reports that it has begun to brake
_RAMP_NS = 60 * NS_PER_S  # no ramp is longer
_STEPS = 8  # transitions to operation enabled, with reserve


class PowerStage:
    """Power stage and stops of one drive. passive_outputs: 60FEh with all step-driven outputs passive."""

    def __init__(self, node: BusDrive, passive_outputs: int) -> None:
        self._node = node
        self._passive_outputs = passive_outputs
        self._stopping: set[asyncio.Task[None]] = set()

    async def set_enabled(self, *, on: bool) -> None:
        """Enable or disable. Raises `Refusal`, `ControllerFault`."""
        await self.wait_for_stops()
        node = self._node
        if not on:
            node.send_control(states.DISABLE_VOLTAGE)
            if not await node.wait_briefly(
                lambda: node.state in (DriveState.DISABLED, DriveState.NOT_READY, DriveState.FAULT)
            ):
                await node.query_status()
                raise self._stuck_refusal("disable")
            return
        node.require_operational()
        await self._enable_drive()

    async def _enable_drive(self) -> None:
        node = self._node
        stops = node.stops
        if not node.is_enabled and node.wanted_mode in FOLLOWED:
            # In such a mode an enabled drive may move to its last target.
            node.wanted_mode = PROFILE_POSITION_MODE
        for _ in range(_STEPS):
            old_state = node.state
            if old_state is DriveState.ENABLED:
                node.send_control(states.ENABLE)
                return
            if node.stops != stops:
                raise Refusal("stopped", f"a stop came before {node.name} was enabled", "")
            if old_state is DriveState.QUICK_STOP:
                # Not every drive may leave it that way (transition 16).
                node.send_control(states.ENABLE)
                if await node.wait_briefly(lambda: node.state is not DriveState.QUICK_STOP):
                    continue
            node.require_operational()
            order = NEXT.get(old_state)
            if order is None:
                break
            node.send_control(order)
            if not await node.wait_briefly(lambda old_state=old_state: node.state is not old_state):
                break
        if node.state is not DriveState.ENABLED:
            await node.query_status()
            raise self._stuck_refusal("enable")

    def _stuck_refusal(self, what: str) -> Refusal:
        node = self._node
        fault_text = f": {node.fault_text()}" if node.emergencies else ""
        return Refusal(
            "not-switched",
            f"{node.name} cannot be brought to {what}; it stays {node.state.value}{fault_text}",
            "is its enable input on, and its power stage supplied?",
        )

    async def clear_fault(self) -> None:
        """Clear a fault. Raises `Refusal`."""
        await self.wait_for_stops()
        node = self._node
        # A reset is accepted when the drive has come to rest.
        await node.wait_until(lambda: node.state is not DriveState.REACTION, node.clock.now_ns() + _RAMP_NS)
        if node.state is DriveState.FAULT:
            node.send_control(states.DISABLE_VOLTAGE)
            node.send_control(states.FAULT_RESET)
            is_cleared = await node.wait_briefly(lambda: node.state is not DriveState.FAULT)
            node.send_control(states.DISABLE_VOLTAGE)
            if not is_cleared:
                await node.query_status()
                raise Refusal(
                    "fault", f"{node.name} keeps its fault: {node.fault_text()}", "remove its cause, then reset"
                )
        node.emergencies.clear()

    # Stops

    def write_stop(self, *, abort: bool) -> int:
        """Write a stop at once and complete it; return the host time. Raises `LinkClosed`."""
        node = self._node
        node.stops += 1
        node.outputs = self._released()
        if not node.mapped:
            stop_frame = node.control_at_sync(states.QUICK_STOP, self._passive_outputs)
            return node.bus.send_stop(node.number, [stop_frame, quick_stop_by_sdo(node.number)])
        # A halt would enable a disabled drive. A quick stop does not, and stops one whose status was wrong.
        halts = node.state is DriveState.ENABLED and not abort
        at_ns = node.bus.send_stop(
            node.number, node.control_frames(states.ENABLE | states.HALT if halts else states.QUICK_STOP)
        )
        is_moving = node.state in (DriveState.ENABLED, DriveState.QUICK_STOP)
        if is_moving:
            task = asyncio.get_running_loop().create_task(self._complete_stop(node.stops))
            self._stopping.add(task)
            task.add_done_callback(self._stopping.discard)
        node.wake_waiting()
        return at_ns

    def _released(self) -> int:
        return self._passive_outputs if self._driving else self._node.outputs

    _driving = False

    def set_driving(self, passive: int, *, driving: bool) -> None:
        """Set whether a step drives an output. passive: 60FEh to set at a stop."""
        self._driving, self._passive_outputs = driving, passive

    @property
    def is_stopping(self) -> bool:
        """Whether a stop is not completed: the drive has not reported rest."""
        return bool(self._stopping)

    async def wait_for_stops(self) -> None:
        """Wait until every stop has been completed; complete the last one if it was only begun: by an earlier
        connection, or because a wrong status showed a drive at rest, or disabled. What enables the drive next would
        otherwise end the halt, and the drive would continue to its target."""
        while self._stopping:
            await asyncio.gather(*self._stopping, return_exceptions=True)
        if self._node.mapped and self._node.control & states.HALT:
            await self._complete_stop(self._node.stops)

    def cancel_stops(self) -> None:
        for task in self._stopping:
            task.cancel()

    async def _complete_stop(self, stops: int) -> None:
        node = self._node

        def is_resting() -> bool:
            return node.stops != stops or (
                bool(node.status & states.TARGET_REACHED)
                or node.state not in (DriveState.ENABLED, DriveState.QUICK_STOP)
            )

        with suppress(LinkClosed, Refusal, ControllerFault):
            now_ns = node.clock.now_ns()
            await node.wait_until(lambda: node.stops != stops, now_ns + _SEEN_NS)
            await node.wait_until(is_resting, now_ns + _RAMP_NS)
            if node.stops != stops or node.bus.is_off:
                return
            if node.state is DriveState.ENABLED:
                node.send_control(states.QUICK_STOP, PROFILE_POSITION_MODE if node.wanted_mode in FOLLOWED else None)
                await node.wait_briefly(lambda: node.state is not DriveState.ENABLED)
                await node.wait_until(is_resting, now_ns + _RAMP_NS)
            has_ended = node.state is DriveState.DISABLED and node.quick_stop_disables
            if node.stops == stops and (has_ended or node.state is DriveState.QUICK_STOP):
                await self._enable_drive()
            await rest_here(node)


def quick_stop_by_sdo(number: int) -> CanFrame:
    """Return a quick stop for a drive whose PDO mapping is unknown; it never enables."""
    return CanFrame(SDO_REQUEST + number, download_request(CONTROLWORD, states.QUICK_STOP))
