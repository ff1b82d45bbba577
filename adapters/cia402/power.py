"""The power stage switched on and off by the state machine of CiA 402, and stops, by ramp and as fast as it can.

A halt brakes by the profile's own deceleration, but the drive would go on to its target when the halt is over. So a
stop is seen through: at rest a quick stop follows, which takes the set-point away, and the drive is enabled again.
"""

import asyncio
from contextlib import suppress

from adapters.cia402 import states
from adapters.cia402.bus import SDO_REQUEST
from adapters.cia402.node import Node
from adapters.cia402.objects import CONTROLWORD, FOLLOWED, PROFILE_POSITION_MODE
from adapters.cia402.sdo import download
from adapters.cia402.states import NEXT, State
from adapters.contract import CannotDo, DriverFault
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.link.base import LinkClosed
from orchestrator.link.can import CanFrame

_SEEN_NS = 10 * NS_PER_MS  # in so much a drive says that it has begun to brake
_RAMP_NS = 60 * NS_PER_S  # no ramp is longer
_STEPS = 8  # transitions to operation enabled, with room


class Power:
    """Power stage and stops of one drive. passive_outputs: 60FEh with what steps drive passive."""

    def __init__(self, node: Node, passive_outputs: int) -> None:
        self._node = node
        self._passive_outputs = passive_outputs
        self._stopping: set[asyncio.Task[None]] = set()

    async def switch(self, on: bool) -> None:
        """Enable or disable. Raises `CannotDo`, `DriverFault`."""
        await self.stopped()
        node = self._node
        if not on:
            node.order(states.DISABLE_VOLTAGE)
            if not await node.soon(lambda: node.state in (State.DISABLED, State.NOT_READY, State.FAULT)):
                await node.look()
                raise self._stuck("disable")
            return
        node.require_well()
        await self._enable()

    async def _enable(self) -> None:
        node = self._node
        stops = node.stops
        if not node.enabled and node.wanted_mode in FOLLOWED:
            # Whoever is enabled in such a mode may go to what it was told last.
            node.wanted_mode = PROFILE_POSITION_MODE
        for _ in range(_STEPS):
            before = node.state
            if before is State.ENABLED:
                node.order(states.ENABLE)
                return
            if node.stops != stops:
                raise CannotDo("stopped", f"a stop came before {node.name} was enabled", "")
            if before is State.QUICK_STOP:
                # Not every drive may leave it that way (transition 16).
                node.order(states.ENABLE)
                if await node.soon(lambda: node.state is not State.QUICK_STOP):
                    continue
            node.require_well()
            order = NEXT.get(before)
            if order is None:
                break
            node.order(order)
            if not await node.soon(lambda before=before: node.state is not before):
                break
        if node.state is not State.ENABLED:
            await node.look()
            raise self._stuck("enable")

    def _stuck(self, what: str) -> CannotDo:
        node = self._node
        why = f": {node.why()}" if node.emergencies else ""
        return CannotDo(
            "not-switched",
            f"{node.name} can not be brought to {what}; it stays {node.state.value}{why}",
            "is its enable input on, and its power stage supplied?",
        )

    async def reset(self) -> None:
        """Clear a fault. Raises `CannotDo`."""
        await self.stopped()
        node = self._node
        # A reset is taken when the drive has come to rest.
        await node.until(lambda: node.state is not State.REACTION, node.clock.now_ns() + _RAMP_NS)
        if node.state is State.FAULT:
            node.order(states.DISABLE_VOLTAGE)
            node.order(states.FAULT_RESET)
            cleared = await node.soon(lambda: node.state is not State.FAULT)
            node.order(states.DISABLE_VOLTAGE)
            if not cleared:
                await node.look()
                raise CannotDo("fault", f"{node.name} keeps its fault: {node.why()}", "take away its cause, then reset")
        node.emergencies.clear()

    # Stops

    def stop(self, abort: bool) -> int:
        """Write a stop at once and see it through; host time. Raises `LinkClosed`."""
        node = self._node
        node.stops += 1
        node.outputs = self._released()
        if not node.mapped:
            waiting = node.at_sync(states.QUICK_STOP, self._passive_outputs)
            return node.bus.send_stop(node.number, [waiting, quick_stop_by_sdo(node.number)])
        # What is not enabled does not move, and a halt would enable it.
        moving = node.state in (State.ENABLED, State.QUICK_STOP)
        control = states.QUICK_STOP if abort or node.state is State.QUICK_STOP else states.ENABLE | states.HALT
        at_ns = node.bus.send_stop(
            node.number, node.orders(control if moving else node.control & ~states.NEW_SET_POINT)
        )
        if moving:
            task = asyncio.get_running_loop().create_task(self._see_through(node.stops))
            self._stopping.add(task)
            task.add_done_callback(self._stopping.discard)
        node.wake()
        return at_ns

    def _released(self) -> int:
        return self._passive_outputs if self._driving else self._node.outputs

    _driving = False

    def drives(self, driving: bool, passive: int) -> None:
        """A step drives an output, or does not any more. passive: 60FEh to take when it is stopped."""
        self._driving, self._passive_outputs = driving, passive

    @property
    def stopping(self) -> bool:
        """A stop has not been seen through: the drive has not said that it rests."""
        return bool(self._stopping)

    async def stopped(self) -> None:
        """Until every stop has been seen through."""
        while self._stopping:
            await asyncio.gather(*self._stopping, return_exceptions=True)

    def forget(self) -> None:
        for task in self._stopping:
            task.cancel()

    async def _see_through(self, stops: int) -> None:
        node = self._node

        def resting() -> bool:
            return node.stops != stops or (
                bool(node.status & states.TARGET_REACHED) or node.state not in (State.ENABLED, State.QUICK_STOP)
            )

        with suppress(LinkClosed, CannotDo, DriverFault):
            now_ns = node.clock.now_ns()
            await node.until(lambda: node.stops != stops, now_ns + _SEEN_NS)
            await node.until(resting, now_ns + _RAMP_NS)
            if node.stops != stops or node.bus.off:
                return
            if node.state is State.ENABLED:
                node.order(states.QUICK_STOP, PROFILE_POSITION_MODE if node.wanted_mode in FOLLOWED else None)
                await node.soon(lambda: node.state is not State.ENABLED)
                await node.until(resting, now_ns + _RAMP_NS)
            if node.stops == stops and node.state is State.QUICK_STOP:
                await self._enable()


def quick_stop_by_sdo(number: int) -> CanFrame:
    """A quick stop for a drive whose PDOs may be anybody's; it never enables."""
    return CanFrame(SDO_REQUEST + number, download(CONTROLWORD, states.QUICK_STOP))
