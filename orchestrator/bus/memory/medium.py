"""Latency of the in-memory medium, and the queue in front of a process that does not run."""

import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from orchestrator.bus.base import Priority
from orchestrator.bus.memory.disturbances import Disturbances
from orchestrator.bus.memory.traffic import Uncounted
from orchestrator.clock.base import NS_PER_MS, NS_PER_US
from orchestrator.clock.virtual import VirtualClock


@dataclass(frozen=True, slots=True)
class BusLatency:
    """The latency of one direction through the medium, in ns: from `least` to `most` around `median`, with a rare
    tail up to `tail`.

    The defaults are of the order of a local broker. An e-stop is express and always takes the least.
    """

    least_ns: int = 40 * NS_PER_US
    median_ns: int = 60 * NS_PER_US
    most_ns: int = 200 * NS_PER_US
    tail_ns: int = 5 * NS_PER_MS
    tail_chance: float = 0.001

    def draw_ns(self, rng: random.Random) -> int:
        """Draw one duration. Half of them are below the median; long ones are increasingly rare."""
        u = rng.random()
        if u < self.tail_chance:
            return self.most_ns + int((self.tail_ns - self.most_ns) * rng.random())
        if u < 0.5:
            return self.least_ns + int((self.median_ns - self.least_ns) * 2 * u)
        return self.median_ns + int((self.most_ns - self.median_ns) * (2 * u - 1) ** 3)


class CallQueue:
    """Calls that wait for a process to run again: e-stops first, droppable ones only up to a limit."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._droppable = 0
        self._first: deque[Callable[[], None]] = deque()
        self._others: deque[Callable[[], None]] = deque()

    def __len__(self) -> int:
        return len(self._first) + len(self._others)

    def add_call(self, priority: Priority, call: Callable[[], None]) -> None:
        """Queue `call`; a droppable one is lost when `limit` of them wait already."""
        if priority is Priority.ESTOP:
            self._first.append(call)
            return
        if priority is Priority.STATE:
            if self._droppable >= self._limit:
                return
            self._droppable += 1
        self._others.append(call)

    def run_calls(self) -> None:
        """Make all waiting calls, in order."""
        calls = [*self._first, *self._others]
        self.discard_calls()
        for call in calls:
            call()

    def discard_calls(self) -> None:
        """Discard all calls."""
        self._first.clear()
        self._others.clear()
        self._droppable = 0


class BusProcess(Protocol):
    """One process on the medium, as the parts of the medium see it.

    given_up: the other processes count it as gone, because it has been silent for a lease.
    incoming: what waits for it while it is hung. max_message_bytes: it leaves out larger messages. server: its name in
    replies. computer: where it runs; "": beside the router. last_arrivals_ns: when the last sample of each sender, key
    and priority arrives: their order is kept.
    """

    name: str
    computer: str
    server: str
    max_message_bytes: int
    alive: bool
    hung: bool
    given_up: bool
    incoming: CallQueue
    last_arrivals_ns: dict[tuple[str, str, Priority], int]

    def send_call(self, priority: Priority, call: Callable[[], None]) -> None:
        """Make the process send something: now, or when it runs again."""
        ...


class Medium(Protocol):
    """The medium, as presence and requests use it."""

    clock: VirtualClock
    traffic: Uncounted
    disturbances: Disturbances

    def schedule_call(self, at_ns: int, call: Callable[[], None]) -> None: ...

    def arrival_ns(self, sender: BusProcess, receiver: BusProcess, priority: Priority = Priority.EVENT) -> int: ...

    def is_cut(self, sender: BusProcess, receiver: BusProcess) -> bool: ...

    def is_lost(self, one: BusProcess, other: BusProcess) -> bool: ...

    def deliver_call(self, bus: BusProcess, priority: Priority, call: Callable[[], None]) -> None: ...
