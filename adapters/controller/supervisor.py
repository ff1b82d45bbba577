"""One controller on the bus: its link kept alive, polled, and its parts put together.

Everything here is common to all makes; the make is behind `Driver`.
"""

import asyncio
from collections.abc import Coroutine, Mapping
from typing import Any
from zlib import crc32

from pydantic import ValidationError

from adapters.contract import CannotDo, DriverFault, Reading
from adapters.controller.commands import Commands, Parts
from adapters.controller.context import Seat
from adapters.controller.fencing import Fence
from adapters.controller.jogging import Jogging
from adapters.controller.leases import Leases
from adapters.controller.limits import check_profiles
from adapters.controller.motors import Motors
from adapters.controller.participant import Member, Phase, Ticket
from adapters.controller.publisher import Presenter
from adapters.controller.referencing import Referencing
from adapters.controller.settling import Settling
from adapters.controller.status import Condition
from adapters.controller.store import Remembered
from orchestrator.bus.base import Declared, Handler
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.fleet import FleetScale
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import Arm, Propose
from orchestrator.model.state import AxisEvidence, ControllerState, EstopLatch, EventKind, Fault

BACKOFF_FIRST_NS = 200 * NS_PER_MS
BACKOFF_LONGEST_NS = 5 * NS_PER_S
TOLD_NS = 30 * NS_PER_MS  # after an e-stop, to people and to the disk: first all units of the host are to stop
BEGUN_NS = 300 * NS_PER_MS  # after T0: by then it can be seen whether somebody moves
BEAT_NS = 400 * NS_PER_MS  # who says nothing for 0.7 s is believed dead
POLLS_APART = 0.08  # of their period
STOP_LEAVES_NS = 150 * NS_PER_MS  # for a stop's bytes to be sent and answered before its link is closed


