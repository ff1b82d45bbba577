"""The live clock: this machine's `CLOCK_MONOTONIC_RAW`, on Windows its performance counter, and the running asyncio
loop for calls."""

import asyncio
import gc
import sys
import time
import uuid
from collections.abc import Callable
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.collection import exempt_objects
from orchestrator.clock.utc import format_rfc3339


def raw_ns() -> int:
    """Return this machine's monotonic time, never slewed nor stepped; the same for all processes of one kernel."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)


if sys.platform == "win32":
    raw_ns = time.perf_counter_ns


@cache
def boot_id() -> str:
    """Return the id of this boot of this kernel: processes with the same one share `raw_ns` exactly. Where the kernel
    states none, as on Windows and macOS, it is one of this process alone, as of one on another computer."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except FileNotFoundError:
        return uuid.uuid4().hex


THREAD_SWITCH_S = 0.0005
"""The bus's threads share the interpreter with the loop that timestamps data from controllers. By default Python
lets a thread keep the interpreter for 5 ms, which would widen every timestamp, and delay every message, by as
much."""


def prepare_live_process() -> None:
    """Prepare a live process, once everything is loaded: exempt existing objects from garbage collection, and
    shorten the threads' time slices.

    Python pauses a process for garbage collection again and again, in proportion to its objects: 30 ms with the
    objects of an adapter host, during which nothing is sent, timestamped or stopped. Afterwards only newer objects
    are examined.
    """
    gc.collect()
    exempt_objects()
    sys.setswitchinterval(THREAD_SWITCH_S)


class _LiveTimer:
    """Waits on the loop's clock, then checks the raw one: the loop's clock is slewed, and may be early."""

    def __init__(self, at_ns: int, callback: Callable[[], None]) -> None:
        self._at_ns = at_ns
        self._callback = callback
        self._loop = asyncio.get_running_loop()
        self._handle = self._schedule_wake_up()

    def _schedule_wake_up(self) -> asyncio.TimerHandle:
        return self._loop.call_later(max(0, self._at_ns - raw_ns()) / NS_PER_S, self._call_if_due)

    def _call_if_due(self) -> None:
        if raw_ns() < self._at_ns:
            self._handle = self._schedule_wake_up()
        else:
            self._callback()

    def cancel(self) -> None:
        self._handle.cancel()


class LiveClock:
    """The `Clock` of a live process. `call_at_ns` needs a running asyncio loop."""

    def __init__(self) -> None:
        self._kernel_id = boot_id()

    @property
    def kernel_id(self) -> str:
        return self._kernel_id

    def now_ns(self) -> int:
        return raw_ns()

    def utc(self) -> str:
        return format_rfc3339(datetime.now(UTC))

    def call_at_ns(self, at_ns: int, callback: Callable[[], None], leeway_ns: int = 0) -> _LiveTimer:
        return _LiveTimer(at_ns + leeway_ns, callback)
