"""The object Fleet: e-stop, reset, and the state of the queue."""

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from integrations.opcua.methods import is_text, make_method
from integrations.opcua.receiver import OrderReceiver
from integrations.opcua.types import ua
from integrations.whole_fleet import describe, describe_fleet, estop_fleet, is_latched, reset_fleet
from tutti import ControllerState, NotAllowed, Tutti, TuttiError

VALUES = {"State": "idle", "EStopLatched": False, "QueueStopped": False, "QueueReason": "", "JobsWaiting": 0}


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
            words = "by a client of OPC UA"
            return await estop_fleet(self._tutti, f"{words}: {reason}" if reason else words)

        return await self._answer(act)

    async def _reset(self) -> Any:
        async def act() -> str:
            refusals = await reset_fleet(self._tutti)
            for refusal in refusals:
                if isinstance(refusal, NotAllowed):
                    raise refusal
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
