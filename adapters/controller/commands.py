"""Commands to a controller, from the bus: each verb with its request, done once, answered with a value."""

from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol

from pydantic import ValidationError

from adapters.contract import CannotDo, DriverFault
from adapters.controller.context import Seat
from adapters.controller.fencing import Fence
from adapters.controller.jogging import Jogging
from adapters.controller.leases import Leases
from adapters.controller.motors import Motors
from adapters.controller.participant import Member, Phase
from adapters.controller.publisher import Presenter, explain
from adapters.controller.referencing import Referencing
from adapters.controller.status import Condition
from adapters.controller.store import Remembered
from orchestrator.bus.answers import Answers
from orchestrator.bus.base import RequestRefused, Sample
from orchestrator.clock.base import NS_PER_MS
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.link.trace import Direction
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import (
    Adopt,
    Adopted,
    Arm,
    Armed,
    Commit,
    ConfigureRequest,
    Disarm,
    Disarmed,
    EnableRequest,
    Fenced,
    Go,
    HomeReply,
    HomeRequest,
    JogRequest,
    LeasedRequest,
    LeaseReply,
    LeaseRequest,
    OutputRequest,
    Proposal,
    Propose,
    Raw,
    RawReply,
    Refusal,
    Reply,
    Request,
    Reset,
    SetPositionRequest,
    Stop,
    TraceReply,
)
from orchestrator.model.units import UnitError, parse_quantity

BEGINS_SOON_NS = 300 * NS_PER_MS


class UnitActions(Protocol):
    """What commands need of the unit that they belong to."""

    async def refresh(self) -> None:
        """Read and publish at once, after something was changed."""
        ...

    async def stop(self, abort: bool, reason: str, follow: bool = False) -> None:
        """Stop the controller, past everything else. follow: a step that moves is followed to its rest."""
        ...

    def poke(self) -> None:
        """Have the next poll come soon."""
        ...

    def reconfigure(self, config: Controller) -> None:
        """Start anew with another configuration, as soon as the answer has left."""
        ...


@dataclass(frozen=True, slots=True)
class Parts:
    """The parts of a unit that do what commands ask for."""

    fence: Fence
    remembered: Remembered
    leases: Leases
    member: Member
    jogging: Jogging
    motors: Motors
    referencing: Referencing
    condition: Condition
    presenter: Presenter


