"""Limits of what one process takes from the bus, whatever is sent. `docs/reference/limits.md` lists them."""

import logging
from collections.abc import Callable

_LOG = logging.getLogger(__name__)

MAX_MESSAGE_BYTES = 64_000_000  # of a message in a client or the router; the report of a job of 10,000 steps fits
MAX_COORDINATOR_MESSAGE_BYTES = 13_000_000  # a client sends jobs of at most 12 MB
MAX_HOST_MESSAGE_BYTES = 4_000_000  # the profiles of a step for all controllers of an adapter host fit several times

MAX_KEEPER_MESSAGE_BYTES = 100_000  # in a process that only keeps the e-stop latch

MAX_STATES_QUEUED = 1000  # droppable samples that wait in a process, outwards or inwards; then the oldest are lost
MAX_CALLS_QUEUED = 20_000  # events, requests and replies that wait; then new ones are lost, and counted
MAX_BYTES_QUEUED = 128_000_000  # of all that wait; then only e-stops are queued
MAX_ESTOPS_QUEUED = 1000  # then new ones are lost: the process will stop as often as it can

MAX_ANSWERING = 1000  # requests that a process answers at the same time; stops are answered beyond that
_STOPS = ("stop", "estop", "reset")

REPORT_EVERY_NS = 1_000_000_000


def is_stop(key: str) -> bool:
    """Whether a request must be answered however many others there are."""
    return key.rpartition("/")[2] in _STOPS


class LossCounter:
    """Counts what is left out because of a limit, and logs it at most once a second.

    now_ns: the time in ns of any clock.
    """

    def __init__(self, place: str, now_ns: Callable[[], int]) -> None:
        self.total = 0
        self._place = place
        self._now_ns = now_ns
        self._reported_ns: int | None = None
        self._unreported = 0

    def count_loss(self, what: str) -> None:
        """Count one loss: `what` was left out, and why."""
        self.total += 1
        self._unreported += 1
        now_ns = self._now_ns()
        if self._reported_ns is None or now_ns - self._reported_ns >= REPORT_EVERY_NS:
            self._reported_ns = now_ns
            more = f" (and {self._unreported - 1} more)" if self._unreported > 1 else ""
            self._unreported = 0
            _LOG.warning("%s: %s%s", self._place, what, more)
