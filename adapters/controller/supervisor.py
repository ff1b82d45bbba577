"""Supervision of one controller: its link is kept alive, its state polled, and its components connected to the bus.

Everything here is common to all makes; make-specific code is behind `Driver`.
"""

import asyncio
from collections.abc import Coroutine, Mapping
from contextlib import suppress
from typing import Any
from zlib import crc32

from pydantic import ValidationError

from adapters.abilities import set_output
from adapters.contract import ControllerReading
from adapters.controller.armed_step import ArmedStep, StepPhase
from adapters.controller.commands import Components, ControllerCommands
from adapters.controller.context import ControllerContext
from adapters.controller.defects import DefectRecord
from adapters.controller.fencing import EpochFence
from adapters.controller.jogging import JogControl
from adapters.controller.leases import MotionLeases
from adapters.controller.limits import check_path_limits, check_profiles
from adapters.controller.motors import MotorControl
from adapters.controller.participant import StepParticipant, StepServices
from adapters.controller.path_chunks import PathChunks
from adapters.controller.pending_stop import PendingStop
from adapters.controller.publisher import StatePublisher, StepActivity
from adapters.controller.readings import require_sound_reading
from adapters.controller.referencing import AxisReferencing
from adapters.controller.sampling import SampleCollection
from adapters.controller.settling import SettlingMonitor
from adapters.controller.status import ControllerStatus
from adapters.controller.store import PersistentMemory
from adapters.controller.surveillance import StepActivityChecks, Surveillance
from adapters.controller.triggers import TriggerCollection
from orchestrator.bus.base import BusDeclaration, RequestHandler
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.fleet import FleetScale
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import ArmRequest, KeptEstop, ProposeRequest
from orchestrator.model.state import AxisEvidence, ControllerState, EstopLatch, EventKind, FaultReport

BACKOFF_FIRST_NS = 200 * NS_PER_MS
BACKOFF_LONGEST_NS = 5 * NS_PER_S
# delay after an e-stop before it is published and saved: all controllers of the host stop first
ESTOP_PUBLISH_DELAY_NS = 30 * NS_PER_MS
START_VISIBLE_NS = 300 * NS_PER_MS  # after T0: by then a poll shows whether an axis moves
HEARTBEAT_NS = 400 * NS_PER_MS  # an adapter that is silent for 0.7 s counts as dead
POLL_SPREAD = 0.08  # of the poll period


