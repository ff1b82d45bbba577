"""Bytes that are written at an instant: how late they may be, the order, the last step that all firers share, and the
firer of a loop.

Live, a process of its own fires (`adapters.host.firing_process`): beside a busy event loop even a thread is late by
milliseconds. In virtual time the loop is exact, so it fires itself, through the same last step.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from adapters.contract import DriverFault, Fired, Firer
from orchestrator.clock.base import NS_PER_US, Clock, Timer
from orchestrator.link.base import Link
from orchestrator.model.messages import Term

Micro = Annotated[int, Field(ge=0, le=1_000_000)]

PUNCTUAL_US = 200
"""How late a start may be written in virtual time, where nothing delays it."""
URGENT_US = 1000
"""How late by a real-time process: of some hundreds on a virtual machine, whose processors others may have for a
moment, 99 in a hundred were less than 60 µs late, and the latest 270 to 300 µs."""
ORDINARY_US = 5000
"""How late by a process that is no more urgent than others: of 400 wake-ups beside two and beside four that compute, on
two processors, 16 and 33 were later than 200 µs, one and none later than this."""


class FiringOptions(BaseModel):
    """Options of a make that is started by bytes at an instant. Bounds that the step's budget promises."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    fire_early_us: Micro = Field(default=0, description="How much too early what starts a move may be written.")
    fire_late_us: Micro = Field(
        default=PUNCTUAL_US,
        description=f"How much too late. Later it is written only if the job allows for more than all members promise, "
        f"and said so. Without it {URGENT_US} on a live host, and {ORDINARY_US} on one that may not run real-time "
        "processes.",
    )

    def host_term(self) -> Term:
        """What the host adds to where a start lies about T0."""
        early_ns, late_ns = self.fire_early_us * NS_PER_US, self.fire_late_us * NS_PER_US
        return Term(name="host", earliest_ns=-early_ns, latest_ns=late_ns)

    def latest_ns(self, at_ns: int, slack_ns: int) -> int:
        """Until when what is due at `at_ns` may be written, if the step can bear `slack_ns` more than is promised."""
        return at_ns + self.fire_late_us * NS_PER_US + slack_ns

    def beyond_ns(self, fired: Fired) -> int:
        """How much later than promised it was written."""
        return max(0, fired.after_ns - self.fire_late_us * NS_PER_US)


def as_punctual_as(firer: Firer, options: BaseModel) -> BaseModel:
    """`options` with the lateness that the firer may have, unless the fleet file says it."""
    if isinstance(options, FiringOptions) and "fire_late_us" not in options.model_fields_set:
        return options.model_copy(update={"fire_late_us": firer.late_us})
    return options


@dataclass(frozen=True, slots=True)
class Order:
    """Write `data` at host time `at_ns`, and not at all if that could only be after `latest_ns`."""

    data: bytes
    at_ns: int
    latest_ns: int


def fire(order: Order, now_ns: Callable[[], int], write: Callable[[bytes], object]) -> Fired:
    """The last step: `at_ns` has come. Never fires late."""
    instant_ns = now_ns()
    late = instant_ns > order.latest_ns
    if not late:
        write(order.data)
    return Fired(instant_ns, instant_ns - order.at_ns, late)


def missed(what: str, link: Link, fired: Fired) -> DriverFault:
    """What to raise when `what` was not written to `link`, because its instant was past."""
    return DriverFault(
        "late",
        f"the instant to write {what} to {link.place} was missed: it was {fired.after_ns / 1e6:.1f} ms past when the "
        "process that fires had the processor",
        "let the host run real-time processes or give it less to do, or allow for more: `max_start_skew` of the job, "
        "and where a line, a stream or the next unit of a bus hangs on it, option fire_late_us",
    )


class _LoopOrder:
    """An order that waits on the clock."""

    def __init__(self, clock: Clock, link: Link, order: Order, wake_ns: int) -> None:
        self._fired: asyncio.Future[Fired] = asyncio.get_running_loop().create_future()
        self._clock = clock
        self._link = link
        self._order = order
        self._timer: Timer = clock.call_at_ns(order.at_ns + wake_ns, self._fire)

    def _fire(self) -> None:
        if not self._fired.done():
            try:
                self._fired.set_result(fire(self._order, self._clock.now_ns, self._link.write))
            except Exception as error:
                self._fired.set_exception(error)

    def cancel(self) -> bool:
        if self._fired.done():
            return False
        self._timer.cancel()
        self._fired.cancel()
        return True

    async def done(self) -> Fired:
        return await asyncio.shield(self._fired)


class LoopFirer:
    """Fires from the event loop, which is exact in virtual time. `wake_ns` draws how late a process would wake."""

    late_us = PUNCTUAL_US

    def __init__(self, clock: Clock, wake_ns: Callable[[], int] = lambda: 0) -> None:
        self._clock = clock
        self._wake_ns = wake_ns

    def schedule(self, link: Link, data: bytes, at_ns: int, latest_ns: int) -> _LoopOrder:
        return _LoopOrder(self._clock, link, Order(data, at_ns, latest_ns), self._wake_ns())
