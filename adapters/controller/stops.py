"""Stops of a controller for any reason, bypassing everything else. A stop by software is no safety function."""

from adapters.abilities import set_output
from adapters.controller.components import Components
from adapters.controller.state.context import ControllerContext
from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.model.errors import ControllerFault
from orchestrator.model.state import EstopLatch

# delay after an e-stop before it is published and saved: all controllers of the host stop first
ESTOP_PUBLISH_DELAY_NS = 30 * NS_PER_MS
START_VISIBLE_NS = 300 * NS_PER_MS  # after T0: by then a poll shows whether an axis moves


class ControllerStops:
    """Stops one controller: on request, by an e-stop, at the end of a lease, or when the coordinator is lost."""

    def __init__(self, context: ControllerContext, parts: Components) -> None:
        self._context = context
        self._parts = parts
        parts.leases.on_ended = self._handle_lease_end

    async def stop(self, reason: str, *, abort: bool, follow: bool = False) -> None:
        """Stop the controller for any reason; nothing that is loaded starts afterwards. follow: keep following a moving
        step until it is at rest."""
        status = self._parts.status
        status.stopped_ns = status.ordered_ns = self._context.clock.now_ns()
        stop_ns = max(self._context.driver.capabilities.costs.stop_ns, self._parts.steps.stop_ns)
        status.stopping_until_ns = status.stopped_ns + stop_ns
        status.stop_unseen = True
        armed_step = self._parts.steps.present
        if armed_step is not None:
            status.begun_by_ns = armed_step.t0_host_ns + START_VISIBLE_NS
        self._parts.jogging.drop_all(reason)
        try:
            await self._parts.withdrawal.stop(abort=abort, reason=reason, follow=follow)
        except (LinkClosed, LinkRefused, ControllerFault):
            self._parts.pending_stop.request_stop()
            raise
        finally:
            self._parts.timer.wake_up()

    async def apply_estop(self, latch: EstopLatch) -> None:
        """Latch and stop as fast as the controller can; then switch outputs and motors to their safe states."""
        fresh = self._parts.fence.latch_estop(latch)
        self._parts.tasks.spawn(self._publish_latch(latch if fresh else None))
        await self._parts.tasks.log_errors(self.stop(abort=True, reason=f"e-stop {latch.event} by {latch.actor}"))
        await self._parts.tasks.log_errors(self._make_outputs_safe())
        await self._parts.tasks.log_errors(self._parts.motors.switch_off_after_estop())

    async def _publish_latch(self, fresh: EstopLatch | None) -> None:
        await sleep_ns(self._context.clock, ESTOP_PUBLISH_DELAY_NS)
        if fresh is not None:
            self._parts.publisher.emit_event("estop", f"e-stop by {fresh.actor}: {fresh.reason}")
        self._parts.publisher.publish_state()
        await self.persist_latch()

    async def persist_latch(self) -> None:
        """Save the latch; a disk that is full takes nothing from what this process knows."""
        try:
            await self._parts.fence.persist()
        except OSError as error:
            self._context.log.warning(
                f"the e-stop latch is not saved to disk: {error}", controller=self._context.controller
            )

    async def _make_outputs_safe(self) -> None:
        """Switch the outputs that have a safe state to it."""
        if self._parts.status.reading is None:
            return
        for point in self._context.config.outputs.values():
            if point.safe is not None:
                await set_output(self._context.driver, point.number, on=point.safe == (point.active == "high"))

    async def handle_coordinator_loss(self, reason: str) -> None:
        """Handle a missing heartbeat of the coordinator: unload or stop, and end all leases."""
        self._parts.leases.end_all(reason)
        await self._parts.tasks.log_errors(self._parts.withdrawal.abandon_step(reason))

    def _handle_lease_end(self, holder: str, axes: list[str], reason: str) -> None:
        """Stop what the holder still moves."""
        armed_step = self._parts.steps.present
        if armed_step is not None and armed_step.job == holder:
            self._parts.tasks.spawn(self._parts.withdrawal.abandon_step(f"{reason}: {', '.join(axes)}"))
        if self._parts.status.searching & set(axes):
            self._parts.tasks.spawn(self.stop(abort=False, reason=reason))
        jogged_axes = self._parts.jogging.list_jogged(holder)
        if jogged_axes:
            self._parts.tasks.spawn(self._parts.jogging.stop_axes(jogged_axes, reason))

    def misses_estop(self, event: str) -> bool:
        """Whether this controller has neither latched the e-stop `event`, nor reset it last."""
        return self._parts.fence.misses_estop(event)