class ControllerSupervisor:
    """Supervise the controller of `context`; `remembered` holds its e-stop latch and epoch."""

    def __init__(self, context: ControllerContext, remembered: PersistentMemory) -> None:
        self.controller = context.controller
        self._context = context
        self._config, self._driver = context.config, context.driver
        self._bus, self._keys, self._clock, self._log = context.bus, context.keys, context.clock, context.log
        self._fence = EpochFence(remembered)
        self._status = ControllerStatus(context.config)
        driver, condition = context.driver, self._status
        self._leases = MotionLeases(
            context.config,
            context.clock,
            lambda: driver.capabilities.independent_axes,
            self._handle_lease_end,
            context.sessions.present_until_ns,
        )
        self._settling = SettlingMonitor(context.clock, condition, self.poll_and_publish)
        self._participant = StepParticipant(
            context.controller,
            context.driver,
            context.clock,
            StepServices(
                check=self._check_step,
                check_following=self._check_following_step,
                scale=self._require_scale,
                emit=self._emit_step,
                settle=self._settling.wait_until_settled,
                must_settle=self._settling.must_settle,
                doubt_positions=lambda wrong: self._surveillance.doubt_positions(wrong),
                note_differences=lambda differences: self._surveillance.note_differences(differences),
                spawn=self._spawn_task,
            ),
            context.lowering_lock,
        )
        self._publisher = StatePublisher(
            context,
            self._fence,
            remembered,
            condition,
            StepActivity(
                armed_step=lambda: self._participant.armed_step,
                following=lambda: self._participant.is_following,
                past_steps=lambda: self._participant.past_steps,
                holders=lambda: self._leases.holders,
            ),
        )
        self._jogging = JogControl(driver, context.clock, condition, self._spawn_task, self.wake_poll)
        self._motors = MotorControl(driver, context.clock, condition, self._settling, self.poll_and_publish)
        self._referencing = AxisReferencing(
            driver, self._settling, condition, self._publisher.emit_event, self.poll_and_publish
        )
        self._surveillance = Surveillance(
            driver,
            context.clock,
            condition,
            self._publisher.emit_event,
            StepActivityChecks(self._has_ordered_motion, self._has_step),
        )
        parts = Components(
            fence=self._fence,
            remembered=remembered,
            leases=self._leases,
            participant=self._participant,
            chunks=PathChunks(self._participant, driver, self._fence, self._leases, condition),
            jogging=self._jogging,
            motors=self._motors,
            referencing=self._referencing,
            surveillance=self._surveillance,
            samples=SampleCollection(driver, condition, self._has_step, self._require_scale),
            scale=self._require_scale,
            triggers=TriggerCollection(driver, context.clock, condition, self._has_step, self._require_scale),
            status=condition,
            publisher=self._publisher,
        )
        self._commands = ControllerCommands(context, parts, self)
        self._pending_stop = PendingStop(context, self._participant.wait_until_loaded)
        self._defects = DefectRecord(self._log, context.controller)
        # Polls are spread out: after a common stop, 16 controllers would otherwise be polled at the same instant for
        # ever.
        self._poll_spread = 1.0 + POLL_SPREAD * (crc32(context.controller.encode()) % 64) / 64
        self._is_connected = False
        self._poll_wake = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()
        self._keeping: asyncio.Task[None] | None = None
        self._declared: list[BusDeclaration] = []

    # Life cycle

    async def start(self) -> None:
        """Start serving the controller on the bus; start latched if any other controller of the fleet is latched."""
        self._declared = [
            *await self._publisher.serve_queries(),
            await self._bus.serve(self._keys.command(self.controller), self._commands.answer_command),
        ]
        await self._adopt_fleet_latch()
        self._declared.append(
            await self._bus.announce(self._keys.live("controller", self.controller, self._context.instance))
        )
        self._keeping = self._spawn_task(self._keep_connected())

    @property
    def is_supervising(self) -> bool:
        """Whether the link is supervised; false only by a defect, because supervision ends with `close` alone."""
        return self._keeping is None or not self._keeping.done()

    async def close(self) -> None:
        """Leave the bus and close the link. The controller stays as it is."""
        declarations, self._declared = self._declared, []
        for declaration in declarations:
            await declaration.undeclare()
        for task in list(self._tasks):
            task.cancel()
        await self._driver.close()

    @property
    def command_handler(self) -> RequestHandler | None:
        """The handler of the controller's commands; None while it is not on the bus."""
        return self._commands.answer_command if self._declared else None

    async def _adopt_fleet_latch(self) -> None:
        """Latch what any other process of the fleet has latched; only then can this controller be adopted."""
        replies, kept_latches = await asyncio.gather(
            self._bus.request_all(self._keys.state(), b"", timeout_s=1.0),
            self._bus.request_all(self._keys.kept_estop(), b"", timeout_s=1.0),
        )
        for key in sorted(kept_latches):
            with suppress(ValidationError):
                latch = KeptEstop.read_message(kept_latches[key]).estop
                if latch is not None:
                    self._fence.latch_estop(latch)
        for key in sorted(replies):
            try:
                state = ControllerState.read_message(replies[key])
            except ValidationError:
                continue
            if state.estop is not None and state.controller != self.controller:
                self._fence.latch_estop(state.estop)
        await self._persist_latch()
        self._fence.allow_adoption()

    async def _keep_connected(self) -> None:
        """Connect to the controller, serve it until the link breaks, and reconnect with growing back-off."""
        self._spawn_task(self._publish_heartbeats())
        pause_ns = BACKOFF_FIRST_NS
        while True:
            try:
                await self._pending_stop.guard_attempt(self._set_up_connection())
                await self._go_online()
                pause_ns = 0
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
                self._handle_offline(self._defects.note_defect(error))
            await self._close_driver()
            if pause_ns or not self._pending_stop.is_pending:
                # A step that was loaded when the link broke may be about to begin: its stop is sent without a pause.
                await self._pending_stop.pause_attempts(max(pause_ns, BACKOFF_FIRST_NS))
            pause_ns = min(max(2 * pause_ns, BACKOFF_FIRST_NS), BACKOFF_LONGEST_NS)

    async def _close_driver(self) -> None:
        try:
            await self._driver.close()
        except Exception as error:
            self._defects.note_defect(error)

    async def _set_up_connection(self) -> None:
        """Connect to the controller and load what the driver needs. A pending stop is sent before the connection is set
        up, and again after it."""
        self._defects.must_reconnect = False
        async with self._pending_stop.sent_first():
            self._status.identity = await self._driver.connect()
        if await self._pending_stop.send_stop():
            self._publisher.emit_event("stopped", "stopped as soon as the link was back")
        await self._driver.configure()
        await self._referencing.load_soft_limits(list(self._config.axes))

    async def _go_online(self) -> None:
        """Publish the first reading of the connected controller."""
        self._status.faults = []
        self._status.differences.clear()
        self._is_connected = True
        await self.poll_and_publish()
        identity = self._status.identity
        self._publisher.emit_event(
            "online", f"{self._context.make.name} {identity.firmware if identity else ''}".strip()
        )

    async def _poll_until_lost(self) -> None:
        """Poll and publish until the link breaks or the controller's replies are invalid."""
        while True:
            await self._wait_for_next_poll()
            self._defects.raise_new_defect()
            await self.poll_and_publish()
            await self._surveillance.check_next_settings()

    async def _wait_for_next_poll(self) -> None:
        """Wait for the next poll: at the configured rate, at once after a wake-up, never in the quiet time before
        T0."""
        rates, armed_step = self._config.state, self._participant.armed_step
        about_to_move = armed_step is not None and armed_step.phase is StepPhase.RELEASED
        period_s = 1.0 / rates.moving_hz if about_to_move or self.is_moving else self._poll_spread / rates.idle_hz
        timer = asyncio.get_running_loop().call_later(period_s, self._poll_wake.set)
        try:
            await self._poll_wake.wait()
        finally:
            timer.cancel()
        self._poll_wake.clear()
        while (until_ns := self._quiet_until_ns()) is not None:
            # A stop ends the quiet time by a wake-up; so does the beginning of a jog.
            alarm = self._clock.call_at_ns(until_ns + NS_PER_MS, self._poll_wake.set)
            try:
                await self._poll_wake.wait()
            finally:
                alarm.cancel()
            self._poll_wake.clear()

    def _quiet_until_ns(self) -> int | None:
        """Return until when the controller is not polled; None: it is polled. A jogging or homing controller is always
        polled."""
        manual_motion = self._status.jogging or self._status.homing
        return None if manual_motion else self._participant.quiet_until_ns()

    async def _publish_heartbeats(self) -> None:
        """Publish the adapter's heartbeat while its controller is not polled: it is unreachable, its line is busy, or
        the fleet file sets a low poll rate.

        No heartbeat in motion: without a poll the state of a moving controller is unknown.
        """
        while True:
            wait_ns = self._publisher.published_ns + HEARTBEAT_NS - self._clock.now_ns()
            if wait_ns <= 0:
                armed_step = self._participant.armed_step
                waits = armed_step is not None and self._clock.now_ns() < armed_step.t0_host_ns
                try:
                    if waits or self._publisher.current_mode() != "moving":
                        self._publisher.publish_state()
                except Exception as error:  # one heartbeat that fails must not be the last
                    self._defects.note_defect(error)
                wait_ns = HEARTBEAT_NS
            await sleep_ns(self._clock, wait_ns)

    def _has_ordered_motion(self) -> bool:
        """Whether anything that this adapter has ordered may change positions now. A step that is only loaded moves
        nothing."""
        status = self._status
        armed_step = self._participant.armed_step
        is_released = armed_step is not None and armed_step.phase in (StepPhase.RELEASED, StepPhase.MOVING)
        busy = is_released or self._participant.is_following or bool(status.homing | status.jogging)
        return busy or status.stop_unseen or self.is_moving

    def _has_step(self) -> bool:
        """Whether a step is loaded, or being loaded: its exchanges must not be delayed."""
        return self._participant.armed_step is not None or self._participant.is_loading

    def wake_poll(self) -> None:
        """Poll soon: an activity has begun or ended."""
        self._poll_wake.set()

    # Evaluation of polls

    async def poll_and_publish(self) -> None:
        """Read the controller and publish the new state. Raises `LinkClosed` until the controller is connected: while
        the connection is set up the controller replies, but its loaded content is not this adapter's."""
        reading = await self._driver.poll() if self._is_connected else None
        # The connection may be lost while the poll waits for its turn on the line.
        if reading is None or not self._is_connected:
            raise LinkClosed("the controller is not connected yet")
        require_sound_reading(reading)
        self._handle_reading(reading)
        self._publisher.publish_state()

    def _handle_reading(self, reading: ControllerReading) -> None:
        """Compare a fresh reading with the last one, and report what has changed."""
        status = self._status
        last_reading, status.reading = status.reading, reading
        status.may_move = False
        unreferenced_axes = self._referencing.handle_reading(reading)
        unreferenced_axes += self._surveillance.find_jumps(last_reading, reading)
        if reading.restarted:
            self._publisher.emit_event("fault", "the controller was restarted; its axes are no longer referenced")
            self._participant.drop_step("the controller was restarted")
            self._jogging.drop_all("the controller was restarted")
        if unreferenced_axes or reading.restarted:
            self._spawn_task(self._referencing.load_soft_limits(list(self._config.axes)))
        self._jogging.handle_reading(reading)
        for name, axis_reading in reading.axes.items():
            old = last_reading.axes[name].limit if last_reading is not None else "none"
            if axis_reading.limit not in ("none", old):
                self._publisher.emit_event("limit", f"axis {name} is on its {axis_reading.limit} limit switch")
        for name, point in self._config.inputs.items():
            level = reading.inputs.get(point.number)
            if last_reading is not None and last_reading.inputs.get(point.number) != level:
                active = level == (point.active == "high")
                self._publisher.emit_event("input", f"input {name} is {'active' if active else 'inactive'}")
        faults = [*reading.faults, *self._settling.find_following_errors(reading)]
        faults += [difference.to_fault() for difference in status.differences.values()]
        known_faults = {(fault.code, fault.axis) for fault in status.faults}
        for fault in faults:
            if (fault.code, fault.axis) not in known_faults:
                self._publisher.emit_event("fault", fault.text, fault=fault)
        if status.faults and not faults:
            self._publisher.emit_event("cleared", "all faults are cleared")
        status.faults = faults
        if faults and status.jogging:
            self._spawn_task(self._jogging.stop_axes(sorted(status.jogging), faults[0].text))
        failure = self._motion_failure(last_reading, reading)
        if failure is not None:
            self._spawn_task(self._participant.fail_step(failure))
        self._repeat_lost_stop(reading)

    def _repeat_lost_stop(self, reading: ControllerReading) -> None:
        """Repeat a stop without effect: a stop on a disturbed line may be lost. A controller that moves after the time
        of its stop, without a step, jog or homing, is stopped again."""
        status = self._status
        if not status.stop_unseen or reading.at_ns < status.stopped_ns:
            return
        if not any(axis.moving for axis in reading.axes.values()):
            # A step that was loaded when the stop was lost begins in spite of it.
            status.stop_unseen = reading.at_ns < status.begun_by_ns
            return
        is_owned = self._participant.armed_step is not None or bool(status.jogging | status.homing)
        if not is_owned and reading.at_ns > status.stopping_until_ns:
            self._log.warning(
                "the controller moves although it was stopped; the stop is sent again", controller=self.controller
            )
            self._spawn_task(self.stop(abort=False, reason="repeated stop: the controller moved after an earlier one"))

    def _motion_failure(self, before: ControllerReading | None, reading: ControllerReading) -> str | None:
        """Return the reason why a moving step must be aborted after this poll, or None; a failure of one axis is a
        failure of the step."""
        armed_step = self._participant.armed_step
        moving_step = armed_step if armed_step is not None and armed_step.phase is StepPhase.MOVING else None
        outside_text = self._surveillance.find_outside_motion(self._participant.ordered_axes, reading)
        if moving_step is None or before is None:
            return None
        if self._status.faults:
            return self._status.faults[0].text
        for name in moving_step.axes:
            axis_reading, old = reading.axes[name], before.axes[name]
            if axis_reading.position_lost and not old.position_lost:
                return f"axis {name} has lost its position"
            # The axis leaves a switch that was active at the start.
            if axis_reading.limit not in ("none", old.limit):
                return f"axis {name} has run into its {axis_reading.limit} limit switch"
            if old.enabled and not axis_reading.enabled:
                return f"the motor of axis {name} has switched off"
        return outside_text

    def _handle_offline(self, fault: FaultReport) -> None:
        status, participant = self._status, self._participant
        self._is_connected = False
        last_reading, status.reading = status.reading, None
        was_online = last_reading is not None
        is_repeated, status.faults = status.faults == [fault], [fault]
        # A stop that was sent is not yet a stop: its bytes may have been lost with the link.
        unseen = last_reading is not None and (
            last_reading.at_ns < status.stopped_ns or any(axis.moving for axis in last_reading.axes.values())
        )
        # A move that waits for a trigger line waits before the participant is armed.
        has_load = (
            participant.armed_step is not None
            or participant.is_following
            or participant.is_loading
            or participant.stop_pending
        )
        may_move = unseen or has_load or bool(status.jogging | status.homing)
        status.may_move = status.may_move or may_move
        if may_move:
            self._pending_stop.request_stop()
        status.homing.clear()
        self._jogging.drop_all("the link is lost")
        self._participant.drop_step(f"the link is lost: {fault.text}")
        if was_online:
            self._publisher.emit_event("offline", fault.text, fault=fault)
            self._publisher.publish_state()
        if not is_repeated:  # while a stop is pending, attempts are frequent
            self._log.warning(fault.text, controller=self.controller, code=fault.code)

    # Stops, bypassing everything else

    async def stop(self, reason: str, *, abort: bool, follow: bool = False) -> None:
        """Stop the controller for any reason; nothing that is loaded starts afterwards. follow: keep following a moving
        step until it is at rest."""
        status = self._status
        status.stopped_ns = status.ordered_ns = self._clock.now_ns()
        stop_ns = max(self._driver.capabilities.costs.stop_ns, self._participant.stop_ns)
        status.stopping_until_ns = status.stopped_ns + stop_ns
        status.stop_unseen = True
        armed_step = self._participant.armed_step
        if armed_step is not None:
            status.begun_by_ns = armed_step.t0_host_ns + START_VISIBLE_NS
        self._jogging.drop_all(reason)
        try:
            await self._participant.stop(abort=abort, reason=reason, follow=follow)
        except (LinkClosed, LinkRefused, ControllerFault):
            self._pending_stop.request_stop()
            raise
        finally:
            self._poll_wake.set()

    @property
    def is_moving(self) -> bool:
        """Whether any axis moves, as far as is known."""
        return self._publisher.current_mode() in ("moving", "jogging", "homing", "stopping")

    def misses_estop(self, event: str) -> bool:
        """Whether this controller has neither latched the e-stop `event`, nor reset it last."""
        return self._fence.misses_estop(event)

    async def apply_estop(self, latch: EstopLatch) -> None:
        """Latch and stop as fast as the controller can; then switch outputs and motors to their safe states."""
        fresh = self._fence.latch_estop(latch)
        self._spawn_task(self._publish_latch(latch if fresh else None))
        await self._log_errors(self.stop(abort=True, reason=f"e-stop {latch.event} by {latch.actor}"))
        await self._log_errors(self._make_outputs_safe())
        await self._log_errors(self._motors.switch_off_after_estop())

    async def _publish_latch(self, fresh: EstopLatch | None) -> None:
        await sleep_ns(self._clock, ESTOP_PUBLISH_DELAY_NS)
        if fresh is not None:
            self._publisher.emit_event("estop", f"e-stop by {fresh.actor}: {fresh.reason}")
        self._publisher.publish_state()
        await self._persist_latch()

    async def _persist_latch(self) -> None:
        """Save the latch; a disk that is full takes nothing from what this process knows."""
        try:
            await self._fence.persist()
        except OSError as error:
            self._log.warning(f"the e-stop latch is not saved to disk: {error}", controller=self.controller)

    async def _make_outputs_safe(self) -> None:
        """Switch the outputs that have a safe state to it."""
        if self._status.reading is None:
            return
        for point in self._config.outputs.values():
            if point.safe is not None:
                await set_output(self._driver, point.number, on=point.safe == (point.active == "high"))

    async def handle_coordinator_loss(self, reason: str) -> None:
        """Handle a missing heartbeat of the coordinator: unload or stop, and end all leases."""
        self._leases.end_all(reason)
        await self._log_errors(self._participant.abandon_step(reason))

    def _handle_lease_end(self, holder: str, axes: list[str], reason: str) -> None:
        """Stop what the holder still moves."""
        armed_step = self._participant.armed_step
        if armed_step is not None and armed_step.job == holder:
            self._spawn_task(self._participant.abandon_step(f"{reason}: {', '.join(axes)}"))
        if self._status.homing & set(axes):
            self._spawn_task(self.stop(abort=False, reason=reason))
        self._spawn_task(self._jogging.stop_jogs_of(holder, reason))

    # Calls between the components

    def _check_step(self, request: ProposeRequest | ArmRequest) -> None:
        """Check everything that must hold before profiles are executed. Raises `Refusal`."""
        if isinstance(request, ProposeRequest) and request.rehearsal:
            self._status.require_online()
            self._require_same_digest(request)
            check_path_limits(self._status, request.profiles)
            return
        self._require_may_move(request)
        drives = request.start.drive is not None or bool(request.start.triggers)
        check_profiles(self._status, request.profiles, drives=drives)

    def _check_following_step(self, request: ProposeRequest | ArmRequest) -> None:
        """Check the same for profiles that begin where the present step ends. Raises `Refusal`."""
        self._require_may_move(request)
        check_path_limits(self._status, request.profiles)

    def _require_may_move(self, request: ProposeRequest | ArmRequest) -> None:
        self._fence.require_no_estop()
        status = self._status
        status.require_online()
        self._require_same_digest(request)
        if isinstance(request, ArmRequest):
            self._leases.require_lease(request.job, request.profiles)
        if status.homing | status.jogging:
            activity = "homing" if status.homing else "jogging"
            raise Refusal(activity, f"{min(status.homing | status.jogging)} is {activity}", "wait for its end")
        status.require_no_fault()

    def _require_same_digest(self, request: ProposeRequest | ArmRequest) -> None:
        if request.digest != self._config.digest:
            raise Refusal(
                "other-configuration",
                f"the coordinator uses configuration {request.digest}, the adapter {self._config.digest}",
                "use the same fleet file on all hosts and restart",
            )

    def replace_configuration(self, config: Controller) -> None:
        """Let the host replace this supervisor by one with another configuration."""
        self._context.replace_supervisor(self.controller, config)

    def _require_scale(self) -> FleetScale:
        scale = self._context.scale()
        if scale is None:
            raise Refusal("no-fleet-time", "no fleet time: no coordinator has been seen", "start a coordinator")
        return scale

    def _emit_step(
        self, kind: EventKind, text: str, armed_step: ArmedStep, evidence: Mapping[str, AxisEvidence] | None = None
    ) -> None:
        self._publisher.emit_event(kind, text, armed_step=armed_step, evidence=evidence)
        self._poll_wake.set()

    def _spawn_task(self, coroutine: Coroutine[Any, Any, None]) -> "asyncio.Task[None]":
        task = asyncio.get_running_loop().create_task(self._log_errors(coroutine))
        self._tasks.add(task)
        task.add_done_callback(self._handle_task_end)
        # A task that is cancelled before its first turn would leave the coroutine unstarted.
        task.add_done_callback(lambda _: coroutine.close())
        return task

    async def _log_errors(self, coroutine: Coroutine[Any, Any, None]) -> None:
        """Run `coroutine` and log its errors: link supervision handles what goes wrong in the background."""
        try:
            await coroutine
        except (LinkClosed, LinkRefused, ControllerFault, Refusal) as error:
            self._log.warning(f"in the background: {error}", controller=self.controller)

    def _handle_task_end(self, task: "asyncio.Task[None]") -> None:
        self._tasks.discard(task)
        if not task.cancelled() and isinstance(error := task.exception(), Exception):
            self.handle_defect(error)

    def handle_defect(self, error: Exception) -> FaultReport:
        """Handle an error that nothing expected, in a task or a command of this controller: what the adapter believes
        may be wrong, so it gives up the link and begins anew. Returns the fault."""
        fault = self._defects.note_defect(error)
        self._defects.must_reconnect = True
        self._poll_wake.set()
        return fault
