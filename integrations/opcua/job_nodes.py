"""The objects JobOrders and JobResponses of OPC 10031-4, and their methods."""

from collections.abc import Awaitable, Callable
from typing import Any

from integrations.opcua.methods import Check, are_structures, are_texts, is_structure, is_text, make_method
from integrations.opcua.orders import Order
from integrations.opcua.receiver import MAX_ORDERS, OrderReceiver
from integrations.opcua.states import INVALID_REQUEST, NO_ERROR, UNKNOWN_ORDER, find_status, matches
from integrations.opcua.types import (
    make_array,
    make_list,
    make_response,
    make_states,
    make_work_masters,
    read_request,
    read_text,
    ua,
)
from integrations.whole_fleet import describe
from tutti import NotAllowed, TuttiError

RECEIVER, PROVIDER, STATUS_EVENT = 1008, 1003, 1006
"""Numbers of the types in the nodeset: ISA95JobOrderReceiverSubStatesType, and so on."""
SEVERITY = 300


class JobNodes:
    """The two objects. own, isa: the indices of our namespace and of the nodeset's."""

    def __init__(self, server: Any, receiver: OrderReceiver, own: int, isa: int) -> None:
        self._server = server
        self._receiver = receiver
        self._own, self._isa = own, isa
        self._nodes: dict[str, Any] = {}

    async def build(self, parent: Any) -> None:
        """Add the objects below `parent`, and follow the orders."""
        server, receiver = self._server, self._receiver
        orders = await self._add(parent, "JobOrders", RECEIVER)
        responses = await self._add(parent, "JobResponses", PROVIDER)
        await orders.write_attribute(ua.AttributeIds.EventNotifier, ua.DataValue(ua.Variant(1, ua.VariantType.Byte)))
        for name, node in (("JobOrderList", orders), ("WorkMaster", orders), ("JobOrderResponseList", responses)):
            self._nodes[name] = await node.get_child(f"{self._isa}:{name}")
        most = await orders.get_child(f"{self._isa}:MaxDownloadableJobOrders")
        await most.write_value(MAX_ORDERS, ua.VariantType.UInt16)
        self._nodes["LastRefusal"] = await orders.add_variable(self._own, "LastRefusal", "")
        await self._nodes["WorkMaster"].write_value(make_array(make_work_masters(receiver.templates)))
        status_type = server.get_node(ua.NodeId(STATUS_EVENT, self._isa))
        self._status_event = await server.get_event_generator(status_type, orders)
        # The type has no values of which the library could take these types.
        fields = dict.fromkeys(("JobOrder", "JobState", "JobResponse"), ua.VariantType.ExtensionObject)
        self._status_event.event.data_types.update(fields)
        self._refusal_event = await server.get_event_generator(emitting_node=orders)
        self._refusal_event.event.Severity = SEVERITY
        await self._link_all(orders, responses)
        receiver.on_change.append(self._tell_change)
        receiver.on_list.append(self._write_lists)
        await self._write_lists()

    async def _add(self, parent: Any, name: str, number: int) -> Any:
        return await parent.add_object(
            self._own, name, objecttype=ua.NodeId(number, self._isa), instantiate_optional=True
        )

    # Methods

    async def _link_all(self, orders: Any, responses: Any) -> None:
        receiver = self._receiver
        an_order = (is_structure("ISA95JobOrderDataType"), are_texts)
        for name, is_held in (("Store", True), ("StoreAndStart", False)):
            await self._link(orders, name, an_order, self._make_store(held=is_held))

        async def update(order: Any, comment: Any) -> None:
            await receiver.update(read_request(order), read_text(comment))

        await self._link(orders, "Update", an_order, update)
        by_id = {
            "Start": receiver.start,
            "RevokeStart": receiver.revoke_start,
            "Pause": receiver.pause,
            "Resume": receiver.resume,
            "Stop": receiver.stop,
            "Abort": receiver.abort,
            "Cancel": receiver.cancel,
            "Clear": receiver.clear,
        }
        for name, act in by_id.items():
            await self._link(orders, name, (is_text, are_texts), self._make_act(act))
        child = f"{self._isa}:RequestJobResponseByJobOrder"
        self._server.link_method(await responses.get_child(f"{child}ID"), make_method([is_text], self._find_by_id))
        state_check = are_structures("ISA95StateDataType")
        by_state = make_method([state_check], self._find_by_state)
        self._server.link_method(await responses.get_child(f"{child}State"), by_state)

    def _make_store(self, *, held: bool) -> Callable[..., Awaitable[None]]:
        async def store(order: Any, comment: Any) -> None:
            await self._receiver.store(read_request(order), read_text(comment), held=held)

        return store

    def _make_act(self, act: Callable[[str, str], Awaitable[None]]) -> Callable[..., Awaitable[None]]:
        async def call(order_id: str | None, comment: Any) -> None:
            await act(order_id or "", read_text(comment))

        return call

    async def _link(self, node: Any, name: str, checks: tuple[Check, ...], act: Callable[..., Awaitable[None]]) -> None:
        async def answer(*values: Any) -> Any:
            try:
                await act(*values)
            except TuttiError as error:
                await self._tell_refusal(name, error)
                return answer_refusal(error)
            return [make_status(NO_ERROR)]

        method = await node.get_child(f"{self._isa}:{name}")
        self._server.link_method(method, make_method(checks, answer))

    async def _find_by_id(self, order_id: str | None) -> list[Any]:
        order = self._receiver.orders.get(order_id or "")
        if order is None:
            return [ua.Variant(ua.ISA95JobResponseDataType()), make_status(UNKNOWN_ORDER)]
        return [ua.Variant(make_response(order, self._isa)), make_status(NO_ERROR)]

    async def _find_by_state(self, states: list[Any]) -> list[Any]:
        tops = [state.StateNumber for state in states if not state.BrowsePath.Elements]
        substates = [state.StateNumber for state in states if state.BrowsePath.Elements]
        if len(tops) != 1:
            return [make_array([]), make_status(INVALID_REQUEST)]
        fitting = [order for order in self._receiver.orders.values() if matches(order.state, tops[0], substates)]
        return [make_array([make_response(order, self._isa) for order in fitting]), make_status(NO_ERROR)]

    # What clients can follow

    async def _tell_refusal(self, method: str, error: TuttiError) -> None:
        text = f"{method}: {describe(error)}"
        await self._nodes["LastRefusal"].write_value(text)
        await self._refusal_event.trigger(message=text)

    async def _tell_change(self, order: Order) -> None:
        event = self._status_event.event
        event.JobOrder = make_list([order], self._isa).Value[0].JobOrder
        event.JobState = make_states(order.state, self._isa)
        event.JobResponse = make_response(order, self._isa)
        event.Severity = SEVERITY
        words = f"job order {order.request.id} is {order.state.name}"
        await self._status_event.trigger(message=f"{words}: {order.reason}" if order.reason else words)

    async def _write_lists(self) -> None:
        orders = list(self._receiver.orders.values())
        responses = [make_response(order, self._isa) for order in orders if order.state.has_begun]
        await self._nodes["JobOrderList"].write_value(make_list(orders, self._isa))
        await self._nodes["JobOrderResponseList"].write_value(make_array(responses))


def make_status(bits: int) -> Any:
    """A ReturnStatus."""
    return ua.Variant(bits, ua.VariantType.UInt64)


def answer_refusal(error: TuttiError) -> Any:
    """The answer of a method to what was not done: a ReturnStatus; a bad status if the role of this server's identity
    does not allow it."""
    if isinstance(error, NotAllowed):
        return ua.StatusCode(ua.StatusCodes.BadUserAccessDenied)
    return [make_status(find_status(error))]
