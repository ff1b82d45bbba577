"""The lease of a leader: it ends before another leader may begin, whatever is slow, cut off or suspended."""

import asyncio
from collections.abc import Callable
from typing import Any, TypeVar

import pytest

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.leadership.lease import HELD_SHARE, LeaseKeeper, LeaseTerms, LeaseWatch

T = TypeVar("T")
LEASE_NS = 3 * NS_PER_S


class ScriptedLease:
    """A lease in a database that answers after `delay_ns`, or not at all."""

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock
        self.epoch, self.renewals = 1, 0
        self.is_released = False
        self.delay_ns = NS_PER_MS
        self.is_away = False
        self.renewed_ns: list[int] = []

    def renew(self, epoch: int) -> bool:
        if epoch == self.epoch:
            self.renewals += 1
            self.renewed_ns.append(self._clock.now_ns())
        return epoch == self.epoch

    def release(self, epoch: int) -> None:
        self.is_released = epoch == self.epoch

    def read_turn(self) -> tuple[int, int] | None:
        return None if self.is_released else (self.epoch, self.renewals)

    async def run(self, function: Callable[..., T], *values: Any) -> T:
        await sleep_ns(self._clock, self.delay_ns)
        if self.is_away:
            raise JournalError("the server does not answer", "look at it")
        value = function(*values)
        await sleep_ns(self._clock, self.delay_ns)
        return value


def make_keeper(clock: VirtualClock, lease: ScriptedLease, over: list[tuple[int, str]]) -> LeaseKeeper:
    def note_end(reason: str) -> None:
        over.append((clock.now_ns(), reason))

    return LeaseKeeper(LeaseTerms(lease, lease.run, LEASE_NS), clock, lambda: 1, note_end)


@pytest.mark.parametrize("delay_ns", [NS_PER_MS, 200 * NS_PER_MS])
def test_a_leader_without_its_journal_ends_once_before_a_standby_begins(delay_ns: int) -> None:
    async def main(clock: VirtualClock) -> None:
        lease, over = ScriptedLease(clock), list[tuple[int, str]]()
        lease.delay_ns = delay_ns
        keeper = make_keeper(clock, lease, over)
        await keeper.start()
        await sleep_ns(clock, 10 * NS_PER_S)
        assert keeper.holds and not over
        # Cut off from the journal; the standby is not.
        lease.is_away = True
        standby = ScriptedLease(clock)
        standby.epoch, standby.renewals = 1, lease.renewals
        await LeaseWatch(LeaseTerms(standby, standby.run, LEASE_NS), clock).wait_for_end()
        ((ended_ns, reason),) = over
        assert "could not be renewed for 2.0 s: the server does not answer" in reason
        assert not keeper.holds
        assert ended_ns <= lease.renewed_ns[-1] + HELD_SHARE * LEASE_NS
        assert clock.now_ns() - ended_ns >= LEASE_NS * (1 - HELD_SHARE) - lease.delay_ns

    run_virtual(main)


def test_a_slow_journal_that_answers_in_time_ends_nothing_and_a_slower_one_ends_the_leader_once() -> None:
    async def main(clock: VirtualClock) -> None:
        lease, over = ScriptedLease(clock), list[tuple[int, str]]()
        keeper = make_keeper(clock, lease, over)
        await keeper.start()
        lease.delay_ns = 450 * NS_PER_MS
        await sleep_ns(clock, 30 * NS_PER_S)
        assert keeper.holds and not over
        lease.delay_ns = 2 * NS_PER_S
        await sleep_ns(clock, 30 * NS_PER_S)
        assert len(over) == 1 and not keeper.holds

    run_virtual(main)


def test_a_leader_whose_epoch_is_over_ends_at_its_next_renewal() -> None:
    async def main(clock: VirtualClock) -> None:
        lease, over = ScriptedLease(clock), list[tuple[int, str]]()
        keeper = make_keeper(clock, lease, over)
        await keeper.start()
        lease.epoch = 2
        await sleep_ns(clock, NS_PER_S)
        assert [reason for _, reason in over] == ["epoch 1 is over: another coordinator has taken the journal"]
        await keeper.close()
        assert not lease.is_released

    run_virtual(main)


def test_a_process_that_was_suspended_does_not_hold_its_lease_when_it_wakes_up() -> None:
    async def main(clock: VirtualClock) -> None:
        lease, over = ScriptedLease(clock), list[tuple[int, str]]()
        keeper = make_keeper(clock, lease, over)
        await keeper.start()
        held_ns = clock.now_ns()

        class LateClock:
            """The clock of a process that wakes up five seconds later, before any of its timers has run."""

            def now_ns(self) -> int:
                return held_ns + 5 * NS_PER_S

        assert keeper.holds
        keeper._clock = LateClock()  # type: ignore[assignment]
        assert not keeper.holds

    run_virtual(main)


def test_a_standby_waits_for_the_whole_lease_and_not_for_one_that_was_given_back() -> None:
    async def main(clock: VirtualClock) -> None:
        lease, over = ScriptedLease(clock), list[tuple[int, str]]()
        keeper = make_keeper(clock, lease, over)
        await keeper.start()
        terms = LeaseTerms(lease, lease.run, LEASE_NS)
        waiting = asyncio.ensure_future(LeaseWatch(terms, clock).wait_for_end())
        await sleep_ns(clock, 20 * NS_PER_S)
        assert not waiting.done()
        # A journal that does not answer shows no end of the lease.
        lease.is_away = True
        await sleep_ns(clock, 20 * NS_PER_S)
        assert not waiting.done() and len(over) == 1
        lease.is_away = False
        begun_ns = clock.now_ns()
        await waiting
        assert LEASE_NS <= clock.now_ns() - begun_ns <= LEASE_NS * 1.2
        # One that is given back ends at once.
        other = make_keeper(clock, lease, over)
        await other.start()
        waiting = asyncio.ensure_future(LeaseWatch(terms, clock).wait_for_end())
        await sleep_ns(clock, NS_PER_S)
        await other.close()
        begun_ns = clock.now_ns()
        await waiting
        assert clock.now_ns() - begun_ns <= LEASE_NS / 10
        assert len(over) == 1

    run_virtual(main)


def test_a_lease_that_was_over_is_held_again_by_the_next_leader() -> None:
    """A standby that began before any leader did waits for the one that was first."""

    async def main(clock: VirtualClock) -> None:
        lease = ScriptedLease(clock)
        lease.is_released = True
        watch = LeaseWatch(LeaseTerms(lease, lease.run, LEASE_NS), clock)
        await watch.look()
        assert watch.is_over
        lease.is_released = False
        await watch.look()
        assert not watch.is_over
        # Nor does one that cannot be asked count as over.
        lease.is_released = True
        await watch.look()
        assert watch.is_over
        lease.is_away = True
        await watch.look()
        assert not watch.is_over

    run_virtual(main)
