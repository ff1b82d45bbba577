"""Polls of a controller: at the rate of its state, never in the quiet time before T0; each reading is evaluated and
published."""

from dataclasses import replace
from typing import Protocol
from zlib import crc32

from adapters.contract import ControllerReading, HostInterval
from adapters.controller.monitoring.pairs import PairWatch
from adapters.controller.publishing.publisher import StatePublisher
from adapters.controller.state.armed_step import StepPhase
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.loaded_steps import LoadedSteps
from adapters.controller.state.poll_timer import PollTimer
from adapters.controller.state.readings import require_sound_reading
from adapters.controller.state.status import ControllerStatus
from orchestrator.clock.base import NS_PER_MS
from orchestrator.link.base import LinkClosed

POLL_SPREAD = 0.08  # of the poll period


class ReadingListener(Protocol):
    """Evaluates readings, before they are published."""

    def handle_reading(self, reading: ControllerReading) -> None:
        """A controller was read."""
        ...


class StatePolling:
    """Polls one controller. is_connected: its connection is set up. listener: set before the first poll."""

    listener: ReadingListener

    def __init__(
        self,
        context: ControllerContext,
        status: ControllerStatus,
        steps: LoadedSteps,
        publisher: StatePublisher,
        timer: PollTimer,
    ) -> None:
        self.is_connected = False
        self._context = context
        self._status = status
        self._steps = steps
        self._publisher = publisher
        self._timer = timer
        self._pairs = PairWatch(context.config)
        # Polls are spread out: after a common stop, 16 controllers would otherwise be polled at the same instant for
        # ever.
        self._poll_spread = 1.0 + POLL_SPREAD * (crc32(context.controller.encode()) % 64) / 64

    async def poll_and_publish(self) -> None:
        """Read the controller and publish the new state. Raises `LinkClosed` until the controller is connected: while
        the connection is set up the controller replies, but its loaded content is not this adapter's."""
        began_ns = self._context.clock.now_ns()
        reading = await self._context.driver.poll() if self.is_connected else None
        # The connection may be lost while the poll waits for its turn on the line.
        if reading is None or not self.is_connected:
            raise LinkClosed("the controller is not connected yet")
        self._steps.polled_ns = self._context.clock.now_ns()
        self._steps.poll_takes_ns = self._steps.polled_ns - began_ns
        if reading.sampled is None:
            reading = replace(reading, sampled=HostInterval(began_ns, self._steps.polled_ns))
        require_sound_reading(reading)
        self.listener.handle_reading(reading)
        self._publisher.publish_state()

    async def wait_for_next_poll(self) -> None:
        """Wait for the next poll: at the configured rate, at once after a wake-up, never in the quiet time before
        T0."""
        rates, armed_step = self._context.config.state, self._steps.present
        about_to_move = armed_step is not None and armed_step.phase is StepPhase.RELEASED
        is_fast = about_to_move or self._publisher.is_moving
        if is_fast:
            await self._timer.wait(1.0 / self._pairs.moving_hz)
        else:
            await self._timer.wait_on_grid(self._poll_spread / rates.idle_hz)
        while (until_ns := self._quiet_until_ns()) is not None:
            # A stop ends the quiet time by a wake-up; so does the beginning of a jog.
            await self._timer.wait_until_ns(until_ns + NS_PER_MS)

    def _quiet_until_ns(self) -> int | None:
        """Return until when the controller is not polled; None: it is polled. A controller that jogs, homes or probes
        is always polled, and one with an axis of two motors whenever it moves."""
        if self._status.moved_singly or (self._pairs.has_pairs and self._publisher.is_moving):
            return None
        return self._steps.quiet_until_ns(self._context.clock.now_ns())
