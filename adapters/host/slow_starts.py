"""The starts of an adapter host: how long each may take until the first heartbeat, and what is said of a slow one."""

from collections.abc import Callable, Coroutine
from typing import Any

from orchestrator.bus.log import ProcessLog
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.owner import TaskOwner
from orchestrator.clock.start_limit import SLOW_NS, StartLimit

FIRST_HEARTBEAT_NS = (20 * NS_PER_S, 300 * NS_PER_S)  # at least and at most, by what earlier starts needed


class SupervisedStarts:
    """The starts of the adapter host `host`. announce: announces on the bus that it starts slowly, until cancelled."""

    def __init__(self, host: str, log: ProcessLog, announce: Callable[[], Coroutine[Any, Any, None]]) -> None:
        self._host = host
        self._log = log
        self._announce = announce
        self._limit = StartLimit(*FIRST_HEARTBEAT_NS)
        self._announcing = TaskOwner(self._report_defect)
        self._is_starting = True

    @property
    def limit_ns(self) -> int:
        """How long the host may be silent before its first heartbeat."""
        return self._limit.limit_ns

    def take_look(self, needed_ns: int | None, lasted_ns: int) -> None:
        """Take a look at the host. needed_ns: how long its start has taken; None: it has been starting for
        `lasted_ns`."""
        if needed_ns is None:
            self._is_starting = True
            if lasted_ns >= SLOW_NS and not self._announcing.pending:
                self._announcing.spawn(self._announce())
        elif self._is_starting:
            self._is_starting = False
            self._announcing.cancel_all()
            self._limit.note_start(needed_ns)
            if needed_ns >= SLOW_NS:
                text = f"host {self._host} is slow to start: {needed_ns / NS_PER_S:.0f} s"
                self._log.warning(f"{text}; its computer is slow, or overloaded")

    def note_killed(self) -> str:
        """The host is killed, because its start has reached the limit; return the next one, in words. What was
        announced holds: the next start is expected to be slow, too."""
        self._limit.note_end()
        return f"; host {self._host} is slow to start: its next start has {self.limit_ns // NS_PER_S} s"

    def note_ended(self) -> None:
        """The host has ended for another reason: whether its next start is slow is not known."""
        self._announcing.cancel_all()

    def _report_defect(self, error: BaseException, _: object) -> None:
        self._log.info(f"a slow start is not announced: {error!r}", level="error")
