"""The firing process: it receives open descriptors and bytes, sleeps until just before the instant, spins, and writes.

Parent and child communicate over a Unix datagram pair, one JSON object per datagram, with the descriptor as ancillary
data. The child runs nothing else, so that only the scheduler limits its wake-up. It ends when its parent's end is
closed. The parent's side is `adapters.host.timed_writer`.

If permitted, it runs as a real-time process: with two busy processes on two processors, the 99th percentile of its
wake-up delay is 8 to 29 µs in real time, and 3.5 to 3.9 ms without, which exceeds all other terms of a start. If not
permitted, it spins for a moment only: a process that spins has used up its time slice when its instant comes. Of 400
wake-ups with four busy processes, 174 were later than 0.2 ms after spinning for 2 ms, and 33 after spinning for 0.2 ms.
"""

import json
import os
import select
import socket
import sys
from dataclasses import asdict, dataclass

from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.live import prepare_live_process, raw_ns
from orchestrator.clock.realtime import RealtimePriority, set_realtime_priority
from orchestrator.link.timed_write import WriteOrder, write_at_instant

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
        due = min(pending, key=lambda number: pending[number].order.at_ns, default=None)
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
        pending_write = pending.pop(number, None)
        if pending_write is not None:
            os.close(pending_write.fd)
        control.send(json.dumps({"id": number, "cancelled": pending_write is not None}).encode())
        return
    data = str(message["data"]).encode("latin-1")
    pending[number] = _PendingWrite(WriteOrder(data, int(message["at_ns"]), int(message["latest_ns"])), fds[0])


def _write_pending(control: socket.socket, number: int, pending: _PendingWrite) -> None:
    while raw_ns() < pending.order.at_ns:
        pass
    answer: dict[str, object] = {"id": number}
    try:
        result = write_at_instant(pending.order, raw_ns, lambda data: os.write(pending.fd, data))
        answer |= asdict(result)
    except OSError as error:
        answer |= {"error": f"{error.strerror}"}
    finally:
        os.close(pending.fd)
    control.send(json.dumps(answer).encode())


if __name__ == "__main__":
    run_child(socket.socket(fileno=int(sys.argv[1])))
