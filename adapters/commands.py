"""Commands to a controller, from the bus: each verb with its request, done once, answered with a value."""

import asyncio
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from typing import Any, Protocol

from pydantic import ValidationError

from adapters.condition import Condition
from adapters.contract import CannotDo, DriverFault
from adapters.fence import Fence
from adapters.member import Member
from adapters.presenter import Presenter, explain
from adapters.seat import Seat
from orchestrator.bus.base import RequestRefused, Sample
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.link.trace import Direction
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

ANSWERS_KEPT = 256


class UnitActions(Protocol):
    """What commands need of the unit that they belong to."""

    async def refresh(self) -> None:
        """Read and publish at once, after something was changed."""
        ...

    async def stop(self, abort: bool, reason: str) -> None:
        """Stop the controller, past everything else."""
        ...


class Commands:
    """Answers `ctl/{id}/cmd/*` for one controller."""

    def __init__(
        self,
        seat: Seat,
        fence: Fence,
        member: Member,
        condition: Condition,
        presenter: Presenter,
        unit: UnitActions,
    ) -> None:
        self._seat = seat
        self._config, self._driver = seat.config, seat.driver
        self._fence = fence
        self._member = member
        self._condition = condition
        self._presenter = presenter
        self._unit = unit
        self._answers: OrderedDict[str, asyncio.Task[Reply]] = OrderedDict()
        # verb: (request, reply, handler)
        self._verbs: dict[str, tuple[type[Request], type[Reply], Callable[[Any], Awaitable[Reply]]]] = {
            "adopt": (Adopt, Adopted, self._adopt),
            "propose": (Propose, Proposal, member.propose),
            "arm": (Arm, Armed, member.arm),
            "commit": (Commit, Reply, self._commit),
            "go": (Go, Reply, self._go),
            "disarm": (Disarm, Reply, member.disarm),
            "stop": (Stop, Reply, self._stop),
            "enable": (EnableRequest, Reply, self._enable),
            "home": (HomeRequest, Reply, self._home),
            "output": (OutputRequest, Reply, self._output),
            "reset": (Reset, Reply, self._reset),
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
        task = self._answers.get(request.request_id)
        if task is None:
            task = asyncio.get_running_loop().create_task(self._do(verb, reply, handler, request))
            self._answers[request.request_id] = task
            while len(self._answers) > ANSWERS_KEPT:
                self._answers.popitem(last=False)
        return (await asyncio.shield(task)).to_json()

    async def _do(
        self, verb: str, reply: type[Reply], handler: Callable[[Any], Awaitable[Reply]], request: Request
    ) -> Reply:
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
        self._presenter.emit("refusal", f"{verb} by {request.actor}: {refusal.text}")
        return reply(refused=refusal.model_copy(update={"member": self._seat.controller}))

    async def _adopt(self, request: Adopt) -> Adopted:
        if self._fence.adopt(request):
            await self._member.abandon(f"a new reign, epoch {request.epoch}")
        self._presenter.publish()
        return Adopted(epoch=self._fence.epoch, mode=self._presenter.mode())

    async def _commit(self, request: Commit) -> Reply:
        self._fence.require_no_estop()
        return await self._member.commit(request)

    async def _go(self, request: Go) -> Reply:
        self._fence.require_no_estop()
        return await self._member.go(request)

    async def _stop(self, request: Stop) -> Reply:
        await self._unit.stop(request.mode == "abort", request.reason or f"stopped by {request.actor}")
        return Reply()

    async def _enable(self, request: EnableRequest) -> Reply:
        self._require_idle(request)
        if request.on:
            self._fence.require_no_estop()
        await self._driver.enable(request.axes, request.on)
        await self._unit.refresh()
        return Reply()

    async def _home(self, request: HomeRequest) -> Reply:
        self._require_idle(request)
        self._fence.require_no_estop()
        condition = self._condition
        reading = condition.online()
        for name in request.axes:
            if not reading.axes[name].enabled:
                raise CannotDo("not-enabled", f"axis {name} is not enabled", f"enable {name} first: `do: enable`")
            condition.referenced[name] = False
        condition.homing.update(request.axes)
        longest_s = max(self._config.axes[name].homing.timeout_s for name in request.axes)
        try:
            await self._unit.refresh()
            async with asyncio.timeout(longest_s):
                await self._driver.home(request.axes)
        except TimeoutError:
            await self._driver.stop(False)
            names = ", ".join(request.axes)
            text = f"no reference found for {names} within {longest_s:g} s"
            raise CannotDo("homing-timeout", text, "look at the home switch, or allow more time") from None
        finally:
            condition.homing.difference_update(request.axes)
        await self._unit.refresh()
        if condition.reading is None or condition.reading.restarted:
            raise CannotDo("restarted", "the controller was lost while homing", "home again")
        condition.referenced.update(dict.fromkeys(request.axes, True))
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
        released = self._fence.release(request.event)
        if self._condition.reading is not None:
            await self._driver.clear_faults()
            await self._unit.refresh()
        if released:
            self._presenter.emit("reset", f"e-stop reset by {request.actor}")
        self._presenter.publish()
        return Reply()

    async def _raw(self, request: Raw) -> RawReply:
        if not request.i_know:
            text = "a raw command is checked against no limit"
            raise CannotDo("raw-needs-flag", text, "add --i-know if you mean it")
        self._condition.online()
        self._presenter.emit("raw", f"raw by {request.actor}: {request.command!r}")
        return RawReply(reply=await self._driver.raw(request.command))

    async def _give_trace(self, _: Request) -> TraceReply:
        entries: list[tuple[int, Direction, str]] = [
            (at_ns, direction, data.decode("latin-1")) for at_ns, direction, data in self._seat.trace.entries()
        ]
        return TraceReply(entries=entries, utc=self._seat.clock.utc(), host_ns=self._seat.clock.now_ns())

    def _require_idle(self, request: AxesRequest) -> None:
        self._condition.online()
        unknown = [name for name in request.axes if name not in self._config.axes]
        if unknown:
            raise CannotDo("unknown-axis", f"no axis {unknown[0]}; axes: {', '.join(self._config.axes)}")
        if self._member.ticket is not None or self._condition.homing:
            raise CannotDo("busy", f"the controller is {self._presenter.mode()}", "wait, or stop it")
