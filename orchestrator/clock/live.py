"""The live clock: this machine's `CLOCK_MONOTONIC_RAW`, and the running asyncio loop for calls."""

import asyncio
import gc
import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.utc import rfc3339


def raw_ns() -> int:
    """This machine's monotonic time, never slewed nor stepped; the same for all processes of one kernel."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)


def boot_id() -> str:
    """Names this boot of this kernel: processes with the same one share `raw_ns` exactly."""
    return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()


SWITCH_S = 0.0005
"""The bus's threads share the interpreter with the loop that stamps what controllers send. Python lets a thread keep it
for 5 ms by default, which would widen every stamp, and hold up every message, by as much."""


def begin_live() -> None:
    """To be called once all is loaded: what is alive now is not looked through for garbage any more, and threads take
    short turns.

    Python stops a process for its garbage again and again, for as long as it has objects: 30 ms with what an adapter
    host has loaded, in which nothing is sent, stamped or stopped. Afterwards it looks through what came later alone.
    """
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(SWITCH_S)


class _LiveTimer:
    """Waits on the loop's clock, then looks at the raw one: the loop's is slewed, and may be early."""

    def __init__(self, at_ns: int, callback: Callable[[], None]) -> None:
        self._at_ns = at_ns
        self._callback = callback
        self._loop = asyncio.get_running_loop()
        self._handle = self._wait()

    def _wait(self) -> asyncio.TimerHandle:
        return self._loop.call_later(max(0, self._at_ns - raw_ns()) / NS_PER_S, self._due)

    def _due(self) -> None:
        if raw_ns() < self._at_ns:
            self._handle = self._wait()
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
        return rfc3339(datetime.now(UTC))

    def call_at_ns(self, at_ns: int, callback: Callable[[], None], leeway_ns: int = 0) -> _LiveTimer:
        return _LiveTimer(at_ns + leeway_ns, callback)
