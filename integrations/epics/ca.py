"""Channels by Channel Access, with caproto."""

# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownParameterType=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false, reportMissingParameterType=false
# pyright: reportUntypedBaseClass=false, reportIncompatibleMethodOverride=false, reportIncompatibleVariableOverride=false

import asyncio
import logging
import os
from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager, suppress
from contextvars import ContextVar
from typing import Any

from caproto import (
    AccessRights,
    CaprotoRuntimeError,
    ChannelDouble,
    ChannelEnum,
    ChannelInteger,
    ChannelString,
)
from caproto.asyncio.server import Context

from integrations.epics.channels import Channel, refuse_address
from integrations.epics.fields import Value
from tutti import Refusal, TaskOwner

LONGEST_TEXT = 39  # bytes of a string of Channel Access
_client: ContextVar[Any] = ContextVar("client")


class _ServedValue:
    """The part of a caproto channel that is the same for all types: clients put through the record."""

    served: Channel
    holders: set[Any]

    def check_access(self, hostname: str, username: str) -> AccessRights:
        """What clients may do, as they see it before they try."""
        del hostname, username
        return AccessRights.READ | AccessRights.WRITE if self.served.field.can_put else AccessRights.READ

    async def auth_write(self, *values: Any, user_address: Any = None, **more: Any) -> Any:
        """A put of a client, which is known by its address."""
        _client.set(user_address)
        return await super().auth_write(*values, user_address=user_address, **more)  # pyright: ignore

    async def write(self, value: Any, **_: Any) -> None:
        """Put the value of a client; it has ended when this returns. Raises `Refusal`, whose text the client gets."""
        ending: asyncio.Future[str | None] = asyncio.get_running_loop().create_future()

        def end(error: str | None) -> None:
            if not ending.done():
                ending.set_result(error)

        raw = value[0] if isinstance(value, list | tuple) or hasattr(value, "tolist") else value
        self.holders.add(_client.get(None))
        self.served.record.put(self.served.key, raw, end)
        if error := await ending:
            raise Refusal("put", error)

    async def publish_value(self, value: Value, stamp_s: float | None) -> None:
        """Publish the value of the record."""
        alarm = self.served.record.alarm
        if self.served.field.kind == "text":
            value = str(value).encode("latin-1", "replace")[:LONGEST_TEXT].decode("latin-1")
        stamp = {} if stamp_s is None else {"timestamp": stamp_s}
        await super().write(  # pyright: ignore
            value, verify_value=False, severity=alarm.severity, status=alarm.status, **stamp
        )

    def end_held(self, client: Any) -> None:
        """A client is gone: what it holds ends."""
        if client in self.holders and self.served.is_held:
            self.served.record.put(self.served.key, 0, lambda _: None)
        self.holders.discard(client)


class _Double(_ServedValue, ChannelDouble): ...


class _Integer(_ServedValue, ChannelInteger): ...


class _Text(_ServedValue, ChannelString): ...


class _Menu(_ServedValue, ChannelEnum): ...


class _Context(Context):
    """The server; it says which clients are gone."""

    async def circuit_disconnected(self, circuit: Any) -> None:
        await super().circuit_disconnected(circuit)
        for value in self.pvdb.values():
            value.end_held(circuit.circuit.address)


def _make_value(channel: Channel) -> Any:
    field = channel.field
    if field.kind == "menu":
        value = _Menu(value=field.choices[int(channel.value)], enum_strings=list(field.choices))
    elif field.kind == "text":
        value = _Text(value=str(channel.value)[:LONGEST_TEXT])
    elif field.kind == "int":
        value = _Integer(value=int(channel.value))
    else:
        limits = {
            f"{end}_{kind}_limit": number
            for end, number in (("lower", channel.low), ("upper", channel.high))
            for kind in ("disp", "ctrl")
        }
        value = _Double(value=float(channel.value), units=channel.unit, precision=channel.digits, **limits)
    value.served, value.holders = channel, set()
    return value


@asynccontextmanager
async def serve_ca(channels: Sequence[Channel], interface: str, port: int) -> AsyncGenerator[int]:
    """Serve channels while the context lasts. port: of TCP and UDP; the context is that of TCP, which is another one
    if this is in use. Raises `Refusal`."""
    if interface == "127.0.0.1":  # caproto has no other way to keep its beacons from other computers
        os.environ |= {"EPICS_CAS_AUTO_BEACON_ADDR_LIST": "NO", "EPICS_CAS_BEACON_ADDR_LIST": interface}
    logging.getLogger("caproto").setLevel(logging.CRITICAL)  # it logs what clients put wrongly, with tracebacks
    changes: asyncio.Queue[tuple[Any, Value, float | None]] = asyncio.Queue()
    pvs: dict[str, Any] = {}
    for channel in channels:
        value = _make_value(channel)
        pvs |= dict.fromkeys(channel.names, value)
        channel.record.follow(channel.key, lambda new, stamp_s, value=value: changes.put_nowait((value, new, stamp_s)))

    async def publish() -> None:
        while True:
            value, new, stamp_s = await changes.get()
            await value.publish_value(new, stamp_s)

    context: Any = _Context(pvs, [interface])
    context.ca_server_port = port

    async def serve() -> None:
        with suppress(CaprotoRuntimeError):  # no socket there: what waits below says so
            await context.run()

    tasks = TaskOwner()
    serving = tasks.spawn(serve())
    tasks.spawn(publish())
    try:
        while not context.udp_socks:
            if serving.done():
                raise refuse_address("Channel Access", interface)
            await asyncio.sleep(0.01)
        yield context.port
    finally:
        await tasks.end_all()
