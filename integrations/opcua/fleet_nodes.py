"""The object Fleet: e-stop, reset, and the state of the queue."""

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from typing import Any

from integrations.opcua.methods import is_text, make_method
from integrations.opcua.reasons import describe_fleet, is_latched
from integrations.opcua.receiver import REFRESH_S, OrderReceiver
from integrations.opcua.states import describe
from integrations.opcua.types import ua
from tutti import ControllerState, NotAllowed, Tutti, TuttiError, running

VALUES = {"State": "idle", "EStopLatched": False, "QueueStopped": False, "QueueReason": "", "JobsWaiting": 0}
RELEASE_S = 2.0


class FleetNodes:
    """The object of the whole fleet."""

    def __init__(self, server: Any, tutti: Tutti, receiver: OrderReceiver, own: int) -> None:
        self._server = server
        self._tutti = tutti
        self._receiver = receiver
        self._own = own
        self._nodes: dict[str, Any] = {}
        self._written: dict[str, object] = {}

    async def build(self, parent: Any) -> None:
        """Add the object, with its methods EStop and Reset."""
        node = await parent.add_object(self._own, "Fleet")
        for name, value in VALUES.items():
            self._nodes[name] = await node.add_variable(self._own, name, value)
        boolean, text = ua.VariantType.Boolean, ua.VariantType.String
        results = [make_argument("Done", boolean), make_argument("Text", text)]
        arguments = [make_argument("Reason", text)]
        await node.add_method(self._own, "EStop", make_method([is_text], self._estop), arguments, results)
        await node.add_method(self._own, "Reset", make_method([], self._reset), [], results)

    async def refresh(self) -> None:
        """Read the states, and show them with the queue. Raises `Refusal`."""
        states: Mapping[str, ControllerState] = await self._tutti.status()
        queue = self._receiver.queue
        await self._write("State", describe_fleet(states))
        await self._write("EStopLatched", is_latched(states))
        await self._write("QueueStopped", queue.stopped is not None)
        await self._write("QueueReason", "" if queue.stopped is None else queue.stopped.reason)
        await self._write("JobsWaiting", sum(entry.state == "queued" for entry in queue))

    async def _write(self, name: str, value: Any) -> None:
        if self._written.get(name) != value:
            self._written[name] = value
            kind = ua.VariantType.Int64 if name == "JobsWaiting" else None
            await self._nodes[name].write_value(value, kind)

    async def _estop(self, reason: str | None) -> Any:
        async def act() -> str:
            latches = await self._tutti.estop(f"by a client of OPC UA: {reason}" if reason else "by a client of OPC UA")
            other_names = ", ".join(name for name, is_set in latches.items() if not is_set) or "any controller"
            is_confirmed = bool(latches) and all(latches.values())
            return "" if is_confirmed else f"no e-stop is confirmed by {other_names}; use the wired one"

        return await self._answer(act)

    async def _reset(self) -> Any:
        async def act() -> str:
            refusals = [refusal for refusal in (await self._tutti.reset()).values() if refusal is not None]
            for refusal in refusals:
                if isinstance(refusal, NotAllowed):
                    raise refusal
            with suppress(TimeoutError):
                async with asyncio.timeout(RELEASE_S):
                    while not refusals and is_latched(await self._tutti.status()):
                        await asyncio.sleep(REFRESH_S / 10)
            return ", ".join(describe(refusal) for refusal in refusals)

        return await self._answer(act)

    async def _answer(self, act: Callable[[], Awaitable[str]]) -> Any:
        try:
            text = await act()
            await self.refresh()
        except NotAllowed:
            return ua.StatusCode(ua.StatusCodes.BadUserAccessDenied)
        except TuttiError as error:
            text = describe(error)
        return [ua.Variant(not text), ua.Variant(text)]


def make_argument(name: str, kind: Any) -> Any:
    """An argument of a method."""
    return ua.Argument(Name=name, DataType=ua.NodeId(kind.value), ValueRank=-1)


@asynccontextmanager
async def follow_fleet(nodes: FleetNodes) -> AsyncGenerator[None]:
    """Show the state of the fleet while the context lasts."""

    async def follow() -> None:
        while True:
            with suppress(TuttiError):  # the coordinator is away: what is known stays
                await nodes.refresh()
            await asyncio.sleep(REFRESH_S)

    async with running(follow()):
        yield
