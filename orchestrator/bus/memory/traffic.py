"""Counts of what passes on the in-memory bus, by process: for benchmarks of how work grows with a fleet."""

from collections import Counter
from dataclasses import dataclass, field


class Uncounted:
    """Counts nothing."""

    def count_declared(self, process: str) -> None:
        """A process has declared something."""

    def count_sent(self, process: str, kind: str, size: int) -> None:
        """A process has sent a message. kind: a key, `request` or `reply`."""

    def count_received(self, process: str, now_ns: int) -> None:
        """Something was delivered to a process now."""


@dataclass
class BusTraffic(Uncounted):
    """Counted since it was made, or since `clear`.

    sent: messages of a process: samples, each once whatever its receivers, requests and replies. received: what was
    delivered to it. sent_bytes: payloads. wakes: instants at which anything was delivered to a process, whose event
    loop runs then. declared: subscriptions, served expressions, tokens and watches. by_kind: messages sent, by process
    and last word of their key, e.g. `state`; requests and replies are `request` and `reply`.
    """

    sent: Counter[str] = field(default_factory=Counter[str])
    received: Counter[str] = field(default_factory=Counter[str])
    sent_bytes: Counter[str] = field(default_factory=Counter[str])
    wakes: Counter[str] = field(default_factory=Counter[str])
    declared: Counter[str] = field(default_factory=Counter[str])
    by_kind: Counter[tuple[str, str]] = field(default_factory=Counter[tuple[str, str]])
    _woken_ns: dict[str, int] = field(default_factory=dict[str, int])

    def count_declared(self, process: str) -> None:
        self.declared[process] += 1

    def count_sent(self, process: str, kind: str, size: int) -> None:
        self.sent[process] += 1
        self.sent_bytes[process] += size
        self.by_kind[process, kind.rpartition("/")[2]] += 1

    def count_received(self, process: str, now_ns: int) -> None:
        self.received[process] += 1
        if self._woken_ns.get(process) != now_ns:
            self._woken_ns[process] = now_ns
            self.wakes[process] += 1

    def clear(self) -> None:
        """Count from 0, but for what is declared."""
        for counts in (self.sent, self.received, self.sent_bytes, self.wakes, self.by_kind):
            counts.clear()
