"""The two crossings between the event loop and Zenoh's threads: a sender outwards, an inbox inwards.

The loop never calls a Zenoh function that could wait for the transport: a put to a stopped router blocks for
seconds. And nothing is published from a Zenoh callback, which would stall all other input.
"""

import asyncio
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import TypeVar

from orchestrator.bus.base import Priority
from orchestrator.bus.limits import MAX_BYTES_QUEUED, MAX_CALLS_QUEUED, MAX_ESTOPS_QUEUED, LossCounter

T = TypeVar("T")

_LOG = logging.getLogger(__name__)

_ORDER = (Priority.ESTOP, Priority.EVENT, Priority.STATE)

SLOW_CALL_S = 1.0
"""A call to Zenoh that takes longer is logged."""

_BATCH = 64
_BATCH_NS = 10_000_000
"""Calls from the inbox, and the time for them, before the loop runs other work: a heartbeat must not wait for many
large messages."""


class _PriorityLanes:
    """Calls by priority, the most urgent first, and never more than a process can hold (`orchestrator.bus.limits`).

    Beyond `limit` the oldest `STATE` call is lost; of the others, which a process should never have so many of, the new
    one is lost, and counted.
    """

    def __init__(self, name: str, limit: int) -> None:
        self._limits = {Priority.STATE: limit, Priority.EVENT: MAX_CALLS_QUEUED, Priority.ESTOP: MAX_ESTOPS_QUEUED}
        self._lanes: dict[Priority, deque[tuple[int, Callable[[], None]]]] = {priority: deque() for priority in _ORDER}
        self._bytes = 0
        self._losses = LossCounter(name, time.monotonic_ns)

    def __len__(self) -> int:
        return sum(len(lane) for lane in self._lanes.values())

    def add_call(self, priority: Priority, call: Callable[[], None], size: int = 0) -> None:
        """Add a call that holds a payload of `size` bytes."""
        lane = self._lanes[priority]
        full = len(lane) >= self._limits[priority]
        if priority is Priority.STATE and full:
            self._bytes -= lane.popleft()[0]
        elif full or (priority is not Priority.ESTOP and self._bytes + size > MAX_BYTES_QUEUED):
            self._losses.count_loss(f"a message was left out: {len(self)} with {self._bytes} bytes wait already")
            return
        lane.append((size, call))
        self._bytes += size

    def discard_calls(self) -> None:
        for lane in self._lanes.values():
            lane.clear()
        self._bytes = 0

    def take_call(self) -> Callable[[], None] | None:
        for lane in self._lanes.values():
            if lane:
                size, call = lane.popleft()
                self._bytes -= size
                return call
        return None


class SenderThread:
    """A thread that makes queued calls one after the other, e-stops first."""

    def __init__(self, name: str, limit: int) -> None:
        self._lanes = _PriorityLanes(name, limit)
        self._changed = threading.Condition()
        self._busy = False
        self._stopping = False
        self._thread = threading.Thread(target=self._run_calls, name=name, daemon=True)
        self._thread.start()

    @property
    def backlog(self) -> int:
        """Queued calls that are not done."""
        with self._changed:
            return len(self._lanes) + self._busy

    def queue_call(self, priority: Priority, call: Callable[[], None], size: int = 0) -> None:
        """Queue `call`, which holds a payload of `size` bytes. Never waits for another call."""
        with self._changed:
            self._lanes.add_call(priority, call, size)
            self._changed.notify()

    def stop(self, timeout_s: float) -> int:
        """Make the remaining calls, then end. Returns how many calls were not made in time: they are lost, except
        the one that is in progress."""
        with self._changed:
            self._stopping = True
            self._changed.notify()
        self._thread.join(timeout_s)
        with self._changed:
            count = len(self._lanes) + self._busy
            self._lanes.discard_calls()
            return count

    def wait_for_call(self, timeout_s: float) -> None:
        """Wait for the end of a call that is in progress."""
        self._thread.join(timeout_s)

    def _run_calls(self) -> None:
        while (call := self._take_call()) is not None:
            began_s = time.monotonic()
            try:
                call()
            except Exception:
                # The transport's error must reach the log and must not end the thread.
                _LOG.exception("%s: a call to the bus failed", self._thread.name)
            # After 5 s of blocking Zenoh closes the transport and loses its contents, without an error.
            if (took_s := time.monotonic() - began_s) > SLOW_CALL_S:
                _LOG.warning("%s: the router took %.1f s for one call; samples may be lost", self._thread.name, took_s)

    def _take_call(self) -> Callable[[], None] | None:
        with self._changed:
            self._busy = False
            while (call := self._lanes.take_call()) is None and not self._stopping:
                self._changed.wait()
            self._busy = call is not None
            return call


class LoopInbox:
    """Passes calls from Zenoh's threads to the event loop, e-stops first and never more than it can hold."""

    def __init__(self, loop: asyncio.AbstractEventLoop, limit: int) -> None:
        self._loop = loop
        self._lanes = _PriorityLanes("bus-inbox", limit)
        self._lock = threading.Lock()
        self._awake = False
        self._closed = False

    def queue_call(self, priority: Priority, call: Callable[[], None], size: int = 0) -> None:
        """Queue `call`, which holds a payload of `size` bytes, for the loop. Callable from any thread; never waits for
        the loop."""
        with self._lock:
            if self._closed or self._loop.is_closed():
                return
            self._lanes.add_call(priority, call, size)
            if not self._awake:
                self._awake = True
                self._loop.call_soon_threadsafe(self._run_calls)

    def close(self) -> None:
        """Discard what is left and accept no more."""
        with self._lock:
            self._closed = True

    def _run_calls(self) -> None:
        until_ns = time.monotonic_ns() + _BATCH_NS
        for number in range(_BATCH):
            if number and time.monotonic_ns() > until_ns:
                break
            with self._lock:
                call = None if self._closed else self._lanes.take_call()
                if call is None:
                    self._awake = False
                    return
            try:
                call()
            except Exception as error:
                # One faulty callback must not prevent the others.
                self._loop.call_exception_handler({"message": "a callback of the bus failed", "exception": error})
        self._loop.call_soon(self._run_calls)


async def run_in_thread(name: str, call: Callable[[], T]) -> T:
    """Make `call` in a thread of its own, and wait for it. The thread is abandoned when the wait is given up.

    The loop's executor is not used because it waits for stuck calls when the loop is closed. `call`, with the Zenoh
    objects that it holds, is released before its waiter continues: a thread that releases them while the interpreter
    ends would end the process by SIGABRT, because it is inside Zenoh when it may not return.
    """
    loop = asyncio.get_running_loop()
    future: asyncio.Future[T] = loop.create_future()

    def settle_future(result: T | None, error: Exception | None) -> None:
        if future.done():
            return
        if error is not None:
            future.set_exception(error)
        else:
            future.set_result(result)  # pyright: ignore[reportArgumentType]

    def run_call() -> None:
        nonlocal call
        result: T | None = None
        failure: Exception | None = None
        try:
            result = call()
        except Exception as error:
            failure = error
        del call
        # A closed loop has no waiters.
        if not loop.is_closed():
            loop.call_soon_threadsafe(settle_future, result, failure)

    threading.Thread(target=run_call, name=name, daemon=True).start()
    return await future
