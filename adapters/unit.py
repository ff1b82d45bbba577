"""One controller on the bus: its link kept alive, its state published, its commands answered.

Everything here is common to all makes; the make is behind `Driver`.
"""

import asyncio
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from typing import Any, TypeVar

from pydantic import ValidationError

from adapters.contract import CannotDo, Driver, DriverFault, Identity, Make, Reading
from adapters.events import EventRing
from adapters.fence import Fence
from adapters.guard import check_profiles
from adapters.member import Member, Phase, Ticket
from adapters.store import Store
from orchestrator.bus.base import Bus, Declared, Priority, RequestRefused, Sample
from orchestrator.bus.keys import Keys
from orchestrator.bus.log import Log
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns, sleep_until_ns
from orchestrator.clock.fleet import FleetScale
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.link.trace import Direction, TraceRing
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import (
    Adopt,
    Adopted,
    Arm,
    Armed,
    AxesRequest,
    Commit,
    Disarm,
    EnableRequest,
    Fenced,
    Go,
    HomeRequest,
    OutputRequest,
    Proposal,
    Propose,
    Raw,
    RawReply,
    Refusal,
    Reply,
    Request,
    Reset,
    Stop,
    TraceReply,
)
from orchestrator.model.state import (
    AxisEvidence,
    AxisState,
    ClockQuality,
    ControllerState,
    EstopLatch,
    Event,
    EventKind,
    EventsRequest,
    Fault,
    Info,
    Mode,
)

BACKOFF_FIRST_NS = 200 * NS_PER_MS
BACKOFF_LONGEST_NS = 5 * NS_PER_S
ANSWERS_KEPT = 256

R = TypeVar("R", bound=Request)


