"""The lease of a leader whose journal other computers reach as well: renewed there, and counted here.

A leader that cannot renew its lease, because it is cut off from the journal or was suspended, must have ended before
another one may begin. It counts from before it has sent a renewal, by its own clock, and ends its heartbeats at two
thirds of the lease: adapters then stop what moves, as for every leader that is lost. The rest of the lease is for
them. The epochs that adapters compare stay the last line.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from orchestrator.clock.base import NS_PER_S, Clock, ClockTimer, sleep_ns
from orchestrator.clock.executor import Executor
from orchestrator.clock.owner import TaskOwner
from orchestrator.coordinator.journal.records import JournalError

HELD_SHARE = 2 / 3
"""Share of the lease after which a leader without a renewal ends."""
RENEWALS_A_LEASE = 10
LOOKS_A_LEASE = 20  # of a standby


class LeaderLease(Protocol):
    """The lease in the journal. All calls may last until their deadline, and raise `JournalError`."""

    def renew(self, epoch: int) -> bool:
        """Renew it; False: that epoch is over."""
        ...

    def release(self, epoch: int) -> None:
        """Give it back, so that a standby need not wait for its end."""
        ...

    def read_turn(self) -> tuple[int, int] | None:
        """The epoch of the leader, and how often it has renewed; None: the lease was given back."""
        ...


@dataclass(frozen=True, slots=True)
class LeaseTerms:
    """lease: in the journal. run: runs its calls, in a thread of their own. duration_ns: how long a renewal holds."""

    lease: LeaderLease
    run: Executor
    duration_ns: int


class LeaseKeeper:
    """Keeps the lease of one leadership. on_over: called once, with the reason, when it is lost."""

    def __init__(
        self, terms: LeaseTerms, clock: Clock, find_epoch: Callable[[], int], on_over: Callable[[str], None]
    ) -> None:
        self._terms = terms
        self._clock = clock
        self._find_epoch = find_epoch
        self._on_over = on_over
        self._renewing_ns = 0
        self._until_ns = 0
        self._failure = ""
        self._tasks = TaskOwner()
        self._timer: ClockTimer | None = None
        self._is_over = False

    @property
    def holds(self) -> bool:
        """Whether this leader may command now. Asked before each heartbeat: a process that was suspended wakes up
        behind the end of its lease."""
        return not self._is_over and self._clock.now_ns() < self._until_ns

    async def wait_for_end(self) -> None:
        """Wait until no leader holds the lease."""
        await LeaseWatch(self._terms, self._clock).wait_for_end()

    async def connect(self) -> None:
        """Reach the lease before it is taken: to connect may take as long as a leader without a renewal may go on.
        Raises `JournalError`."""
        await self._terms.run(self._terms.lease.read_turn)

    async def start(self) -> None:
        """Take the lease. Raises `JournalError`."""
        # To connect may take longer than the lease, where one of the database's hosts is dead.
        await self._terms.run(self._terms.lease.read_turn)
        await self._renew()
        self._tasks.spawn(self._keep_renewing())

    async def close(self) -> None:
        """Give the lease back; where that fails, it ends by itself."""
        self._stop()
        if self._is_over:
            return
        self._is_over = True
        try:
            await self._terms.run(self._terms.lease.release, self._find_epoch())
        except JournalError:
            return

    def _stop(self) -> None:
        self._tasks.cancel_all()
        if self._timer is not None:
            self._timer.cancel()

    async def _keep_renewing(self) -> None:
        while not self._is_over:
            next_ns = self._renewing_ns + self._terms.duration_ns // RENEWALS_A_LEASE
            await sleep_ns(self._clock, max(0, next_ns - self._clock.now_ns()))
            try:
                await self._renew()
            except JournalError as error:
                self._failure = str(error)

    async def _renew(self) -> None:
        begun_ns = self._renewing_ns = self._clock.now_ns()
        is_renewed = await self._terms.run(self._terms.lease.renew, self._find_epoch())
        if not is_renewed:
            self._end(f"epoch {self._find_epoch()} is over: another coordinator has taken the journal")
            return
        self._failure = ""
        self._until_ns = begun_ns + round(HELD_SHARE * self._terms.duration_ns)
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._clock.call_at_ns(self._until_ns, self._check_end)

    def _check_end(self) -> None:
        if not self.holds:
            held_s = HELD_SHARE * self._terms.duration_ns / NS_PER_S
            reason = self._failure or "the journal does not answer"
            self._end(f"the lease of the leader could not be renewed for {held_s:.1f} s: {reason}")

    def _end(self, reason: str) -> None:
        if not self._is_over:
            self._is_over = True
            self._stop()
            self._on_over(reason)


class LeaseWatch:
    """Knows whether the lease is held. Instants of others are not compared: it is counted from when the number of
    renewals was seen to change. A journal that does not answer shows no end. patience_ns: how much longer it counts as
    held, for another standby that is preferred."""

    def __init__(self, terms: LeaseTerms, clock: Clock, patience_ns: int = 0) -> None:
        self._terms = terms
        self._clock = clock
        self._patience_ns = patience_ns
        self._turn: tuple[int, int] | None = (0, -1)
        self._seen_ns = clock.now_ns()
        self.is_over = False
        """Whether the leader has not renewed its lease for the whole of it, or has given it back, when last looked."""

    async def look(self) -> None:
        """Ask the journal."""
        begun_ns = self._clock.now_ns()
        try:
            turn = await self._terms.run(self._terms.lease.read_turn)
        except JournalError:
            self._seen_ns = self._clock.now_ns()
            self.is_over = False
            return
        if turn != self._turn:
            self._turn, self._seen_ns = turn, self._clock.now_ns()
        held_ns = 0 if turn is None else self._terms.duration_ns
        waited_ns = begun_ns - self._seen_ns
        self.is_over = waited_ns >= held_ns + self._patience_ns or (turn is None and not self._patience_ns)

    async def keep_looking(self) -> None:
        """Ask the journal from time to time."""
        while True:
            await self.look()
            await self._wait()

    async def wait_for_end(self) -> None:
        """Wait until no leader holds the lease."""
        await self.look()
        while not self.is_over:
            await self._wait()
            await self.look()

    async def _wait(self) -> None:
        await sleep_ns(self._clock, self._terms.duration_ns // LOOKS_A_LEASE)
