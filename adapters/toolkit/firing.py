"""Timed writes: bytes written at an instant. Bounds of their delay, the order, the final step common to all timed
writers, and the writer that uses the event loop.

In live runs a separate process writes (`adapters.host.firing_process`): next to a busy event loop even a thread is late
by milliseconds. In virtual time the loop is exact, so the loop itself writes, through the same final step.
"""

import asyncio
from collections.abc import Callable
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from adapters.contract import TimedWriter
from orchestrator.clock.base import NS_PER_US, Clock, ClockTimer
from orchestrator.clock.latency import StartLatency
from orchestrator.link.base import Link
from orchestrator.link.timed_write import WriteOrder, WriteResult, write_at_instant
from orchestrator.model.errors import ControllerFault
from orchestrator.model.messages import BudgetTerm

Microseconds = Annotated[int, Field(ge=0, le=1_000_000)]

VIRTUAL_DELAY_US = 200
"""Largest delay of a start command in virtual time, where nothing delays it."""
REALTIME_DELAY_US = 1000
"""Largest delay in a real-time process: of some hundreds of writes on a virtual machine, whose processors other
machines may occupy for a moment, 99 in a hundred were less than 60 µs late, and the latest 270 to 300 µs."""
ORDINARY_DELAY_US = 5000
"""Largest delay in a process of ordinary priority: of 400 wake-ups with two and with four computing processes, on two
processors, 16 and 33 were later than 200 µs, one and none later than this."""


class FiringOptions(BaseModel):
    """Options of a make whose moves are started by bytes at an instant. The step's budget guarantees these bounds."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    fire_early_us: Microseconds = Field(default=0, description="The largest advance of a start command.")
    fire_late_us: Microseconds = Field(
        default=VIRTUAL_DELAY_US,
        description="The largest delay of a start command. A later command is sent only if the job allows more than "
        f"all participants guarantee. Default: {REALTIME_DELAY_US} on a live host, and {ORDINARY_DELAY_US} on one that "
        "may not run real-time processes.",
    )

    def host_term(self) -> BudgetTerm:
        """Return the host's term of the interval of a start relative to T0."""
        early_ns, late_ns = self.fire_early_us * NS_PER_US, self.fire_late_us * NS_PER_US
        return BudgetTerm(name="host", earliest_ns=-early_ns, latest_ns=late_ns)

    def latest_write_ns(self, at_ns: int, start_tolerance_ns: int) -> int:
        """Return the last instant at which a write due at `at_ns` may happen, if the step tolerates
        `start_tolerance_ns` beyond the guarantee."""
        return at_ns + self.fire_late_us * NS_PER_US + start_tolerance_ns

    def excess_delay_ns(self, fired: WriteResult) -> int:
        """Return the delay of a write beyond the guarantee."""
        return max(0, fired.after_ns - self.fire_late_us * NS_PER_US)


LEARNED_STARTS = "learned-starts"
"""The term of a budget that unusual starts have added, and that is forgotten again."""


def learned_terms(start: StartLatency) -> tuple[BudgetTerm, ...]:
    """Return the term of a start that earlier starts outside the declared bounds have added; none without them."""
    early_ns, late_ns = start.learned_early_ns, start.learned_late_ns
    if not early_ns and not late_ns:
        return ()
    return (BudgetTerm(name=LEARNED_STARTS, earliest_ns=-early_ns, latest_ns=late_ns),)


def apply_writer_delay(timed_writer: TimedWriter, options: BaseModel) -> BaseModel:
    """Return `options` with the delay of this timed writer, unless the fleet file sets one."""
    if isinstance(options, FiringOptions) and "fire_late_us" not in options.model_fields_set:
        return options.model_copy(update={"fire_late_us": timed_writer.max_delay_us})
    return options


def missed_write_fault(what: str, link: Link, fired: WriteResult) -> ControllerFault:
    """Return the fault to raise when `what` was not written to `link` because its instant had passed."""
    return ControllerFault(
        "late",
        f"the instant to write {what} to {link.endpoint} was missed: it was {fired.after_ns / 1e6:.1f} ms "
        "past when the firing process was scheduled",
        "let the host run real-time processes, reduce its load, or allow a larger delay: "
        "`max_start_skew` of the job, and option fire_late_us where a trigger line, a stream or the next "
        "controller of a bus depends on the write",
    )


class _LoopWrite:
    """A write that waits for its instant on the clock."""

    def __init__(self, clock: Clock, link: Link, order: WriteOrder, wake_ns: int) -> None:
        self._fired: asyncio.Future[WriteResult] = asyncio.get_running_loop().create_future()
        self._clock = clock
        self._link = link
        self._order = order
        self._timer: ClockTimer = clock.call_at_ns(order.at_ns + wake_ns, self._write_now)

    def _write_now(self) -> None:
        if not self._fired.done():
            try:
                self._fired.set_result(write_at_instant(self._order, self._clock.now_ns, self._link.write))
            except Exception as error:
                self._fired.set_exception(error)

    def cancel_write(self) -> bool:
        if self._fired.done():
            return False
        self._timer.cancel()
        self._fired.cancel()
        return True

    async def wait_until_written(self) -> WriteResult:
        return await asyncio.shield(self._fired)


class LoopTimedWriter:
    """Write from the event loop, which is exact in virtual time. `wake_ns` draws the simulated wake-up delay of a
    process."""

    max_delay_us = VIRTUAL_DELAY_US

    def __init__(self, clock: Clock, wake_ns: Callable[[], int] = lambda: 0) -> None:
        self._clock = clock
        self._wake_ns = wake_ns

    def schedule_write(self, link: Link, data: bytes, at_ns: int, latest_ns: int) -> _LoopWrite:
        return _LoopWrite(self._clock, link, WriteOrder(data, at_ns, latest_ns), self._wake_ns())