class Unit:
    """Runs the controller of `seat`; its e-stop latch and epoch are `remembered`."""

    def __init__(self, seat: Seat, remembered: Remembered) -> None:
        self.controller = seat.controller
        self._seat = seat
        self._config, self._driver = seat.config, seat.driver
        self._bus, self._keys, self._clock, self._log = seat.bus, seat.keys, seat.clock, seat.log
        self._fence = Fence(remembered)
        self._condition = Condition(seat.config)
        driver, condition = seat.driver, self._condition
        self._leases = Leases(seat.config, seat.clock, lambda: driver.capabilities.independent_axes, self._lease_ended)
        self._settling = Settling(seat.clock, condition, self.refresh)
        self._member = Member(
            seat.controller,
            seat.driver,
            seat.clock,
            self._check,
            self._require_scale,
            self._emit_step,
            self._settling.wait,
            self._spawn,
            seat.lowering,
        )
        self._presenter = Presenter(
            seat,
            self._fence,
            remembered,
            condition,
            lambda: self._member.ticket,
            lambda: self._member.following,
            lambda: self._leases.holders,
        )
        self._jogging = Jogging(driver, seat.clock, condition, self._spawn, self.poke)
        self._motors = Motors(driver, seat.clock, condition, self._settling, self.refresh)
        self._referencing = Referencing(driver, self._settling, condition, self._presenter.emit, self.refresh)
        parts = Parts(
            fence=self._fence,
            remembered=remembered,
            leases=self._leases,
            member=self._member,
            jogging=self._jogging,
            motors=self._motors,
            referencing=self._referencing,
            condition=condition,
            presenter=self._presenter,
        )
        self._commands = Commands(seat, parts, self)
        self._stop_owed = False
        # What has brought sixteen controllers to rest together must not have all of them read together ever after.
        self._apart = 1.0 + POLLS_APART * (crc32(seat.controller.encode()) % 64) / 64
        self._met = False
        self._poke = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()
        self._declared: list[Declared] = []

    # Life

    async def start(self) -> None:
        """Take the controller's place on the bus; come up latched if any other controller of the fleet is."""
        self._declared = [
            *await self._presenter.serve(),
            await self._bus.serve(self._keys.cmd(self.controller), self._commands.answer),
        ]
        await self._take_over_latch()
        self._declared.append(
            await self._bus.announce(self._keys.live("controller", self.controller, self._seat.instance))
        )
        self._spawn(self._live())

    async def close(self) -> None:
        """Leave the bus and the link. The controller is left as it is."""
        declared, self._declared = self._declared, []
        for each in declared:
            await each.undeclare()
        for task in list(self._tasks):
            task.cancel()
        await self._driver.close()

    @property
    def answer(self) -> Handler | None:
        """What answers its commands; None while it has no place on the bus."""
        return self._commands.answer if self._declared else None

    async def _take_over_latch(self) -> None:
        replies = await self._bus.request_all(self._keys.state(), b"", timeout_s=1.0)
        for key in sorted(replies):
            try:
                state = ControllerState.model_validate_json(replies[key])
            except ValidationError:
                continue
            if state.estop is not None and state.controller != self.controller:
                self._fence.latch_estop(state.estop)
        await self._fence.keep()

    async def _live(self) -> None:
        """Reach the controller, serve it until the link breaks, and again, with growing pauses."""
        self._spawn(self._beat())
        pause_ns = BACKOFF_FIRST_NS
        while True:
            try:
                await self._reach()
                await self._driver.configure()
                await self._referencing.load_limits(list(self._config.axes))
                pause_ns = 0
                await self._serve()
            except LinkRefused as error:
                self._offline(Fault(code="link-refused", text=str(error), remedy="check power, cable and address"))
            except LinkClosed as error:
                self._offline(Fault(code="link-closed", text=str(error), remedy="check the cable; it is tried again"))
            except DriverFault as error:
                self._offline(error.fault)
            except CannotDo as error:
                self._offline(Fault(code=error.refusal.code, text=error.refusal.text, remedy=error.refusal.remedy))
            await self._driver.close()
            if pause_ns or not self._stop_owed:
                # What was loaded when the link broke may be about to begin: its stop is tried at once.
                await sleep_ns(self._clock, max(pause_ns, BACKOFF_FIRST_NS))
            pause_ns = min(max(2 * pause_ns, BACKOFF_FIRST_NS), BACKOFF_LONGEST_NS)

    async def _reach(self) -> None:
        """Meet the controller. An owed stop is written before, and again to who has answered."""
        owed, self._stop_owed = self._stop_owed, False
        try:
            if owed:
                await self._pay_owed_stop()
            self._condition.identity = await self._driver.connect()
            if owed:
                # Written before, it was quick; but the line may have come back only after it.
                await self._driver.stop(False)
        except BaseException:
            self._stop_owed = self._stop_owed or owed
            raise
        if owed:
            self._presenter.emit("stopped", "stopped as soon as the link was back")

    async def _pay_owed_stop(self) -> None:
        """The link broke while a step was loaded, or before a stop could be sent: the controller may be moving.

        It is stopped before anything else is asked of it, as a guardian would.
        """
        await self._member.loaded()
        if not await self._driver.stop_first():
            link = await self._seat.open_link()
            try:
                link.write(self._seat.make.stop_bytes(self._config))
                await sleep_ns(self._clock, STOP_LEAVES_NS)
            finally:
                await link.close()

    async def _serve(self) -> None:
        """Poll and publish until the link breaks or the controller stops making sense."""
        self._condition.faults = []
        self._met = True
        await self.refresh()
        identity = self._condition.identity
        self._presenter.emit("online", f"{self._seat.make.name} {identity.firmware if identity else ''}".strip())
        while True:
            await self._next_poll()
            await self.refresh()

    async def _next_poll(self) -> None:
        """Wait for the next poll: the fleet file's rate, sooner when poked, never in the quiet time before T0."""
        rates, ticket = self._config.state, self._member.ticket
        about_to_move = ticket is not None and ticket.phase is Phase.RELEASED
        period_s = 1.0 / rates.moving_hz if about_to_move or self.moves else self._apart / rates.idle_hz
        timer = asyncio.get_running_loop().call_later(period_s, self._poke.set)
        try:
            await self._poke.wait()
        finally:
            timer.cancel()
        self._poke.clear()
        while (until_ns := self._quiet_until_ns()) is not None:
            # A stop ends the quiet, and pokes; so does a jog that begins.
            alarm = self._clock.call_at_ns(until_ns + NS_PER_MS, self._poke.set)
            try:
                await self._poke.wait()
            finally:
                alarm.cancel()
            self._poke.clear()

    def _quiet_until_ns(self) -> int | None:
        """Until when it is not polled; None: it is. Who is moved by hand is watched, whatever else is asked of it."""
        by_hand = self._condition.jogging or self._condition.homing
        return None if by_hand else self._member.quiet_until_ns()

    async def _beat(self) -> None:
        """The adapter's heartbeat while its controller is not polled: it is out of reach, its line is taken, or the
        fleet file has it polled seldom.

        Not in motion: nobody is to believe that all is well there who has not seen it.
        """
        while True:
            wait_ns = self._presenter.published_ns + BEAT_NS - self._clock.now_ns()
            if wait_ns <= 0:
                ticket = self._member.ticket
                waits = ticket is not None and self._clock.now_ns() < ticket.t0_host_ns
                if waits or self._presenter.mode() != "moving":
                    self._presenter.publish()
                wait_ns = BEAT_NS
            await sleep_ns(self._clock, wait_ns)

    def poke(self) -> None:
        """Poll soon: something has begun or ended."""
        self._poke.set()

    # What polls show

    async def refresh(self) -> None:
        """Read the controller and publish what is new. Raises `LinkClosed` until it has been met: while it is, it
        answers, but what it is loaded with is not ours."""
        reading = await self._driver.poll() if self._met else None
        # It may have been lost while the poll waited for its turn on the line.
        if reading is None or not self._met:
            raise LinkClosed("the controller is still to be met")
        self._take(reading)
        self._presenter.publish()

    def _take(self, reading: Reading) -> None:
        """Compare a fresh reading with the last one, and say what has changed."""
        condition = self._condition
        before, condition.reading = condition.reading, reading
        condition.may_move = False
        unreferenced = self._referencing.look(reading)
        if reading.restarted:
            self._presenter.emit("fault", "the controller was restarted; its axes are not referenced any more")
            self._member.lost("the controller was restarted")
            self._jogging.ended_all("the controller was restarted")
        if unreferenced or reading.restarted:
            self._spawn(self._referencing.load_limits(list(self._config.axes)))
        self._jogging.look(reading)
        for name, now in reading.axes.items():
            old = before.axes[name].limit if before is not None else "none"
            if now.limit not in ("none", old):
                self._presenter.emit("limit", f"axis {name} is on its {now.limit} limit switch")
        for name, point in self._config.inputs.items():
            level = reading.inputs.get(point.number)
            if before is not None and before.inputs.get(point.number) != level:
                active = level == (point.active == "high")
                self._presenter.emit("input", f"input {name} is {'active' if active else 'inactive'}")
        faults = [*reading.faults, *self._settling.faults(reading)]
        known = {(fault.code, fault.axis) for fault in condition.faults}
        for fault in faults:
            if (fault.code, fault.axis) not in known:
                self._presenter.emit("fault", fault.text, fault=fault)
        if condition.faults and not faults:
            self._presenter.emit("cleared", "no fault any more")
        condition.faults = faults
        if faults and condition.jogging:
            self._spawn(self._jogging.stop(sorted(condition.jogging), faults[0].text))
        trouble = self._trouble_in_motion(before, reading)
        if trouble is not None:
            self._spawn(self._member.fail(trouble))
        self._see_to_the_stop(reading)

    def _see_to_the_stop(self, reading: Reading) -> None:
        """Told to stop is not stopped: on a line that was broken for a moment it was told in vain. Who still moves when
        it should long have come to rest, and for nobody, is told again."""
        condition = self._condition
        if not condition.stop_unseen or reading.at_ns < condition.stopped_ns:
            return
        if not any(axis.moving for axis in reading.axes.values()):
            # Who was loaded when the stop was lost begins in spite of it.
            condition.stop_unseen = reading.at_ns < condition.begun_by_ns
            return
        owned = self._member.ticket is not None or bool(condition.jogging | condition.homing)
        if not owned and reading.at_ns > condition.stopping_until_ns:
            self._log.warning("it moves although it was told to stop; told again", controller=self.controller)
            self._spawn(self.stop(False, "it was told to stop before"))

    def _trouble_in_motion(self, before: Reading | None, reading: Reading) -> str | None:
        """What this poll shows that a moving step can not go on with; one axis in trouble is trouble for all."""
        ticket = self._member.ticket
        if ticket is None or ticket.phase is not Phase.MOVING or before is None:
            return None
        if self._condition.faults:
            return self._condition.faults[0].text
        for name in ticket.axes:
            now, old = reading.axes[name], before.axes[name]
            if now.lost and not old.lost:
                return f"axis {name} has lost its position"
            # A switch that was active from the start is being left.
            if now.limit not in ("none", old.limit):
                return f"axis {name} has run into its {now.limit} limit switch"
            if old.enabled and not now.enabled:
                return f"the motor of axis {name} has switched off"
        return None

    def _offline(self, fault: Fault) -> None:
        condition, member = self._condition, self._member
        self._met = False
        before, condition.reading = condition.reading, None
        was_online = before is not None
        condition.faults = [fault]
        # Told to stop is not stopped: what it was told may have been lost with the link.
        unseen = before is not None and (
            before.at_ns < condition.stopped_ns or any(axis.moving for axis in before.axes.values())
        )
        # A move that waits for a line does so before its member is armed.
        loaded = member.ticket is not None or member.following or member.loading or member.stop_owed
        may_move = unseen or loaded or bool(condition.jogging | condition.homing)
        condition.may_move = condition.may_move or may_move
        self._stop_owed = self._stop_owed or may_move
        condition.homing.clear()
        self._jogging.ended_all("the link is lost")
        self._member.lost(f"the link is lost: {fault.text}")
        if was_online:
            self._presenter.emit("offline", fault.text, fault=fault)
        self._log.warning(fault.text, controller=self.controller, code=fault.code)

    # Stops, past everything else

    async def stop(self, abort: bool, reason: str, follow: bool = False) -> None:
        """Stop the controller for whatever reason; nothing that is loaded starts afterwards. follow: a step that moves
        is followed to its rest."""
        condition = self._condition
        condition.stopped_ns = self._clock.now_ns()
        stop_ns = max(self._driver.capabilities.costs.stop_ns, self._member.stop_ns)
        condition.stopping_until_ns = condition.stopped_ns + stop_ns
        condition.stop_unseen = True
        ticket = self._member.ticket
        if ticket is not None:
            condition.begun_by_ns = ticket.t0_host_ns + BEGUN_NS
        self._jogging.ended_all(reason)
        try:
            await self._member.stop(abort, reason, follow)
        except (LinkClosed, LinkRefused, DriverFault):
            self._stop_owed = True
            raise
        finally:
            self._poke.set()

    @property
    def moves(self) -> bool:
        """Whether it moves anything, as far as is known."""
        return self._presenter.mode() in ("moving", "jogging", "homing", "stopping")

    async def estop(self, latch: EstopLatch) -> None:
        """Latch and stop as fast as the controller can; then outputs and motors go where they are safe."""
        fresh = self._fence.latch_estop(latch)
        self._spawn(self._tell_latch(latch if fresh else None))
        await self._survive(self.stop(True, f"e-stop {latch.event} by {latch.actor}"))
        await self._survive(self._make_outputs_safe())
        await self._survive(self._motors.after_estop())

    async def _tell_latch(self, fresh: EstopLatch | None) -> None:
        await sleep_ns(self._clock, TOLD_NS)
        if fresh is not None:
            self._presenter.emit("estop", f"e-stop by {fresh.actor}: {fresh.reason}")
        self._presenter.publish()
        try:
            await self._fence.keep()
        except OSError as error:
            self._log.warning(f"the e-stop's latch is not on disk: {error}", controller=self.controller)

    async def _make_outputs_safe(self) -> None:
        """Take the outputs that have a safe state to it."""
        if self._condition.reading is None:
            return
        for point in self._config.outputs.values():
            if point.safe is not None:
                await self._driver.set_output(point.number, point.safe == (point.active == "high"))

    async def coordinator_lost(self, reason: str) -> None:
        """No heartbeat of the coordinator: unload or stop; nobody holds anything any more."""
        self._leases.drop(reason)
        await self._survive(self._member.abandon(reason))

    def _lease_ended(self, holder: str, axes: list[str], reason: str) -> None:
        """What the holder still moves is stopped."""
        ticket = self._member.ticket
        if ticket is not None and ticket.job == holder:
            self._spawn(self._member.abandon(f"{reason}: {', '.join(axes)}"))
        if self._condition.homing & set(axes):
            self._spawn(self.stop(False, reason))
        self._spawn(self._jogging.stop_holder(holder, reason))

    # What the parts ask of each other

    def _check(self, request: Propose | Arm) -> None:
        """Everything that must hold before profiles are executed. Raises `CannotDo`."""
        self._fence.require_no_estop()
        condition = self._condition
        condition.online()
        if request.digest != self._config.digest:
            raise CannotDo(
                "other-configuration",
                f"the coordinator believes in configuration {request.digest}, the adapter has {self._config.digest}",
                "use one fleet file on all hosts and restart",
            )
        if isinstance(request, Arm):
            self._leases.require(request.job, request.profiles)
        if condition.homing | condition.jogging:
            doing = "homing" if condition.homing else "jogging"
            raise CannotDo(doing, f"{min(condition.homing | condition.jogging)} is {doing}", "wait for its end")
        condition.require_no_fault()
        check_profiles(condition, request.profiles, request.start.drive is not None)

    def reconfigure(self, config: Controller) -> None:
        """The host replaces this unit by one with another configuration."""
        self._seat.reconfigure(self.controller, config)

    def _require_scale(self) -> FleetScale:
        scale = self._seat.scale()
        if scale is None:
            raise CannotDo("no-fleet-time", "no coordinator's time is known here", "start a coordinator")
        return scale

    def _emit_step(
        self, kind: EventKind, text: str, ticket: Ticket, evidence: Mapping[str, AxisEvidence] | None = None
    ) -> None:
        self._presenter.emit(kind, text, ticket=ticket, evidence=evidence)
        self._poke.set()

    def _spawn(self, coroutine: Coroutine[Any, Any, None]) -> "asyncio.Task[None]":
        task = asyncio.get_running_loop().create_task(self._survive(coroutine))
        self._tasks.add(task)
        task.add_done_callback(self._ended)
        # A task that is cancelled before its first turn leaves it unbegun.
        task.add_done_callback(lambda _: coroutine.close())
        return task

    async def _survive(self, coroutine: Coroutine[Any, Any, None]) -> None:
        """What the controller does wrong in the background is said, and met by the link's own supervision."""
        try:
            await coroutine
        except (LinkClosed, LinkRefused, DriverFault, CannotDo) as error:
            self._log.warning(f"in the background: {error}", controller=self.controller)

    def _ended(self, task: "asyncio.Task[None]") -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            self._log.warning(f"a defect of the adapter: {error!r}", controller=self.controller)
            asyncio.get_running_loop().call_exception_handler({"message": "unit task failed", "exception": error})
