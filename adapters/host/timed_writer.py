"""The adapter host's side of the firing process, `adapters.host.firing_process`."""

import asyncio
import json
import socket
import subprocess
import sys
from itertools import count

from adapters.host.firing_process import DATAGRAM
from adapters.toolkit.firing import ORDINARY_DELAY_US, REALTIME_DELAY_US
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.live import raw_ns
from orchestrator.clock.realtime import RealtimePriority, can_set_realtime_priority
from orchestrator.link.base import Link, LinkClosed
from orchestrator.link.timed_write import WriteResult

ANSWER_S = 5.0  # after the latest instant of a write; the process is urgent, and answers at once
START_S = 300.0  # for its first answer: a computer may be slow to start it


class _ProcessWrite:
    """A write that is scheduled in the firing process."""

    def __init__(self, firer: "ProcessTimedWriter", number: int, link: Link, data: bytes, latest_ns: int) -> None:
        self._firer = firer
        self._latest_ns = latest_ns
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
        left_s = max(0, self._latest_ns - raw_ns()) / NS_PER_S + self._firer.answer_s
        await asyncio.wait([self.fired], timeout=left_s)
        if not self.fired.done():
            # It must not write later, when it goes on.
            self._firer.kill()
        return await asyncio.shield(self.fired)

    def handle_reply(self, message: dict[str, object]) -> None:
        if self.fired.done():
            return
        if "error" in message:
            self.fired.set_exception(LinkClosed(f"{self._link.endpoint}: {message['error']}"))
        elif message.get("cancelled"):
            self.fired.cancel()
        elif "written_ns" in message:
            result = WriteResult(int(str(message["written_ns"])), int(str(message["after_ns"])), bool(message["late"]))
            if not result.late:
                self._link.record_write(result.written_ns, self._data)
            self.fired.set_result(result)


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
        self.answer_s = START_S
        """How long the process may take for an answer."""
        self.is_alive = True
        """Whether the process can be given orders. Without it no start by the host is possible."""
        self._numbers = count()
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._control, self._read_replies)

    def schedule_write(self, link: Link, data: bytes, at_ns: int, latest_ns: int) -> _ProcessWrite:
        number = next(self._numbers)
        order = self._writes[number] = _ProcessWrite(self, number, link, data, latest_ns)
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
        self.answer_s = ANSWER_S
        message = json.loads(data)
        order = self._writes.get(message["id"])
        if order is not None:
            order.handle_reply(message)
            if order.fired.done():
                del self._writes[message["id"]]

    def _handle_process_end(self) -> None:
        """Handle the end of the process: none of its pending writes will happen."""
        self.is_alive = False
        self._loop.remove_reader(self._control)
        orders, self._writes = self._writes, {}
        for order in orders.values():
            if not order.fired.done():
                order.fired.set_exception(LinkClosed("the firing process has died"))

    def kill(self) -> None:
        """Kill the process, which hangs: none of its pending writes will happen."""
        self._process.kill()

    def close(self) -> None:
        """End the process."""
        self._loop.remove_reader(self._control)
        self._control.close()
        self._process.wait(timeout=5)
