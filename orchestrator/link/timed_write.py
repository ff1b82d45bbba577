"""Bytes that are written at an instant: the order, the final step, and its result.

The firing process imports this and little else, so that it is there soon after the start of a host."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class WriteResult:
    """Result of a timed write.

    written_ns: host time of the write, at its beginning.
    after_ns: delay after the requested instant, at the end of the write.
    late: the write could only have happened after `latest_ns`, and was skipped."""

    written_ns: int
    after_ns: int
    late: bool


@dataclass(frozen=True, slots=True)
class WriteOrder:
    """Write `data` at host time `at_ns`; skip the write if it can only happen after `latest_ns`."""

    data: bytes
    at_ns: int
    latest_ns: int


def write_at_instant(order: WriteOrder, now_ns: Callable[[], int], write: Callable[[bytes], object]) -> WriteResult:
    """Perform the final step once `at_ns` has come. Never begins a write too late.

    The delay counts to the end of the write: the process may lose the processor between the look at the clock and the
    write.
    """
    instant_ns = now_ns()
    if instant_ns > order.latest_ns:
        return WriteResult(instant_ns, instant_ns - order.at_ns, late=True)
    write(order.data)
    return WriteResult(instant_ns, now_ns() - order.at_ns, late=False)
