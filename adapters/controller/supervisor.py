"""Supervision of one controller: its link is kept alive, its state polled, and its components connected to the bus.

Everything here is common to all makes; make-specific code is behind `Driver`.
"""

import asyncio
from collections.abc import Iterable

from adapters.controller.attempt_pauses import FIRST_NS, AttemptPauses
from adapters.controller.commands import ControllerCommands
from adapters.controller.components import build_components
from adapters.controller.evaluation import ReadingEvaluation
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.store import PersistentMemory
from adapters.controller.stops import ControllerStops
from orchestrator.bus.base import RequestHandler
from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.state import EstopLatch, FaultReport

HEARTBEAT_NS = 400 * NS_PER_MS  # an adapter that is silent for 0.7 s counts as dead


class ControllerSupervisor:
    """Supervise the controller of `context`; `remembered` holds its e-stop latch and epoch."""

    def __init__(self, context: ControllerContext, remembered: PersistentMemory) -> None:
        self.controller = context.controller
        self._context = context
        self._clock, self._log = context.clock, context.log
        self._parts = parts = build_components(context, remembered)
        self.stops = ControllerStops(context, parts)
        parts.polling.listener = ReadingEvaluation(context, parts, self.stops)
        self._commands = ControllerCommands(context, parts, self.stops)
        self._pauses = AttemptPauses(context.clock)
        self._keeping: asyncio.Task[None] | None = None
        self.is_served = False
        """Whether requests to the controller are answered."""

    async def start(self, latches: Iterable[EstopLatch]) -> None:
        """Start serving the controller, latched by `latches`, which are kept by other processes of the fleet."""
        self.is_served = True
        for latch in latches:
            self._parts.fence.latch_estop(latch)
        await self.stops.persist_latch()
        self._parts.fence.allow_adoption()
        self._keeping = self._parts.tasks.spawn(self._keep_connected())

    @property
    def is_supervising(self) -> bool:
        """Whether the link is supervised; false only by a defect, because supervision ends with `close` alone."""
        return self._keeping is None or not self._keeping.done()

    async def close(self) -> None:
        """Leave the bus and close the link. The controller stays as it is."""
        self.is_served = False
        self._parts.tasks.cancel_all()
        await self._context.driver.close()

    def find_handler(self, leaf: str) -> RequestHandler | None:
        """The handler of the controller's commands (`cmd`), or of one of its values; None while it is not served."""
        if not self.is_served:
            return None
        return self._commands.answer_command if leaf == "cmd" else self._parts.publisher.value_handlers.get(leaf)

    @property
    def values(self) -> Iterable[str]:
        """The last words of the keys of its values."""
        return self._parts.publisher.value_handlers

    @property
    def is_moving(self) -> bool:
        """Whether any axis moves, as far as is known."""
        return self._parts.publisher.is_moving

    # Connection

    async def _keep_connected(self) -> None:
        """Connect to the controller, serve it until the link breaks, and reconnect with growing back-off."""
        self._parts.tasks.spawn(self._publish_heartbeats())
        while True:
            is_defect = False
            try:
                await self._parts.pending_stop.guard_attempt(self._set_up_connection())
                await self._go_online()
                await self._poll_until_lost()
            except LinkRefused as error:
                self._handle_offline(
                    FaultReport(code="link-refused", text=str(error), remedy="check power, cable and address")
                )
            except LinkClosed as error:
                self._handle_offline(
                    FaultReport(
                        code="link-closed", text=str(error), remedy="check the cable; the adapter keeps reconnecting"
                    )
                )
            except ControllerFault as error:
                self._handle_offline(FaultReport.of(error))
            except Refusal as error:
                self._handle_offline(FaultReport(code=error.code, text=error.text, remedy=error.remedy))
            except Exception as error:
                # A defect: this task must not end, or nothing would ever connect to the controller again.
                is_defect = True
                self._handle_offline(self._parts.defects.note_defect(error))
            await self._close_driver()
            pause_ns = self._pauses.pause_ns
            if pause_ns or not self._parts.pending_stop.is_pending:
                # A step that was loaded when the link broke may be about to begin: its stop is sent without a pause.
                await self._parts.pending_stop.pause_attempts(max(pause_ns, FIRST_NS))
            self._pauses.prolong_pause(is_defect=is_defect)

    async def _close_driver(self) -> None:
        try:
            await self._context.driver.close()
        except Exception as error:
            self._parts.defects.note_defect(error)

    async def _set_up_connection(self) -> None:
        """Connect to the controller and load what the driver needs. A pending stop is sent before the connection is set
        up, and again after it."""
        self._parts.defects.must_reconnect = False
        async with self._parts.pending_stop.sent_first():
            self._parts.status.identity = await self._context.driver.connect()
        if await self._parts.pending_stop.send_stop():
            self._parts.publisher.emit_event("stopped", "stopped as soon as the link was back")
        await self._context.driver.configure()
        await self._parts.referencing.load_soft_limits(list(self._context.config.axes))

    async def _go_online(self) -> None:
        """Publish the first reading of the connected controller."""
        self._parts.status.faults = []
        self._parts.status.differences.clear()
        self._parts.polling.is_connected = True
        await self._parts.polling.poll_and_publish()
        identity = self._parts.status.identity
        self._parts.publisher.emit_event(
            "online", f"{self._context.make.name} {identity.firmware if identity else ''}".strip()
        )

    async def _poll_until_lost(self) -> None:
        """Poll and publish until the link breaks or the controller's replies are invalid."""
        while True:
            await self._parts.polling.wait_for_next_poll()
            self._parts.defects.raise_new_defect()
            await self._parts.polling.poll_and_publish()
            await self._parts.surveillance.check_next_settings()

    async def _publish_heartbeats(self) -> None:
        """Publish the adapter's heartbeat while its controller is not polled: it is unreachable, its line is busy, or
        the fleet file sets a low poll rate.

        No heartbeat in motion: without a poll the state of a moving controller is unknown.
        """
        while True:
            wait_ns = self._parts.publisher.published_ns + HEARTBEAT_NS - self._clock.now_ns()
            if wait_ns <= 0:
                armed_step = self._parts.steps.present
                waits = armed_step is not None and self._clock.now_ns() < armed_step.t0_host_ns
                try:
                    if waits or self._parts.publisher.current_mode() != "moving":
                        self._parts.publisher.publish_state()
                except Exception as error:  # one heartbeat that fails must not be the last
                    self._parts.defects.note_defect(error)
                wait_ns = HEARTBEAT_NS
            await sleep_ns(self._clock, wait_ns)

    def _handle_offline(self, fault: FaultReport) -> None:
        status = self._parts.status
        self._parts.polling.is_connected = False
        last_reading, status.reading = status.reading, None
        status.play.lose_sight()
        was_online = last_reading is not None
        is_repeated, status.faults = status.faults == [fault], [fault]
        # A stop that was sent is not yet a stop: its bytes may have been lost with the link.
        unseen = last_reading is not None and (
            last_reading.at_ns < status.stopped_ns or any(axis.moving for axis in last_reading.axes.values())
        )
        may_move = unseen or self._parts.steps.may_move or bool(status.moved_singly)
        status.may_move = status.may_move or may_move
        if may_move:
            self._parts.pending_stop.request_stop()
        status.homing.clear()
        status.probing.clear()
        self._parts.jogging.drop_all("the link is lost")
        self._parts.withdrawal.drop_step(f"the link is lost: {fault.text}")
        if was_online:
            self._pauses.note_lost()
            self._parts.publisher.emit_event("offline", fault.text, fault=fault)
            self._parts.publisher.publish_state()
        if not is_repeated:  # while a stop is pending, attempts are frequent
            self._log.warning(fault.text, controller=self.controller, code=fault.code)