class Commands:
    """Answers `ctl/{id}/cmd/*` for one controller."""

    def __init__(self, seat: Seat, parts: Parts, unit: UnitActions) -> None:
        self._seat = seat
        self._config, self._driver = seat.config, seat.driver
        self._parts = parts
        self._fence, self._condition, self._presenter = parts.fence, parts.condition, parts.presenter
        self._unit = unit
        self._answers = Answers()
        # verb: (request, reply, handler)
        self._verbs: dict[str, tuple[type[Request], type[Reply], Callable[[Any], Awaitable[Reply]]]] = {
            "adopt": (Adopt, Adopted, self._adopt),
            "lease": (LeaseRequest, LeaseReply, self._lease),
            "propose": (Propose, Proposal, parts.member.propose),
            "arm": (Arm, Armed, parts.member.arm),
            "commit": (Commit, Reply, self._commit),
            "go": (Go, Reply, self._go),
            "disarm": (Disarm, Disarmed, parts.member.disarm),
            "stop": (Stop, Reply, self._stop),
            "enable": (EnableRequest, Reply, self._enable),
            "home": (HomeRequest, HomeReply, self._home),
            "jog": (JogRequest, Reply, self._jog),
            "set-position": (SetPositionRequest, Reply, self._set_position),
            "output": (OutputRequest, Reply, self._output),
            "reset": (Reset, Reply, self._reset),
            "configure": (ConfigureRequest, Reply, self._configure),
            "raw": (Raw, RawReply, self._raw),
            "trace": (Request, TraceReply, self._give_trace),
        }

    async def answer(self, sample: Sample) -> bytes:
        """Answer one command. A request id that was seen already gets the same answer, without doing it again."""
        verb = self._seat.keys.verb_of(sample.key)
        if verb not in self._verbs:
            raise RequestRefused(f"unknown verb {verb!r}; known: {', '.join(sorted(self._verbs))}")
        model, reply, handler = self._verbs[verb]
        try:
            request = model.model_validate_json(sample.payload)
        except ValidationError as error:
            raise RequestRefused(f"{verb}: {explain(error)}") from None
        return await self._answers.once(verb, request.request_id, lambda: self._do(verb, reply, handler, request))

    async def _do(
        self, verb: str, reply: type[Reply], handler: Callable[[Any], Awaitable[Reply]], request: Request
    ) -> bytes:
        try:
            if isinstance(request, Fenced) and not isinstance(request, Adopt):
                await self._fence.admit(request)
            return (await handler(request)).to_json()
        except CannotDo as error:
            refusal = error.refusal
        except DriverFault as error:
            fault = error.fault
            refusal = Refusal(code=fault.code, text=fault.text, remedy=fault.remedy)
        except (LinkClosed, LinkRefused) as error:
            refusal = Refusal(code="offline", text=str(error), remedy="check power and cable of the controller")
        self._presenter.emit("refusal", f"{verb} by {request.actor}: {refusal.text}")
        return reply(refused=refusal.model_copy(update={"member": self._seat.controller})).to_json()

    async def _adopt(self, request: Adopt) -> Adopted:
        if await self._fence.adopt(request):
            self._parts.leases.drop(f"a new reign, epoch {request.epoch}")
            await self._parts.member.abandon(f"a new reign, epoch {request.epoch}")
        self._presenter.publish()
        return Adopted(epoch=self._fence.epoch, mode=self._presenter.mode())

    async def _commit(self, request: Commit) -> Reply:
        self._fence.require_no_estop()
        return await self._parts.member.commit(request)

    async def _go(self, request: Go) -> Reply:
        self._fence.require_no_estop()
        reply = await self._parts.member.go(request)
        ticket = self._parts.member.ticket
        if ticket is not None:
            # It is polled as one that moves from here on: that it has started must not be seen a slow poll later. Where
            # it begins soon, only from T0 on: before, others are still told to go, and wait for this host.
            clock = self._seat.clock
            far = ticket.t0_host_ns - clock.now_ns() > BEGINS_SOON_NS
            clock.call_at_ns(clock.now_ns() if far else ticket.t0_host_ns, self._unit.poke)
        return reply

    async def _stop(self, request: Stop) -> Reply:
        reason = request.reason or f"stopped by {request.actor}"
        await self._unit.stop(request.mode == "abort", reason, follow=request.mode == "hold")
        return Reply()

    async def _lease(self, request: LeaseRequest) -> LeaseReply:
        self._condition.require_known(request.axes)
        before = self._parts.leases.holders
        self._parts.leases.grant(request)
        # Who asks is told the state at once, others with the next poll or heartbeat; not at each renewal.
        changed = self._parts.leases.holders != before
        return LeaseReply(state=self._presenter.state() if changed else None)

    async def _enable(self, request: EnableRequest) -> Reply:
        self._require_idle(request)
        if request.on:
            self._fence.require_no_estop()
        await self._parts.motors.switch(request.axes, request.on)
        return Reply()

    async def _home(self, request: HomeRequest) -> HomeReply:
        self._require_idle(request)
        self._fence.require_no_estop()
        try:
            return await self._parts.referencing.home(request.axes)
        except (LinkClosed, LinkRefused, DriverFault) as error:
            # The controller goes on looking by itself. Where it can not be told now, the stop is owed.
            with suppress(LinkClosed, LinkRefused, DriverFault):
                await self._unit.stop(False, f"homing has failed: {error}")
            raise

    async def _jog(self, request: JogRequest) -> Reply:
        self._condition.require_known(request.velocities)
        self._parts.leases.require(request.holder, request.velocities)
        self._parts.jogging.take_seq(request)
        if any(request.velocities.values()):
            self._fence.require_no_estop()
            self._condition.require_no_fault()
            self._require_no_step()
        await self._parts.jogging.jog(request)
        return Reply()

    async def _set_position(self, request: SetPositionRequest) -> Reply:
        self._require_idle(request)
        (name,) = request.axes
        axis, offsets = self._config.axes[name], dict(self._parts.remembered.now.offsets)
        offsets.pop(name, None)
        if request.position is not None:
            motor = self._condition.online().axes[name].commanded_counts / axis.counts_per_unit
            try:
                offsets[name] = parse_quantity(request.position, axis.unit) - motor
            except UnitError as error:
                raise CannotDo("bad-unit", f"{name}: {error}") from None
        self._parts.remembered.change(offsets=offsets)
        await self._parts.remembered.keep()
        self._presenter.publish()
        return Reply()

    async def _output(self, request: OutputRequest) -> Reply:
        point = self._config.outputs.get(request.output)
        if point is None:
            known = ", ".join(self._config.outputs) or "none"
            raise CannotDo("unknown-output", f"no output {request.output}; outputs: {known}")
        self._condition.online()
        await self._driver.set_output(point.number, request.value == (point.active == "high"))
        await self._unit.refresh()
        return Reply()

    async def _reset(self, request: Reset) -> Reply:
        """With `check`, only say whether it could be done; all adapters are asked so before any lets go."""
        self._fence.require_event(request.event)
        await self._require_safe()
        if not request.check:
            if await self._fence.release():
                self._presenter.emit("reset", f"e-stop reset by {request.actor}")
            self._presenter.publish()
        return Reply()

    async def _require_safe(self) -> None:
        """What can be cleared is cleared, and nothing is left that speaks against motion. Raises `CannotDo`."""
        condition = self._condition
        condition.online()
        ticket = self._parts.member.ticket
        if ticket is not None and ticket.phase is not Phase.MOVING:
            # What clears faults would be carried out before the starting line, and delay it.
            raise CannotDo("busy", f"it is about to move for job {ticket.job}", "wait for its end, then reset")
        await self._driver.clear_faults()
        await self._unit.refresh()
        condition.require_no_fault()
        moving = [name for name, axis in condition.online().axes.items() if axis.moving]
        if moving:
            raise CannotDo("moving", f"axis {moving[0]} is moving", "wait for its end, then reset")

    async def _configure(self, request: ConfigureRequest) -> Reply:
        self._require_no_step()
        if self._parts.leases.holders:
            holder = next(iter(self._parts.leases.holders.values()))
            raise CannotDo("leased", f"axes of the controller are held by {holder}", "wait for its end")
        try:
            config = Controller.model_validate(request.configuration)
            self._seat.make.options.model_validate(config.options)
            self._seat.make.check(config)
        except ValidationError as error:
            raise CannotDo("bad-configuration", explain(error), "correct the fleet file") from None
        except ValueError as error:
            raise CannotDo("bad-configuration", str(error), "correct the fleet file") from None
        if not request.check:
            self._unit.reconfigure(config)
        return Reply()

    async def _raw(self, request: Raw) -> RawReply:
        if not request.i_know:
            text = "a raw command is checked against no limit"
            raise CannotDo("raw-needs-flag", text, "add --i-know if you mean it")
        self._parts.leases.require(request.holder, self._config.axes)
        self._condition.online()
        self._presenter.emit("raw", f"raw by {request.actor}: {request.command!r}")
        return RawReply(reply=await self._driver.raw(request.command))

    async def _give_trace(self, _: Request) -> TraceReply:
        entries: list[tuple[int, Direction, str]] = [
            (at_ns, direction, data.decode("latin-1")) for at_ns, direction, data in self._seat.trace.entries()
        ]
        return TraceReply(entries=entries, utc=self._seat.clock.utc(), host_ns=self._seat.clock.now_ns())

    def _require_idle(self, request: LeasedRequest) -> None:
        self._condition.online()
        self._condition.require_known(request.axes)
        self._parts.leases.require(request.holder, request.axes)
        self._require_no_step()
        if self._condition.jogging:
            raise CannotDo("busy", f"axis {min(self._condition.jogging)} is jogging", "let the key go")

    def _require_no_step(self) -> None:
        if self._parts.member.ticket is not None or self._condition.homing:
            raise CannotDo("busy", f"the controller is {self._presenter.mode()}", "wait, or stop it")
