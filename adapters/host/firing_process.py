"""The firing process: it receives open descriptors and bytes, sleeps until just before the instant, spins, and writes.

Parent and child communicate over a Unix datagram pair, one JSON object per datagram, with the descriptor as ancillary
data. The child runs nothing else, so that only the scheduler limits its wake-up. It ends when its parent's end is
closed.

If permitted, it runs as a real-time process: with two busy processes on two processors, the 99th percentile of its
wake-up delay is 8 to 29 µs in real time, and 3.5 to 3.9 ms without, which exceeds all other terms of a start. If not
permitted, it spins for a moment only: a process that spins has used up its time slice when its instant comes. Of 400
wake-ups with four busy processes, 174 were later than 0.2 ms after spinning for 2 ms, and 33 after spinning for 0.2 ms.
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

from adapters.contract import WriteResult
from adapters.toolkit.firing import ORDINARY_DELAY_US, REALTIME_DELAY_US, WriteOrder, write_at_instant
from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.live import prepare_live_process, raw_ns
from orchestrator.clock.realtime import RealtimePriority, can_set_realtime_priority, set_realtime_priority
from orchestrator.link.base import Link, LinkClosed

SPIN_NS = 2000 * NS_PER_US  # from here on it spins: a sleeping process wakes up to a millisecond late
ORDINARY_SPIN_NS = 200 * NS_PER_US
DATAGRAM = 4096


@dataclass(slots=True)
class _PendingWrite:
    order: WriteOrder
    fd: int


def run_child(control: socket.socket) -> None:
    """Run the child: fire the orders received over `control` until its other end is closed."""
    pending: dict[int, _PendingWrite] = {}
    prepare_live_process()
    spin_ns = SPIN_NS if set_realtime_priority(RealtimePriority.FIRING) else ORDINARY_SPIN_NS
    while True:
        due = min(pending, key=lambda each: pending[each].order.at_ns, default=None)
        wait_s = None if due is None else max(0.0, (pending[due].order.at_ns - spin_ns - raw_ns()) / 1e9)
        if select.select([control], [], [], wait_s)[0]:
            data, fds, _, _ = socket.recv_fds(control, DATAGRAM, 1)
            if not data:
                return
            _handle_message(control, json.loads(data), fds, pending)
        elif due is not None:
            _write_pending(control, due, pending.pop(due))


def _handle_message(
    control: socket.socket, message: dict[str, int | str], fds: list[int], pending: dict[int, _PendingWrite]
) -> None:
    number = int(message["id"])
    if "cancel" in message:
        found = pending.pop(number, None)
        if found is not None:
            os.close(found.fd)
        control.send(json.dumps({"id": number, "cancelled": found is not None}).encode())
        return
    data = str(message["data"]).encode("latin-1")
    pending[number] = _PendingWrite(WriteOrder(data, int(message["at_ns"]), int(message["latest_ns"])), fds[0])


def _write_pending(control: socket.socket, number: int, pending: _PendingWrite) -> None:
    while raw_ns() < pending.order.at_ns:
        pass
    answer: dict[str, object] = {"id": number}
    try:
        fired = write_at_instant(pending.order, raw_ns, lambda data: os.write(pending.fd, data))
        answer |= asdict(fired)
    except OSError as error:
        answer |= {"error": f"{error.strerror}"}
    finally:
        os.close(pending.fd)
    control.send(json.dumps(answer).encode())


class _ProcessWrite:
    """A write that is scheduled in the firing process."""

    def __init__(self, firer: "ProcessTimedWriter", number: int, link: Link, data: bytes) -> None:
        self._firer = firer
        self._number = number
        self._link = link
        self._data = data
        self.fired: asyncio.Future[WriteResult] = asyncio.get_running_loop().create_future()
        self.cancelled = False

    def cancel_write(self) -> bool:
        if self.fired.done() or self.cancelled:
            return self.cancelled
        # The child's reply decides: `wait_until_written` raises CancelledError when the cancellation was in time.
        self.cancelled = True
        self._firer.send_message({"id": self._number, "cancel": 1})
        return True

    async def wait_until_written(self) -> WriteResult:
        return await asyncio.shield(self.fired)

    def handle_reply(self, message: dict[str, object]) -> None:
        if self.fired.done():
            return
        if "error" in message:
            self.fired.set_exception(LinkClosed(f"{self._link.endpoint}: {message['error']}"))
        elif message.get("cancelled"):
            self.fired.cancel()
        elif "written_ns" in message:
            fired = WriteResult(int(str(message["written_ns"])), int(str(message["after_ns"])), bool(message["late"]))
            if not fired.late:
                self._link.record_write(fired.written_ns, self._data)
            self.fired.set_result(fired)


class ProcessTimedWriter:
    """The parent's side: it starts the firing process and sends it orders. Needs a running asyncio loop."""

    def __init__(self) -> None:
        self.max_delay_us = (
            REALTIME_DELAY_US if can_set_realtime_priority(RealtimePriority.FIRING) else ORDINARY_DELAY_US
        )
        self._control, child = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        command = [sys.executable, "-m", "adapters.host.firing_process", str(child.fileno())]
        self._process = subprocess.Popen(command, pass_fds=[child.fileno()], stdin=subprocess.DEVNULL)
        child.close()
        self._control.settimeout(0.0)
        self._writes: dict[int, _ProcessWrite] = {}
        self._numbers = count()
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._control, self._read_replies)

    def schedule_write(self, link: Link, data: bytes, at_ns: int, latest_ns: int) -> _ProcessWrite:
        number = next(self._numbers)
        order = self._writes[number] = _ProcessWrite(self, number, link, data)
        message = {"id": number, "data": data.decode("latin-1"), "at_ns": at_ns, "latest_ns": latest_ns}
        socket.send_fds(self._control, [json.dumps(message).encode()], [link.fileno()])
        return order

    def send_message(self, message: dict[str, int]) -> None:
        self._control.send(json.dumps(message).encode())

    def _read_replies(self) -> None:
        try:
            data = self._control.recv(DATAGRAM)
        except BlockingIOError:
            return
        if not data:
            self._handle_process_end()
            return
        message = json.loads(data)
        order = self._writes.get(message["id"])
        if order is not None:
            order.handle_reply(message)
            if order.fired.done():
                del self._writes[message["id"]]

    def _handle_process_end(self) -> None:
        """Handle the end of the process: none of its pending writes will happen."""
        self._loop.remove_reader(self._control)
        orders, self._writes = self._writes, {}
        for order in orders.values():
            if not order.fired.done():
                order.fired.set_exception(LinkClosed("the firing process has died"))

    def close(self) -> None:
        """End the process."""
        self._loop.remove_reader(self._control)
        self._control.close()
        self._process.wait(timeout=5)


if __name__ == "__main__":
    run_child(socket.socket(fileno=int(sys.argv[1])))
