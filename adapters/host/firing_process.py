"""The firing process: gets open descriptors and bytes, sleeps to just before the instant, spins, and writes.

Parent and child speak over a Unix datagram pair, one JSON object a datagram, the descriptor beside it. The child
runs nothing else, so its wake-up is limited by the scheduler alone. It ends when its parent's end is closed.

Where it may, it runs as a real-time process: with two busy processes on two processors, the 99th percentile of its
wake-up is 8 to 29 µs late in real time, and 3.5 to 3.9 ms without, which is more than all the rest of a start. Where it
may not, it spins for a moment only: a process that spins has used up its turn when its instant comes. Of 400 wake-ups
beside four busy processes 174 were later than 0.2 ms after spinning for 2 ms, and 33 after 0.2 ms.
"""

import asyncio
import json
import os
import select
import socket
import subprocess
import sys
from dataclasses import asdict, dataclass
from itertools import count

from adapters.contract import Fired
from adapters.toolkit.firing import ORDINARY_US, URGENT_US, Order, fire
from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.live import begin_live, raw_ns
from orchestrator.clock.realtime import Urgency, hurry, may_hurry
from orchestrator.link.base import Link, LinkClosed

SPIN_NS = 2000 * NS_PER_US  # from here on it spins: a sleeping process wakes up to a millisecond late
ORDINARY_SPIN_NS = 200 * NS_PER_US
DATAGRAM = 4096


@dataclass(slots=True)
class _Pending:
    order: Order
    fd: int


def serve(control: socket.socket) -> None:
    """The child: fire what is ordered over `control`, until its other end is closed."""
    pending: dict[int, _Pending] = {}
    begin_live()
    spin_ns = SPIN_NS if hurry(Urgency.FIRING) else ORDINARY_SPIN_NS
    while True:
        due = min(pending, key=lambda each: pending[each].order.at_ns, default=None)
        wait_s = None if due is None else max(0.0, (pending[due].order.at_ns - spin_ns - raw_ns()) / 1e9)
        if select.select([control], [], [], wait_s)[0]:
            data, fds, _, _ = socket.recv_fds(control, DATAGRAM, 1)
            if not data:
                return
            _take(control, json.loads(data), fds, pending)
        elif due is not None:
            _fire(control, due, pending.pop(due))


def _take(control: socket.socket, message: dict[str, int | str], fds: list[int], pending: dict[int, _Pending]) -> None:
    number = int(message["id"])
    if "cancel" in message:
        found = pending.pop(number, None)
        if found is not None:
            os.close(found.fd)
        control.send(json.dumps({"id": number, "cancelled": found is not None}).encode())
        return
    data = str(message["data"]).encode("latin-1")
    pending[number] = _Pending(Order(data, int(message["at_ns"]), int(message["latest_ns"])), fds[0])


def _fire(control: socket.socket, number: int, pending: _Pending) -> None:
    while raw_ns() < pending.order.at_ns:
        pass
    answer: dict[str, object] = {"id": number}
    try:
        fired = fire(pending.order, raw_ns, lambda data: os.write(pending.fd, data))
        answer |= asdict(fired)
    except OSError as error:
        answer |= {"error": f"{error.strerror}"}
    finally:
        os.close(pending.fd)
    control.send(json.dumps(answer).encode())


class _ProcessOrder:
    """An order that the firing process holds."""

    def __init__(self, firer: "ProcessFirer", number: int, link: Link, data: bytes) -> None:
        self._firer = firer
        self._number = number
        self._link = link
        self._data = data
        self.fired: asyncio.Future[Fired] = asyncio.get_running_loop().create_future()
        self.cancelled = False

    def cancel(self) -> bool:
        if self.fired.done() or self.cancelled:
            return self.cancelled
        # What the child answers decides: `done` raises CancelledError when it really was in time.
        self.cancelled = True
        self._firer.send({"id": self._number, "cancel": 1})
        return True

    async def done(self) -> Fired:
        return await asyncio.shield(self.fired)

    def answer(self, message: dict[str, object]) -> None:
        if self.fired.done():
            return
        if "error" in message:
            self.fired.set_exception(LinkClosed(f"{self._link.place}: {message['error']}"))
        elif message.get("cancelled"):
            self.fired.cancel()
        elif "written_ns" in message:
            fired = Fired(int(str(message["written_ns"])), int(str(message["after_ns"])), bool(message["late"]))
            if not fired.late:
                self._link.wrote(fired.written_ns, self._data)
            self.fired.set_result(fired)


class ProcessFirer:
    """The parent's side: starts the firing process and hands it orders. Needs a running asyncio loop."""

    def __init__(self) -> None:
        self.late_us = URGENT_US if may_hurry(Urgency.FIRING) else ORDINARY_US
        self._control, child = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        command = [sys.executable, "-m", "adapters.host.firing_process", str(child.fileno())]
        self._process = subprocess.Popen(command, pass_fds=[child.fileno()], stdin=subprocess.DEVNULL)
        child.close()
        self._control.setblocking(False)
        self._orders: dict[int, _ProcessOrder] = {}
        self._numbers = count()
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._control, self._read)

    def schedule(self, link: Link, data: bytes, at_ns: int, latest_ns: int) -> _ProcessOrder:
        number = next(self._numbers)
        order = self._orders[number] = _ProcessOrder(self, number, link, data)
        message = {"id": number, "data": data.decode("latin-1"), "at_ns": at_ns, "latest_ns": latest_ns}
        socket.send_fds(self._control, [json.dumps(message).encode()], [link.fileno()])
        return order

    def send(self, message: dict[str, int]) -> None:
        self._control.send(json.dumps(message).encode())

    def _read(self) -> None:
        try:
            data = self._control.recv(DATAGRAM)
        except BlockingIOError:
            return
        if not data:
            self._lost()
            return
        message = json.loads(data)
        order = self._orders.get(message["id"])
        if order is not None:
            order.answer(message)
            if order.fired.done():
                del self._orders[message["id"]]

    def _lost(self) -> None:
        """The process is gone: nothing that it held will fire."""
        self._loop.remove_reader(self._control)
        orders, self._orders = self._orders, {}
        for order in orders.values():
            if not order.fired.done():
                order.fired.set_exception(LinkClosed("the firing process has died"))

    def close(self) -> None:
        """End the process."""
        self._loop.remove_reader(self._control)
        self._control.close()
        self._process.wait(timeout=5)


if __name__ == "__main__":
    serve(socket.socket(fileno=int(sys.argv[1])))
