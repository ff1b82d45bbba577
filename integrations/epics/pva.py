"""Channels by PVAccess, with p4p."""

# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false

import asyncio
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Any

from p4p.nt import NTEnum, NTScalar, NTTable
from p4p.server import DynamicProvider, Server, StaticProvider
from p4p.server.raw import SharedPV

from integrations.epics.channels import Channel, refuse_address
from integrations.epics.fields import Value
from integrations.epics.fleet import QUEUE_COLUMNS, FleetRecord, Rows
from integrations.whole_fleet import describe
from tutti import Refusal, TuttiError

NS_PER_S = 10**9
_CODES = {"float": "d", "int": "i", "text": "s"}


class ValuePv:
    """The PV of one channel, which it follows. Its clients are answered in `loop`. on_end: called there when the last
    one is gone."""

    def __init__(self, channel: Channel, loop: asyncio.AbstractEventLoop, on_end: "Callable[[ValuePv], None]") -> None:
        self._channel = channel
        self._loop = loop
        self._on_end = on_end
        self._has_put = False
        kind, is_number = channel.field.kind, channel.field.kind == "float"
        is_menu = kind == "menu"
        self._place = "value.index" if is_menu else "value"
        nt = (
            NTEnum(display=True) if is_menu else NTScalar(_CODES[kind], display=True, control=is_number, form=is_number)
        )
        self._type = nt.type
        first = self._pack(channel.value, None)
        if is_menu:
            first["value.choices"] = list(channel.field.choices)
        elif is_number:
            limits = {"limitLow": channel.low, "limitHigh": channel.high}
            first["display"] = {"units": channel.unit, "precision": channel.digits, **limits}
            first["control"] = limits
        self.pv = SharedPV(initial=first, handler=self)
        self.unfollow = channel.record.follow(
            channel.key, lambda value, stamp_s: self.pv.post(self._pack(value, stamp_s))
        )

    def _pack(self, value: Value, stamp_s: float | None) -> Any:
        alarm = self._channel.record.alarm
        stamp_ns = round((stamp_s or datetime.now(UTC).timestamp()) * NS_PER_S)
        message = self._type()
        message[self._place] = value
        message["alarm"] = {"severity": alarm.severity, "status": alarm.status, "message": alarm.text}
        message["timeStamp"] = {"secondsPastEpoch": stamp_ns // NS_PER_S, "nanoseconds": stamp_ns % NS_PER_S}
        return message

    # Called by p4p, in threads of its own

    def put(self, _: SharedPV, operation: Any) -> None:
        """A client puts."""
        self._loop.call_soon_threadsafe(self._put, operation)

    def onLastDisconnect(self, _: SharedPV) -> None:  # noqa: N802
        """The last client is gone."""
        self._loop.call_soon_threadsafe(self._end)

    def _put(self, operation: Any) -> None:
        raw, is_answered = operation.value()[self._place], False
        options = operation.pvRequest().todict().get("record", {}).get("_options", {})

        def answer(error: str | None) -> None:
            nonlocal is_answered
            if not is_answered:
                operation.done(error=error)
            is_answered = True

        self._has_put = bool(raw)
        self._channel.record.put(self._channel.key, raw, answer)
        if str(options.get("block")) != "true":
            answer(None)

    def _end(self) -> None:
        if self._has_put and self._channel.is_held:
            self._channel.record.put(self._channel.key, 0, lambda _: None)
        self._on_end(self)


class _Held:
    """Channels that are held: each client has a PV of its own, so that its end is seen."""

    def __init__(self, channels: Sequence[Channel], loop: asyncio.AbstractEventLoop) -> None:
        self._channels = {name: channel for channel in channels for name in channel.names}
        self._loop = loop
        self._pvs: set[ValuePv] = set()

    def testChannel(self, name: str) -> bool:  # noqa: N802
        """Whether `name` is a channel of these; called by p4p, as `makeChannel`."""
        return name in self._channels

    def makeChannel(self, name: str, _: str) -> SharedPV:  # noqa: N802
        """The PV of a client that begins to use `name`."""
        value_pv = ValuePv(self._channels[name], self._loop, self._drop)
        self._pvs.add(value_pv)
        return value_pv.pv

    def _drop(self, value_pv: ValuePv) -> None:
        value_pv.unfollow()
        self._pvs.discard(value_pv)


def make_queue_pv(record: FleetRecord) -> SharedPV:
    """The queue as an NTTable, which follows it."""
    table = NTTable([(name, "s") for name in QUEUE_COLUMNS])

    def pack(rows: Rows) -> Any:
        return table.wrap([dict(zip(QUEUE_COLUMNS, row, strict=True)) for row in rows], timestamp=datetime.now(UTC))

    pv = SharedPV(initial=pack(record.queue))
    record.on_queue.append(lambda rows: pv.post(pack(rows)))
    return pv


def _make_submit_pv(record: FleetRecord) -> SharedPV:
    return SharedPV(initial=NTScalar("s").wrap("call it with the text of a job file"), handler=_SubmitHandler(record))


class _SubmitHandler:
    """An RPC with the argument `job`, the text of a job file; it answers the id of the job."""

    def __init__(self, record: FleetRecord) -> None:
        self._record = record
        self._loop = asyncio.get_running_loop()

    def rpc(self, _: SharedPV, operation: Any) -> None:
        """A client calls; in a thread of p4p."""
        asyncio.run_coroutine_threadsafe(self._submit(operation), self._loop)

    async def _submit(self, operation: Any) -> None:
        arguments = operation.value()
        text = arguments.get("query.job", arguments.get("job"))
        try:
            if not isinstance(text, str):
                raise Refusal("bad-value", "the argument `job` is missing", "give the text of a job file")
            operation.done(NTScalar("s").wrap(await self._record.submit(text)))
        except TuttiError as error:
            operation.done(error=describe(error))


@contextmanager
def serve_pva(
    channels: Sequence[Channel], fleet: FleetRecord, prefix: str, interface: str, port: int
) -> Generator[int]:
    """Serve channels, and the queue of a fleet, while the context lasts. port: of TCP, 0 for any; the context is
    the one that is used. Raises `Refusal`."""
    loop = asyncio.get_running_loop()
    static, handler = StaticProvider("tutti"), _Held([channel for channel in channels if channel.is_held], loop)
    pvs = {f"{prefix}QUEUE": make_queue_pv(fleet), f"{prefix}SUBMIT": _make_submit_pv(fleet)}
    for channel in channels:
        if not channel.is_held:
            pvs |= dict.fromkeys(channel.names, ValuePv(channel, loop, lambda _: None).pv)
    for name, pv in pvs.items():
        static.add(name, pv)
    dynamic = DynamicProvider("tutti-held", handler)
    configuration = {
        "EPICS_PVAS_INTF_ADDR_LIST": interface,
        "EPICS_PVAS_SERVER_PORT": str(port),
        "EPICS_PVAS_BROADCAST_PORT": str(port + 1),
        "EPICS_PVAS_AUTO_BEACON_ADDR_LIST": "NO" if interface == "127.0.0.1" else "YES",
    }
    try:
        server = Server(providers=[static, dynamic], conf=configuration, useenv=False)
    except RuntimeError:  # of pvxs, for whatever it cannot bind
        raise refuse_address("PVAccess", interface) from None
    with server:
        yield int(server.conf()["EPICS_PVAS_SERVER_PORT"])