class Unit:
    """Runs one controller. `scale` gives fleet time, or None before any coordinator was heard."""

    def __init__(
        self,
        controller: str,
        config: Controller,
        make: Make,
        driver: Driver,
        bus: Bus,
        keys: Keys,
        clock: Clock,
        store: Store,
        trace: TraceRing,
        log: Log,
        instance: str,
        scale: Callable[[], FleetScale | None],
    ) -> None:
        self.controller = controller
        self._config = config
        self._make = make
        self._driver = driver
        self._bus = bus
        self._keys = keys
        self._clock = clock
        self._trace = trace
        self._log = log
        self._instance = instance
        self._scale = scale
        self._fence = Fence(store)
        self._events = EventRing(instance)
        self._member = Member(
            controller, driver, clock, self._check, self._require_scale, self._emit_step, self._refresh, self._spawn
        )
        self._identity: Identity | None = None
        self._reading: Reading | None = None
        self._referenced = dict.fromkeys(config.axes, False)
        self._homing: set[str] = set()
        self._faults: list[Fault] = [
            Fault(code="starting", text="the adapter has not reached the controller yet", remedy="wait")
        ]
        self._stopping_until_ns = 0
        self._state_seq = 0
        self._poke = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()
        self._answers: OrderedDict[str, asyncio.Task[Reply]] = OrderedDict()
        self._declared: list[Declared] = []
        self._verbs: dict[str, tuple[type[Request], Callable[[Any], Awaitable[Reply]]]] = {
            "adopt": (Adopt, self._adopt),
            "propose": (Propose, self._propose),
            "arm": (Arm, self._arm),
            "commit": (Commit, self._commit),
            "go": (Go, self._go),
            "disarm": (Disarm, self._disarm),
            "stop": (Stop, self._stop),
            "enable": (EnableRequest, self._enable),
            "home": (HomeRequest, self._home),
            "output": (OutputRequest, self._output),
            "reset": (Reset, self._reset),
            "raw": (Raw, self._raw),
            "trace": (Request, self._give_trace),
        }

    # Life

    async def start(self) -> None:
        """Take the controller's place on the bus; come up latched if any other controller of the fleet is."""
        keys, bus = self._keys, self._bus
        self._declared = [
            await bus.serve(keys.state(self.controller), self._answer_state),
            await bus.serve(keys.event(self.controller), self._answer_events),
            await bus.serve(keys.info(self.controller), self._answer_info),
            await bus.serve(keys.cmd(self.controller), self._answer_command),
        ]
        await self._take_over_latch()
        self._declared.append(await bus.announce(keys.live("controller", self.controller, self._instance)))
        self._spawn(self._live())

    async def close(self) -> None:
        """Leave the bus and the link. What is armed is unloaded; what moves is left moving."""
        for declared in self._declared:
            await declared.undeclare()
        for task in list(self._tasks):
            task.cancel()
        await self._driver.close()

    async def _take_over_latch(self) -> None:
        replies = await self._bus.request_all(self._keys.state(), b"", timeout_s=1.0)
        for key in sorted(replies):
            try:
                state = ControllerState.model_validate_json(replies[key])
            except ValidationError:
                continue
            if state.estop is not None and state.controller != self.controller:
                self._fence.latch_estop(state.estop)

    async def _live(self) -> None:
        """Reach the controller, serve it until the link breaks, and again, with growing pauses."""
        pause_ns = BACKOFF_FIRST_NS
        while True:
            heartbeat = self._spawn(self._beat_offline())
            try:
                self._identity = await self._driver.connect()
                await self._driver.configure()
                pause_ns = BACKOFF_FIRST_NS
                heartbeat.cancel()
                await self._serve()
            except LinkRefused as error:
                self._offline(Fault(code="link-refused", text=str(error), remedy="check power, cable and address"))
            except LinkClosed as error:
                self._offline(Fault(code="link-closed", text=str(error), remedy="check the cable; it is tried again"))
            except DriverFault as error:
                self._offline(error.fault)
            except CannotDo as error:
                self._offline(Fault(code=error.refusal.code, text=error.refusal.text, remedy=error.refusal.remedy))
            heartbeat.cancel()
            await self._driver.close()
            self._publish()
            heartbeat = self._spawn(self._beat_offline())
            await sleep_ns(self._clock, pause_ns)
            heartbeat.cancel()
            pause_ns = min(2 * pause_ns, BACKOFF_LONGEST_NS)

    async def _serve(self) -> None:
        """Poll and publish until the link breaks or the controller stops making sense."""
        self._faults = []
        self._take(await self._driver.poll())
        self._emit("online", f"{self._make.name} {self._identity.firmware if self._identity else ''}".strip())
        self._publish()
        while True:
            await self._next_poll()
            self._take(await self._driver.poll())
            self._publish()

    async def _next_poll(self) -> None:
        """Wait for the next poll: the fleet file's rate, sooner when poked, never in the quiet time before T0."""
        rates = self._config.state
        hz = rates.moving_hz if self._mode() in ("moving", "homing", "stopping") else rates.idle_hz
        try:
            async with asyncio.timeout(1.0 / hz):
                await self._poke.wait()
        except TimeoutError:
            pass
        self._poke.clear()
        while (until_ns := self._member.quiet_until_ns()) is not None:
            await sleep_until_ns(self._clock, until_ns + NS_PER_MS)

    async def _beat_offline(self) -> None:
        """The heartbeat of an adapter whose controller can not be polled."""
        while True:
            self._publish()
            await sleep_ns(self._clock, round(NS_PER_S / self._config.state.idle_hz))

    def _offline(self, fault: Fault) -> None:
        was_online = self._reading is not None
        self._reading = None
        self._faults = [fault]
        self._homing.clear()
        self._member.lost(f"the link is lost: {fault.text}")
        if was_online:
            self._emit("offline", fault.text, fault=fault)
        self._log.warning(fault.text, controller=self.controller, code=fault.code)

    def _take(self, reading: Reading) -> None:
        """Compare a fresh reading with the last one, and say what has changed."""
        before, self._reading = self._reading, reading
        if reading.restarted:
            self._referenced = dict.fromkeys(self._referenced, False)
            self._emit("fault", "the controller was restarted; its axes are not referenced any more")
            self._member.lost("the controller was restarted")
        for name, now in reading.axes.items():
            old = before.axes[name].limit if before is not None else "none"
            if now.limit not in ("none", old):
                self._emit("limit", f"axis {name} is on its {now.limit} limit switch")
        codes = {fault.code for fault in self._faults}
        for fault in reading.faults:
            if fault.code not in codes:
                self._emit("fault", fault.text, fault=fault)
        if self._faults and not reading.faults:
            self._emit("cleared", "no fault any more")
        self._faults = list(reading.faults)

    # What everybody may know

    def _mode(self) -> Mode:
        if self._reading is None:
            return "offline"
        ticket = self._member.ticket
        if ticket is not None:
            return "moving" if ticket.phase in (Phase.RELEASED, Phase.MOVING) else ticket.phase.value
        if self._homing:
            return "homing"
        if any(axis.moving for axis in self._reading.axes.values()):
            return "stopping" if self._clock.now_ns() < self._stopping_until_ns else "moving"
        return "fault" if self._faults else "idle"

    def _state(self) -> ControllerState:
        reading, ticket = self._reading, self._member.ticket
        axes = {name: self._axis_state(name, reading) for name in self._config.axes}
        named = self._named_points(reading)
        return ControllerState(
            controller=self.controller,
            instance=self._instance,
            seq=self._state_seq,
            utc=self._clock.utc(),
            fleet_ns=self._fleet_ns(),
            mode=self._mode(),
            axes=axes,
            inputs=named[0],
            outputs=named[1],
            faults=self._faults,
            clock=self._clock_quality(),
            estop=self._fence.latch,
            epoch=self._fence.epoch,
            digest=self._config.digest,
            job=ticket.job if ticket else None,
            step=ticket.step if ticket else None,
        )

    def _axis_state(self, name: str, reading: Reading | None) -> AxisState:
        axis = self._config.axes[name]
        if reading is None:
            return AxisState(
                position=0.0,
                commanded=0.0,
                velocity=0.0,
                commanded_counts=0,
                unit=axis.unit,
                moving=False,
                enabled=False,
                referenced=False,
            )
        now = reading.axes[name]
        return AxisState(
            position=axis.to_unit(now.actual_counts),
            commanded=axis.to_unit(now.commanded_counts),
            velocity=axis.to_unit(now.velocity_counts_s),
            commanded_counts=now.commanded_counts,
            unit=axis.unit,
            moving=now.moving,
            enabled=now.enabled,
            referenced=self._referenced[name],
            limit=now.limit,
            fault=next((fault.code for fault in reading.faults if fault.axis == name), None),
        )

    def _named_points(self, reading: Reading | None) -> tuple[dict[str, bool], dict[str, bool]]:
        if reading is None:
            return {}, {}
        config = self._config
        inputs = {n: reading.inputs.get(p.number, False) == (p.active == "high") for n, p in config.inputs.items()}
        outputs = {n: reading.outputs.get(p.number, False) == (p.active == "high") for n, p in config.outputs.items()}
        return inputs, outputs

    def _clock_quality(self) -> ClockQuality | None:
        mapping = self._driver.mapping() if self._reading is not None else None
        if mapping is None:
            return None
        now_ns = self._clock.now_ns()
        return ClockQuality(
            bound_ns=mapping.bound_at_ns(now_ns), age_ns=max(0, now_ns - mapping.host_at_ns), samples=mapping.samples
        )

    def _publish(self) -> None:
        self._state_seq += 1
        self._bus.put(self._keys.state(self.controller), self._state().to_json(), Priority.STATE)
        mapping = self._driver.mapping() if self._reading is not None else None
        # The mapping moves slowly: once in ten states is plenty for those who watch it.
        if mapping is not None and self._state_seq % 10 == 0:
            shown = self._member.clock_mapping(mapping)
            if shown is not None:
                self._bus.put(self._keys.clock(self.controller), shown.to_json(), Priority.STATE)

    def _emit(
        self,
        kind: EventKind,
        text: str,
        *,
        ticket: Ticket | None = None,
        evidence: Mapping[str, AxisEvidence] | None = None,
        fault: Fault | None = None,
    ) -> None:
        event = Event(
            controller=self.controller,
            instance=self._instance,
            seq=self._events.last_seq + 1,
            utc=self._clock.utc(),
            fleet_ns=self._fleet_ns(),
            kind=kind,
            text=text,
            job=ticket.job if ticket else None,
            step=ticket.step if ticket else None,
            evidence=dict(evidence or {}),
            fault=fault,
        )
        self._events.add(event)
        self._bus.put(self._keys.event(self.controller), event.to_json(), Priority.EVENT)
        self._log.info(
            text, controller=self.controller, kind=kind, job=event.job, step=event.step, epoch=self._fence.epoch
        )
        if kind in ("fault", "failed", "offline"):
            self._log.info("the last bytes on the link", controller=self.controller, trace=self._trace.tail_text())

    def _emit_step(
        self, kind: EventKind, text: str, ticket: Ticket, evidence: Mapping[str, AxisEvidence] | None = None
    ) -> None:
        self._emit(kind, text, ticket=ticket, evidence=evidence)
        self._poke.set()

    def _fleet_ns(self) -> int | None:
        scale = self._scale()
        return None if scale is None else scale.fleet_ns(self._clock.now_ns())

    async def _answer_state(self, _: Sample) -> bytes:
        return self._state().to_json()

    async def _answer_events(self, sample: Sample) -> bytes:
        try:
            request = EventsRequest.model_validate_json(sample.payload)
        except ValidationError as error:
            raise RequestRefused(_explain(error)) from None
        return self._events.after(request.after).to_json()

    async def _answer_info(self, _: Sample) -> bytes:
        identity, capabilities = self._identity, self._driver.capabilities
        return Info(
            controller=self.controller,
            instance=self._instance,
            make=self._make.name,
            model=identity.model if identity else "",
            firmware=identity.firmware if identity else "",
            serial=identity.serial if identity else "",
            axes={name: axis.to_plain() for name, axis in self._config.axes.items()},
            start_classes=list(capabilities.start_classes),
            orders=list(capabilities.orders),
            independent_axes=capabilities.independent_axes,
            costs=capabilities.costs,
            digest=self._config.digest,
            options_schema=self._make.options.model_json_schema(),
        ).to_json()

    # Commands

    async def _answer_command(self, sample: Sample) -> bytes:
        """Answer one command. A request id that was seen already gets the same answer, without doing it again."""
        verb = self._keys.verb_of(sample.key)
        if verb not in self._verbs:
            raise RequestRefused(f"unknown verb {verb!r}; known: {', '.join(sorted(self._verbs))}")
        model, handler = self._verbs[verb]
        try:
            request = model.model_validate_json(sample.payload)
        except ValidationError as error:
            raise RequestRefused(f"{verb}: {_explain(error)}") from None
        task = self._answers.get(request.request_id)
        if task is None:
            task = asyncio.get_running_loop().create_task(self._do(verb, handler, request))
            self._answers[request.request_id] = task
            while len(self._answers) > ANSWERS_KEPT:
                self._answers.popitem(last=False)
        return (await asyncio.shield(task)).to_json()

    async def _do(self, verb: str, handler: Callable[[Any], Awaitable[Reply]], request: Request) -> Reply:
        try:
            if isinstance(request, Fenced) and not isinstance(request, Adopt):
                self._fence.admit(request)
            return await handler(request)
        except CannotDo as error:
            refusal = error.refusal
        except DriverFault as error:
            fault = error.fault
            refusal = Refusal(code=fault.code, text=fault.text, remedy=fault.remedy)
        except (LinkClosed, LinkRefused) as error:
            refusal = Refusal(code="offline", text=str(error), remedy="check power and cable of the controller")
        self._emit("refusal", f"{verb} by {request.actor}: {refusal.text}")
        return _REPLY_OF.get(verb, Reply)(refused=refusal.model_copy(update={"member": self.controller}))

    async def _adopt(self, request: Adopt) -> Reply:
        if self._fence.adopt(request):
            await self._member.abandon(f"a new reign, epoch {request.epoch}")
        self._publish()
        return Adopted(epoch=self._fence.epoch, mode=self._mode())

    async def _propose(self, request: Propose) -> Reply:
        return await self._member.propose(request)

    async def _arm(self, request: Arm) -> Reply:
        return await self._member.arm(request)

    async def _commit(self, request: Commit) -> Reply:
        self._fence.require_no_estop()
        return await self._member.commit(request)

    async def _go(self, request: Go) -> Reply:
        self._fence.require_no_estop()
        return await self._member.go(request)

    async def _disarm(self, request: Disarm) -> Reply:
        return await self._member.disarm(request)

    async def _stop(self, request: Stop) -> Reply:
        await self.stop(request.mode == "abort", request.reason or f"stopped by {request.actor}")
        return Reply()

    async def stop(self, abort: bool, reason: str) -> None:
        """Stop the controller for whatever reason, past everything else."""
        self._stopping_until_ns = self._clock.now_ns() + self._driver.capabilities.costs.stop_ns
        try:
            await self._member.stop(abort, reason)
        finally:
            self._poke.set()

    async def _enable(self, request: EnableRequest) -> Reply:
        self._require_idle(request)
        if request.on:
            self._fence.require_no_estop()
        await self._driver.enable(request.axes, request.on)
        await self._refresh()
        return Reply()

    async def _home(self, request: HomeRequest) -> Reply:
        self._require_idle(request)
        self._fence.require_no_estop()
        reading = self._online()
        for name in request.axes:
            if not reading.axes[name].enabled:
                raise CannotDo("not-enabled", f"axis {name} is not enabled", f"enable {name} first: `do: enable`")
            self._referenced[name] = False
        self._homing.update(request.axes)
        longest_s = max(self._config.axes[name].homing.timeout_s for name in request.axes)
        self._poke.set()
        try:
            async with asyncio.timeout(longest_s):
                await self._driver.home(request.axes)
        except TimeoutError:
            await self._driver.stop(False)
            names = ", ".join(request.axes)
            raise CannotDo(
                "homing-timeout", f"no reference found for {names} within {longest_s:g} s", "look at the home switch"
            ) from None
        finally:
            self._homing.difference_update(request.axes)
        await self._refresh()
        if self._reading is None or self._reading.restarted:
            raise CannotDo("restarted", "the controller was lost while homing", "home again")
        self._referenced.update(dict.fromkeys(request.axes, True))
        self._publish()
        return Reply()

    async def _output(self, request: OutputRequest) -> Reply:
        point = self._config.outputs.get(request.output)
        if point is None:
            raise CannotDo(
                "unknown-output", f"no output {request.output}; outputs: {', '.join(self._config.outputs) or 'none'}"
            )
        self._online()
        await self._driver.set_output(point.number, request.value == (point.active == "high"))
        await self._refresh()
        return Reply()

    async def _reset(self, request: Reset) -> Reply:
        released = self._fence.release(request.event)
        if self._reading is not None:
            await self._driver.clear_faults()
            await self._refresh()
        if released:
            self._emit("reset", f"e-stop reset by {request.actor}")
        self._publish()
        return Reply()

    async def _raw(self, request: Raw) -> Reply:
        if not request.i_know:
            raise CannotDo("raw-needs-flag", "a raw command is checked against no limit", "add --i-know if you mean it")
        self._online()
        self._emit("raw", f"raw by {request.actor}: {request.command!r}")
        return RawReply(reply=await self._driver.raw(request.command))

    async def _give_trace(self, _: Request) -> Reply:
        entries: list[tuple[int, Direction, str]] = [
            (at_ns, direction, data.decode("latin-1")) for at_ns, direction, data in self._trace.entries()
        ]
        return TraceReply(entries=entries, utc=self._clock.utc(), host_ns=self._clock.now_ns())

    # What the host hears for all its units

    async def estop(self, latch: EstopLatch) -> None:
        """Latch and stop as fast as the controller can."""
        fresh = self._fence.latch_estop(latch)
        await self._survive(self.stop(True, f"e-stop {latch.event} by {latch.actor}"))
        if fresh:
            self._emit("estop", f"e-stop by {latch.actor}: {latch.reason}")
        self._publish()

    async def coordinator_lost(self, reason: str) -> None:
        """No heartbeat of the coordinator: unload or stop."""
        await self._survive(self._member.abandon(reason))

    # Inside

    def _check(self, request: Propose | Arm) -> None:
        """Everything that must hold before profiles are executed."""
        self._fence.require_no_estop()
        reading = self._online()
        if request.digest != self._config.digest:
            raise CannotDo(
                "other-configuration",
                f"the coordinator believes in configuration {request.digest}, the adapter has {self._config.digest}",
                "use one fleet file on all hosts and restart",
            )
        if self._homing:
            raise CannotDo("homing", f"{', '.join(sorted(self._homing))} is homing", "wait for it")
        if self._faults:
            raise CannotDo("fault", self._faults[0].text, self._faults[0].remedy)
        check_profiles(self._config, request.profiles, reading, self._referenced)

    def _require_idle(self, request: AxesRequest) -> None:
        self._online()
        unknown = [name for name in request.axes if name not in self._config.axes]
        if unknown:
            raise CannotDo("unknown-axis", f"no axis {unknown[0]}; axes: {', '.join(self._config.axes)}")
        if self._member.ticket is not None or self._homing:
            raise CannotDo("busy", f"the controller is {self._mode()}", "wait, or stop it")

    def _online(self) -> Reading:
        if self._reading is None:
            fault = self._faults[0] if self._faults else None
            raise CannotDo(
                "offline",
                f"the controller can not be reached: {fault.text if fault else 'no reading yet'}",
                fault.remedy if fault else "wait",
            )
        return self._reading

    def _require_scale(self) -> FleetScale:
        scale = self._scale()
        if scale is None:
            raise CannotDo("no-fleet-time", "no coordinator's time is known here", "start a coordinator")
        return scale

    async def _refresh(self) -> None:
        """Read and publish at once, after something was changed."""
        self._take(await self._driver.poll())
        self._publish()

    def _spawn(self, coroutine: Coroutine[Any, Any, None]) -> "asyncio.Task[None]":
        task = asyncio.get_running_loop().create_task(self._survive(coroutine))
        self._tasks.add(task)
        task.add_done_callback(self._ended)
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


_REPLY_OF: dict[str, type[Reply]] = {
    "adopt": Adopted,
    "propose": Proposal,
    "arm": Armed,
    "raw": RawReply,
    "trace": TraceReply,
}


def _explain(error: ValidationError) -> str:
    """The first thing that is wrong with a payload, for the one who sent it."""
    first = error.errors()[0]
    return f"{'.'.join(map(str, first['loc'])) or 'payload'}: {first['msg']}"
